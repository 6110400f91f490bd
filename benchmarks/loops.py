"""``python -m benchmarks.loops [LOOP ...]``: the compiled engine on every plant and law.

For each: operations of a control period; seconds to find them (which every process spends anew) and
of the C++ compiler (which the cache spares the next process); speed of the kernel and of the scan;
what the derivatives cost. Minutes for all loops.
"""

import argparse
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

import jaxstage as js

from .agreement import distinct, real_leaves, run, spread
from .tables import rate, table
from .timing import first_calls, in_turn, machine

LANES, TICKS = 64, 10_000


def _programs(case: js.Case) -> dict[str, Callable[[], Any]]:
    """Runs that differ in their gains; derivatives with respect to all of these."""
    many = spread(case.gains, LANES)

    def error(engine: Any) -> Callable[[Any], Any]:
        return lambda gains: run(case, engine, gains, TICKS).report.ate

    def along(gains: Any) -> Any:
        ones = jax.tree.map(
            lambda x: (
                jnp.ones_like(x)
                if jnp.issubdtype(x.dtype, jnp.floating)
                else jnp.zeros(x.shape, jax.dtypes.float0)
            ),
            gains,
        )
        return jax.jvp(error(js.compiled), (gains,), (ones,))[1]

    chosen = {
        "scan": error(js.scan),
        "forward": error(js.compiled),
        "tangent": along,
        "reverse": jax.grad(error(js.compiled), allow_int=True),
    }

    def called(function: Callable[[Any], Any]) -> Callable[[], Any]:
        every = jax.jit(lambda g: real_leaves(jax.vmap(function)(g)))
        return lambda: every(many)

    return {name: called(f) for name, f in chosen.items()}


def row(name: str, case: js.Case) -> list[str]:
    """What the table says of a loop."""
    reports = js.explain(case.loop, case.gains, case.scenario, case.path).kernels
    programs = _programs(case)
    times = in_turn(programs, first_calls(programs), 2.0)
    steps, forward = LANES * TICKS, times["forward"].cpu
    return [
        name,
        " ".join(str(r.nodes) for r in reports),
        " ".join(f"{r.graph_seconds:.2f}" for r in reports),
        " ".join("cached" if r.cached else f"{r.seconds:.1f}" for r in reports),
        rate(steps / forward),
        rate(steps / times["scan"].cpu),
        f"{times['scan'].cpu / forward:.0f}",
        f"{times['tangent'].cpu / forward:.1f}",
        f"{times['reverse'].cpu / forward:.1f}",
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.loops", description=__doc__)
    parser.add_argument("loops", nargs="*", metavar="LOOP")
    chosen = parser.parse_args().loops
    jax.config.update("jax_enable_x64", True)
    for name, text in machine().items():
        print(f"{name:10} {text}")
    rows = []
    for name, case in distinct().items():
        if not chosen or name in chosen:
            rows.append(row(name, case))
            print(" | ".join(rows[-1]), flush=True)
    head = (
        "loop",
        "operations",
        "graph s",
        "C++ s",
        "kernel",
        "scan",
        "x",
        "tangent",
        "reverse",
    )
    note = (
        f"float64, {LANES} runs of {TICKS} periods, tracking error. Operations, seconds: of the\n"
        "kernels of a run, a tangent and reverse mode by all gains and the scenario.\n"
        "kernel, scan: periods of all runs per processor second. tangent (in one direction) and\n"
        "reverse (all gains): processor time as a multiple of that of the run."
    )
    print(table("The compiled engine, loop by loop", head, rows, note))


if __name__ == "__main__":
    main()
