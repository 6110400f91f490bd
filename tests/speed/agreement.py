"""``python -m tests.speed.agreement [LOOP ...]``: the compiled engine beside the scan.

For every plant and law of the studies: the largest difference of the machine and the figures after
8 and after 30 periods, and of the gradient after 30, relative to the largest number of each leaf.
XLA contracts products and sums of the scan, and a law that takes the sign of what cancels, or an
encoder, multiplies that rounding: where the two differ by more than 1e-12, both are compared with
the loop computed operation by operation, in the arithmetic of IEEE 754.
"""

import argparse
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxstage as js
from jaxstage.metrics import tracking
from jaxstage.studies import all_studies

from .tables import table

#: differences that are not looked at any closer
ROUNDING = 1e-12
TICKS = 8


def distinct() -> dict[str, js.Case]:
    """The published loops with different blocks; their metric is the tracking error."""
    seen = {}
    for study in all_studies:
        for entry in study.loops:
            c = entry.build(entry.timing)
            loop = c.loop
            key = loop.plant, loop.controller, loop.sensor, loop.drive, loop.reference.name
            seen.setdefault(key, (entry.name, c._replace(loop=js.replace(loop, metric=tracking))))
    return dict(seen.values())


def spread(tree: Any, lanes: int, seed: int = 0) -> Any:
    """The tree for many runs, within 5 %."""
    random = np.random.default_rng(seed)
    return jax.tree.map(
        lambda x: jnp.asarray(
            np.asarray(x) * random.uniform(0.95, 1.05, (lanes, *x.shape)), x.dtype
        ),
        tree,
    )


def moved(result: js.Run) -> Any:
    """What a run comes to: the machine and the figures. (The sliding variable is what is left of
    two numbers that cancel.)"""
    return result.final.state, result.final.metric, result.final.step, result.final.left_path_at


def apart(a: Any, b: Any) -> float:
    """The largest difference of any leaf, relative to the largest number of the leaf."""
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    pairs = ((np.asarray(x, float), np.asarray(y, float)) for x, y in pairs if x.size)
    return float(
        np.max([np.max(np.abs(x - y)) / max(np.max(np.abs(x)), ROUNDING) for x, y in pairs])
    )


def _run(case: js.Case, engine: Any, ticks: int, gains: Any) -> js.Run:
    return js.simulate(js.replace(case.loop, engine=engine), gains, case.scenario, case.path, ticks)


def _row(name: str, case: js.Case) -> list[str]:
    gains = spread(case.gains, 3)

    def values(engine: Any, ticks: int) -> Any:
        return jax.jit(jax.vmap(lambda g: moved(_run(case, engine, ticks, g))))(gains)

    def slopes(engine: Any) -> Any:
        slope = jax.grad(lambda g: _run(case, engine, 30, g).report.ate, allow_int=True)
        found = jax.tree.leaves(jax.jit(jax.vmap(slope))(gains))
        return [x for x in found if x.dtype != jax.dtypes.float0]

    found = [apart(values(js.scan, n), values(js.compiled, n)) for n in (TICKS, 30)]
    cells = [name, *(f"{x:.0e}" for x in found)]
    cells.append(f"{apart(slopes(js.scan), slopes(js.compiled)):.0e}")
    if max(found) <= ROUNDING:
        return [*cells, "", ""]
    one = jax.tree.map(lambda x: x[0], gains)
    fused = [jax.jit(functools.partial(_run, case, e, TICKS))(one) for e in (js.scan, js.compiled)]
    with jax.disable_jit():
        exact = _run(case, js.scan, TICKS, one)
    return [*cells, *(f"{apart(moved(exact), moved(r)):.0e}" for r in fused)]


def main() -> None:
    """Print the table; minutes for all loops."""
    parser = argparse.ArgumentParser(prog="python -m tests.speed.agreement", description=__doc__)
    parser.add_argument("loops", nargs="*", metavar="LOOP")
    chosen = parser.parse_args().loops
    jax.config.update("jax_enable_x64", True)
    rows = []
    for name, case in distinct().items():
        if not chosen or name in chosen:
            rows.append(_row(name, case))
            print(" ".join(rows[-1]), flush=True)
    head = (
        "loop", f"{TICKS} periods", "30 periods", "gradient",
        "scan - exact", "engine - exact",
    )  # fmt: skip
    print(table("Compiled engine and scan", head, rows, "float64; exact: operation by operation."))


if __name__ == "__main__":
    main()
