"""What is simulated to judge claims, and what is drawn of it.

An `Experiment` is run once and gives figures by name: the evidence. Cases that share a loop run
together in one batch (`measure`).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.metrics import columns
from jaxstage.model.fields import definition
from jaxstage.simulate.batch import rollouts
from jaxstage.studies.case import Case
from jaxstage.studies.claim import Evidence


@definition
class Experiment:
    """name: short. text: what is simulated, one line. measure: simulates it, case -> figures."""

    name: str
    text: str
    measure: Callable[[], Evidence]


def measure(cases: Mapping[str, Case]) -> dict[str, dict[str, Any]]:
    """Figures of the scored part of every case, and ``lost_at_s`` (None for a complete run)."""
    runs = simulate_all(cases)
    return {
        name: columns(run.report, cases[name].loop.plant) | {"lost_at_s": _lost(cases[name], run)}
        for name, run in runs.items()
    }


def measure_windows(cases: Mapping[str, Case]) -> dict[str, dict[str, Any]]:
    """As `measure`, for loops whose metric is `together` of several windows of one metric: the
    figures of window w of case c are called ``c/w``."""
    runs = simulate_all(cases)
    return {
        f"{name}/{part}": columns(figures, cases[name].loop.plant)
        | {"lost_at_s": _lost(cases[name], run)}
        for name, run in runs.items()
        for part, figures in run.report.items()
    }


def _lost(case: Case, run: Any) -> float | None:
    ticks = [int(tick) for tick in (run.final.left_path_at, run.final.non_finite_at) if tick >= 0]
    return min(ticks) * case.loop.dt if ticks else None


def simulate_all(cases: Mapping[str, Case]) -> dict[str, Any]:
    """The `Run` of every case; cases of one loop, length and shape run as one batch."""
    groups: dict[Any, list[str]] = {}
    for name, case in cases.items():
        inputs = (case.gains, case.scenario, case.path)
        shapes = tuple(jnp.shape(leaf) for leaf in jax.tree.leaves(inputs))
        key = (case.loop, case.window.ticks, jax.tree.structure(inputs), shapes)
        groups.setdefault(key, []).append(name)
    runs: dict[str, Any] = {}
    for names in groups.values():
        runs |= dict(zip(names, _batch([cases[name] for name in names]), strict=True))
    return {name: runs[name] for name in cases}


def _batch(cases: Sequence[Case]) -> list[Any]:
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
    gains, scenario, path = stacked
    run = rollouts(
        first.loop, gains, scenario, path, first.window.ticks,
        in_axes=jax.tree.map(lambda changed: 0 if changed else None, differ), tile=len(cases),
    )  # fmt: skip
    run = jax.tree.map(np.asarray, run)
    return [jax.tree.map(lambda x, lane=lane: x[lane], run) for lane in range(len(cases))]


def _same(a: Any, b: Any) -> bool:
    """True for equal leaves: what all cases of a batch share is not copied."""
    if a is b:
        return True
    if jnp.issubdtype(jnp.asarray(a).dtype, jax.dtypes.prng_key):
        a, b = jax.random.key_data(a), jax.random.key_data(b)
    return np.array_equal(np.asarray(a), np.asarray(b))


# --- drawings --------------------------------------------------------------------------------


class Line(NamedTuple):
    """One line of a chart; x may hold names, for bars."""

    label: str
    x: Any
    y: Any


class Chart(NamedTuple):
    """One panel. x, y: axis labels with units. text: how to read it. bars: x holds names. equal:
    one scale for both axes, for paths."""

    title: str
    x: str
    y: str
    lines: tuple[Line, ...]
    text: str = ""
    bars: bool = False
    log_x: bool = False
    log_y: bool = False
    equal: bool = False


@definition
class ChartDrawing:
    """A picture of panels computed from the evidence. name: of the file. title: with its place in
    the paper. text: how to read it, one or two sentences."""

    name: str
    title: str
    text: str
    charts: Callable[[Evidence], tuple[Chart, ...]]


@definition
class RunDrawing:
    """Pictures of one recorded run. name: of the files, before the name of each view. text: what
    figure of the paper it stands for. case: builds it. views: names of `jaxstage.plot` pictures."""

    name: str
    text: str
    case: Callable[[], Case]
    views: tuple[str, ...]
