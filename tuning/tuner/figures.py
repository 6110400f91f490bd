"""Figures of training runs as arrays that can be differentiated, and only those that are asked for.

Columns are those of a sweep, in display units. Root mean squares that a search usually minimises
are built from the squares of every tick instead of sums, so that least squares sees the error of
each piece of the run and not one number.

| column | definition |
|---|---|
| of the report | as in ``jaxstage run``; a figure of several axes under its bare key is their RMS |
| `contour_smooth_max_um` | (mean eps^16)^(1/16): like the largest, but every peak counts |
| `command_change_rms_A` | RMS change of the command per period, in the unit of the command |
| `growth` | RMS |r - x| of the last third over that of the middle third: 1 in a steady run |
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.blocks import Metric, Plant
from jaxstage.fields import definition, in_units_of, leaves
from jaxstage.metrics import selected, together
from jaxstage.metrics.moments import root
from jaxstage.metrics.table import key
from jaxstage.metrics.tracking import following_error
from jaxstage.settings import nearest_name
from jaxstage.signals import Sample, Setpoint
from jaxstage.studies import Case
from jaxstage.studies.case import scored

#: pieces that a run is cut into for least squares
PIECES = 50
#: order of the smooth maximum
ORDER = 16

SMOOTH_MAX = "contour_smooth_max_um"
GROWTH = "growth"


@definition
class Squared:
    """A column that is the root of the mean of something squared.

    metric: its place in the rows. axes: whether it has one number an axis. scale: display units in
    one SI unit. of(sample, last command) -> () or (axes,), SI.
    """

    metric: str
    axes: bool
    scale: float
    of: Callable[[Sample, Array], Array]


def _contour(sample: Sample, last: Array) -> Array:
    return sample.nearest.distance**2


def _following(sample: Sample, last: Array) -> Array:
    return following_error(sample) ** 2


def _tracking(sample: Sample, last: Array) -> Array:
    return jnp.sum(following_error(sample) ** 2)


def _command(sample: Sample, last: Array) -> Array:
    return sample.command**2


def _change(sample: Sample, last: Array) -> Array:
    return (sample.command - last) ** 2


CONTOUR = Squared(metric="contour", axes=False, scale=1e6, of=_contour)
FOLLOWING = Squared(metric="following", axes=True, scale=1e6, of=_following)
TRACKING = Squared(metric="tracking", axes=False, scale=1.0, of=_tracking)
COMMAND = Squared(metric="command", axes=True, scale=1.0, of=_command)
CHANGE = Squared(metric="change", axes=True, scale=1.0, of=_change)


class Recipe(NamedTuple):
    """How the columns that are asked for come about.

    columns: their names. known: every column there is -> the metric whose report holds it, or "".
    metric: what the runs compute. squared: what it stores of every tick, and from what tick on.
    """

    columns: tuple[str, ...]
    known: dict[str, str]
    metric: Metric
    squared: tuple[Squared, ...]


def available(case: Case) -> dict[str, str]:
    """Every column of the runs of a case -> the name of its metric, "" for the tuner's own."""
    report = _shapes(case, case.metric)
    found = {}
    for name, part in report.items():
        found |= dict.fromkeys(_arrays(part, case.loop.plant), name)
    found |= dict.fromkeys(_squares(case), "")
    return found | {GROWTH: ""} | ({SMOOTH_MAX: ""} if _has_contour(report) else {})


def recipe(case: Case, columns: Iterable[str]) -> Recipe:
    """The light metric of a case that gives these columns. Raises ValueError for an unknown one."""
    known, wanted = available(case), tuple(dict.fromkeys(columns))
    squares = _squares(case)
    for name in wanted:
        if name not in known:
            raise ValueError(f"unknown column '{name}'{nearest_name(name, known)}")
    metrics = tuple(dict.fromkeys(known[n] for n in wanted if known[n] and n not in squares))
    squared = {squares[n] for n in wanted if n in squares}
    squared |= {TRACKING} if GROWTH in wanted else set()
    squared |= {CONTOUR} if SMOOTH_MAX in wanted else set()
    kept = tuple(s for s in (CONTOUR, FOLLOWING, TRACKING, COMMAND, CHANGE) if s in squared)
    light = scored(selected(case.metric, metrics), case.window) if metrics else None
    metric = together(*((light,) if light else ()), _each_tick(kept))
    return Recipe(wanted, known, metric, kept)


def _shapes(case: Case, metric: Metric) -> dict[str, Any]:
    """The report of a metric as shapes."""
    loop = case.loop
    first = jax.eval_shape(loop.reference.sample, case.path, jnp.zeros((), jnp.int32))
    shapes = jax.eval_shape(lambda setpoint: metric.finish(metric.init(setpoint)), first)
    return jax.tree.map(lambda x: jnp.zeros((1, *x.shape), x.dtype), shapes)


def _has_contour(report: dict[str, Any]) -> bool:
    return "contour" in report


