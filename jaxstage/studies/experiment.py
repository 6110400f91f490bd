"""What is simulated to judge claims.

An `Experiment` is run once and gives metrics by name: the evidence. Cases that share a loop run
together in one batch (`measure`).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.metrics import columns
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import definition
from jaxstage.model.signals import Run, Sample
from jaxstage.simulate.batch import rollouts
from jaxstage.studies.case import Case
from jaxstage.studies.evidence import Evidence


@definition
class Experiment:
    """name: short. text: what is simulated, one line. measure: simulates it, case -> metrics."""

    name: str
    text: str
    measure: Callable[[], Evidence]


def stored(name: str, pick: Callable[[Sample], Any]) -> Metric:
    """A metric that stores what ``pick`` takes of every tick, and reports nothing."""
    return Metric(
        name=name,
        init=lambda setpoint: (),
        update=lambda acc, sample, dt: (acc, pick(sample)),
        finish=lambda acc: None,
    )


def measure(cases: Mapping[str, Case]) -> dict[str, dict[str, Any]]:
    """Metrics of the scored part of every case, and ``lost_at_s`` (None for a complete run)."""
    return {
        name: metrics_of(cases[name], run, run.report) for name, run in simulate_all(cases).items()
    }


def measure_windows(runs: Mapping[str, Run], cases: Mapping[str, Case]) -> dict[str, Any]:
    """As `measure`, of runs whose metric is `together` of several windows of one metric: the
    metrics of window w of case c are called ``c/w``."""
    return {
        f"{name}/{window}": metrics_of(cases[name], run, report)
        for name, run in runs.items()
        for window, report in run.report.items()
    }


def metrics_of(case: Case, run: Run, report: Any) -> dict[str, Any]:
    """The columns of a report of a run, and ``lost_at_s``."""
    ticks = [int(tick) for tick in (run.final.left_path_at, run.final.non_finite_at) if tick >= 0]
    lost = min(ticks) * case.loop.dt if ticks else None
    return columns(report, case.loop.plant) | {"lost_at_s": lost}


def simulate_all(cases: Mapping[str, Case]) -> dict[str, Run]:
    """The `Run` of every case; cases of one loop, length and shape run as one batch."""
    groups: dict[Any, list[str]] = {}
    for name, case in cases.items():
        inputs = (case.gains, case.scenario, case.path)
        shapes = tuple(jnp.shape(leaf) for leaf in jax.tree.leaves(inputs))
        key = (case.loop, case.window.ticks, jax.tree.structure(inputs), shapes)
        groups.setdefault(key, []).append(name)
    runs: dict[str, Run] = {}
    for names in groups.values():
        runs |= dict(zip(names, _batch([cases[name] for name in names]), strict=True))
    return {name: runs[name] for name in cases}


def _batch(cases: Sequence[Case]) -> list[Run]:
    first = cases[0]
    if len(cases) == 1:
        return [first.simulate()]
    trees = [(case.gains, case.scenario, case.path) for case in cases]
    differ = jax.tree.map(lambda *leaves: not all(_same(x, leaves[0]) for x in leaves), *trees)
    stacked = jax.tree.map(
        lambda changed, *leaves: (
            jnp.stack([jnp.asarray(x) for x in leaves]) if changed else leaves[0]
        ),
        differ,
        *trees,
    )
    in_axes = jax.tree.map(lambda changed: 0 if changed else None, differ)
    gains, scenario, path = stacked
    ticks, count = first.window.ticks, len(cases)
    run = rollouts(first.loop, gains, scenario, path, ticks, in_axes=in_axes, tile=count)
    run = jax.tree.map(np.asarray, run)
    return [jax.tree.map(lambda x, lane=lane: x[lane], run) for lane in range(count)]


def _same(a: Any, b: Any) -> bool:
    """True for equal leaves: what all cases of a batch share is not copied."""
    if a is b:
        return True
    if jnp.issubdtype(jnp.asarray(a).dtype, jax.dtypes.prng_key):
        a, b = jax.random.key_data(a), jax.random.key_data(b)
    return np.array_equal(np.asarray(a), np.asarray(b))
