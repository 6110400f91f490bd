"""``python -m benchmarks.agreement [--contracted] [LOOP ...]``: compiled engine beside the scan.

For every plant and law of the studies: the largest difference of the machine and the metrics after
30 periods, and of their gradient, relative to the largest number of each leaf. Both compute in the
arithmetic of IEEE 754, operation by operation: neither XLA nor the C++ compiler makes one
operation of a product and a sum. In use both do, each where it likes, which is what
``--contracted`` shows: an encoder or a law that takes the sign of what cancels multiplies that
rounding.
"""

import argparse
import os
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxstage as js
from jaxstage.compiler.runtime import toolchain as build
from jaxstage.metrics import tracking
from jaxstage.studies import all_studies

from .tables import table

TICKS = 30


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
    """What a run comes to: the machine and the metrics. (The sliding variable is what is left of
    two numbers that cancel.)"""
    return result.final.state, result.final.metric, result.final.step, result.final.left_path_at


def apart(a: Any, b: Any) -> float:
    """The largest difference of any leaf, relative to the largest number of the leaf."""
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    pairs = ((np.asarray(x, float), np.asarray(y, float)) for x, y in pairs if x.size)
    return float(np.max([np.max(np.abs(x - y)) / max(np.max(np.abs(x)), 1e-12) for x, y in pairs]))


def run(case: js.Case, engine: Any, gains: Any, ticks: int) -> js.Run:
    """The case under an engine."""
    loop = js.replace(case.loop, engine=engine)
    return js.simulate(loop, gains, case.scenario, case.path, ticks)


def real_leaves(tree: Any) -> list[Any]:
    """The leaves of a derivative, without those of integers, which have none."""
    return [x for x in jax.tree.leaves(tree) if x.dtype != jax.dtypes.float0]


def differences(case: js.Case) -> tuple[float, float]:
    """Of the values and of the gradient, compiled and scan, of three runs."""
    gains = spread(case.gains, 3)

    def values(engine: Any) -> Any:
        return jax.jit(jax.vmap(lambda g: moved(run(case, engine, g, TICKS))))(gains)

    def slopes(engine: Any) -> Any:
        slope = jax.grad(lambda g: run(case, engine, g, TICKS).report.ate, allow_int=True)
        return real_leaves(jax.jit(jax.vmap(slope))(gains))

    return tuple(apart(f(js.scan), f(js.compiled)) for f in (values, slopes))  # type: ignore


def uncontracted() -> None:
    """From here on no product and sum become one operation. Before JAX starts."""
    # of the instruction sets that XLA knows, AVX is the largest without a fused multiply-add
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_max_isa=AVX"
    build.FLAGS = (*build.FLAGS, "-ffp-contract=off")


def main() -> None:
    """Print the table; minutes for all loops."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.agreement", description=__doc__)
    parser.add_argument("--contracted", action="store_true", help="as both are in use")
    parser.add_argument("loops", nargs="*", metavar="LOOP")
    options = parser.parse_args()
    if not options.contracted:
        uncontracted()
    jax.config.update("jax_enable_x64", True)
    rows = []
    for name, case in distinct().items():
        if not options.loops or name in options.loops:
            rows.append([name, *(f"{x:.0e}" for x in differences(case))])
            print(" ".join(rows[-1]), flush=True)
    head = ("loop", f"{TICKS} periods", "gradient")
    print(table("Compiled engine and scan", head, rows, "float64, 3 runs."))


if __name__ == "__main__":
    main()