def _squares(case: Case) -> dict[str, Squared]:
    """Column -> what it is the root mean square of."""
    plant = case.loop.plant
    unit = plant.command_unit
    table = {key("command_rms", unit): COMMAND, key("command_change_rms", unit): CHANGE}
    table["following_rms_um"] = FOLLOWING
    if _has_contour(_shapes(case, case.metric)):
        table["contour_rms_um"] = CONTOUR
    return table


def _each_tick(squared: tuple[Squared, ...]) -> Metric:
    """Stores the squares of every tick."""

    def init(setpoint: Setpoint) -> Array:
        return jnp.zeros_like(setpoint.position)

    def update(last: Array, sample: Sample, dt: float) -> tuple[Array, Any]:
        before = jnp.where(sample.step == 0, sample.command, last)
        rows = {s.metric: s.of(sample, before) for s in squared}
        return sample.command, rows or None

    return Metric(name="each_tick", init=init, update=update, finish=lambda last: None)


def _arrays(report: Any, plant: Plant) -> dict[str, Array]:
    """Figures of a batch by column, leaves (lanes,) or (lanes, axes), in display units."""
    table = {}
    for path, general, value in leaves(report):
        quantity = in_units_of(general, plant.command_unit)
        name = path.rsplit(".", 1)[-1]
        shown = value * quantity.factor
        if shown.ndim == 1:
            table[key(name, quantity.shown)] = shown
            continue
        table[key(name, quantity.shown)] = root(jnp.mean(shown**2, axis=-1))
        for i, axis in enumerate(plant.axes):
            table[key(f"{name}_{axis}", quantity.shown)] = shown[:, i]
    return table


class Measured(NamedTuple):
    """columns: (lanes,) each. pieces: column -> (lanes, pieces), whose squares add up to that of
    the column; for columns that are a root mean square."""

    columns: dict[str, Array]
    pieces: dict[str, Array]


def measure(case: Case, made: Recipe, report: Any, rows: Any) -> Measured:
    """The columns of a batch of runs. report, rows: of `rollouts` with the metric of a recipe;
    those of lost runs are NaN."""
    window = case.window
    table = _arrays(report["scored"], case.loop.plant) if "scored" in report else {}
    stored = (rows or {}).get("each_tick", {})
    squares, pieces = _squares(case), {}
    for name in made.columns:
        if name in squares:
            square = squares[name]
            inside = stored[square.metric][:, window.start : window.stop]
            pieces[name] = _pieces(inside) * square.scale
            table[name] = root(jnp.sum(pieces[name] ** 2, axis=-1))
    if SMOOTH_MAX in made.columns:
        table[SMOOTH_MAX] = smooth_max(stored[CONTOUR.metric][:, window.start : window.stop]) * 1e6
    if GROWTH in made.columns:
        table[GROWTH] = growth(stored[TRACKING.metric])
    return Measured({name: table[name] for name in made.columns}, pieces)


def _pieces(squares: Array) -> Array:
    """RMS of each piece of a run (and axis), so that the squares add up to the mean square.

    squares: (lanes, ticks) or (lanes, ticks, axes) -> (lanes, pieces or pieces * axes).
    """
    lanes, ticks = squares.shape[:2]
    length = -(-ticks // min(PIECES, ticks))
    short = -ticks % length
    padded = jnp.pad(squares.reshape(lanes, ticks, -1), ((0, 0), (0, short), (0, 0)))
    sums = jnp.sum(padded.reshape(lanes, -1, length, padded.shape[-1]), axis=2)
    return root(sums / (ticks * padded.shape[-1])).reshape(lanes, -1)


def smooth_max(squares: Array) -> Array:
    """(mean |x|^ORDER)^(1/ORDER) of the squares (lanes, ticks)."""
    largest = jax.lax.stop_gradient(jnp.max(squares, axis=-1, keepdims=True))
    safe = jnp.where(largest > 0, largest, jnp.ones_like(largest))
    power = jnp.mean((squares / safe) ** (ORDER // 2), axis=-1)
    some = power > 0
    mean = jnp.where(some, jnp.where(some, power, jnp.ones_like(power)) ** (1 / ORDER), power)
    return mean * jnp.sqrt(safe[:, 0])


def growth(squares: Array) -> Array:
    """RMS of the last third over that of the middle third; 0 of a run without any error."""
    third = max(squares.shape[-1] // 3, 1)
    late, middle = squares[:, -third:], squares[:, -2 * third : -third]
    below = jnp.mean(middle, axis=-1)
    safe = jnp.where(below > 0, below, jnp.ones_like(below))
    return root(jnp.where(below > 0, jnp.mean(late, axis=-1) / safe, jnp.zeros_like(below)))


def as_numbers(columns: dict[str, Array]) -> dict[str, np.ndarray]:
    """Columns on the host."""
    return {name: np.asarray(value, float) for name, value in columns.items()}
