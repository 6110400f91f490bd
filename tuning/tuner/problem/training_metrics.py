"""Differentiable metrics of training runs, and only those that are asked for.

Columns are those of a sweep, in display units. Root mean squares that a search usually minimises
are summed up for each of `PIECES` pieces of a run, so that least squares sees the error of each
piece and not one number. Nothing else is stored of a run.

| column | definition |
|---|---|
| of the report | as in ``jaxstage run``; a metric of several axes under its bare key is their RMS |
| `contour_smooth_max_um` | (mean eps^16)^(1/16): like the largest, but every peak counts |
| `command_change_rms_A` | RMS change of the command per period, in the unit of the command |
| `growth` | RMS |r - x| of the last third over that of the middle third: 1 in a steady run |
"""

import functools
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.metrics import selected, together
from jaxstage.metrics.moments import root
from jaxstage.metrics.table import key, reported_metrics
from jaxstage.metrics.tracking import following_error
from jaxstage.model.blocks import Metric, Plant
from jaxstage.model.fields import definition, pytree, signal
from jaxstage.model.settings import nearest_name
from jaxstage.model.signals import Sample, Setpoint
from jaxstage.studies import Case
from jaxstage.studies.case import Window, scored

#: pieces that a run is cut into for least squares
PIECES = 8
#: order of the smooth maximum
ORDER = 16
#: a change of the command from period to period that is no chattering yet, as a share of its RMS
SMOOTH = 0.02

SMOOTH_MAX = "contour_smooth_max_um"
GROWTH = "growth"


@definition
class MeanSquare:
    """A column that is the root of a mean square.

    Attributes:
        name: of its sums.
        scale: display units in one SI unit.
        of: (sample, last command) -> (), SI; of several axes their mean.
    """

    name: str
    scale: float
    of: Callable[[Sample, Array], Array]


def _contour(sample: Sample, last: Array) -> Array:
    return sample.nearest.distance**2


def _following(sample: Sample, last: Array) -> Array:
    return jnp.mean(following_error(sample) ** 2)


def _tracking(sample: Sample, last: Array) -> Array:
    return jnp.sum(following_error(sample) ** 2)


def _command(sample: Sample, last: Array) -> Array:
    return jnp.mean(sample.command**2)


def _change(sample: Sample, last: Array) -> Array:
    return jnp.mean((sample.command - last) ** 2)


CONTOUR = MeanSquare(name="contour", scale=1e6, of=_contour)
FOLLOWING = MeanSquare(name="following", scale=1e6, of=_following)
COMMAND = MeanSquare(name="command", scale=1.0, of=_command)
CHANGE = MeanSquare(name="change", scale=1.0, of=_change)


class TrainingMetric(NamedTuple):
    """The metric of training runs, for the columns that are asked for.

    Attributes:
        columns: their names.
        known: every column there is -> the metric whose report holds it, or "".
        metric: what the runs compute.
    """

    columns: tuple[str, ...]
    known: dict[str, str]
    metric: Metric


def available_columns(case: Case) -> dict[str, str]:
    """Every column of the runs of a case -> the name of its metric, "" for the tuner's own."""
    report, plant = _shapes(case, case.metric), case.loop.plant
    known = {column: name for name, part in report.items() for column in _arrays(part, plant)}
    own = (*_mean_squares(case), GROWTH, *((SMOOTH_MAX,) if _on_contour(report) else ()))
    return known | dict.fromkeys(own, "")


def training_metric(case: Case, columns: Iterable[str]) -> TrainingMetric:
    """The lightest metric of a case that gives some columns.

    Args:
        case: whose runs it measures.
        columns: their names.

    Raises:
        ValueError: one is unknown.
    """
    known, names = available_columns(case), tuple(dict.fromkeys(columns))
    squares = _mean_squares(case)
    for name in names:
        if name not in known:
            raise ValueError(f"unknown column '{name}'{nearest_name(name, known)}")
    metrics = tuple(dict.fromkeys(known[n] for n in names if known[n] and n not in squares))
    kept = tuple(dict.fromkeys(squares[n] for n in names if n in squares))
    own = [pieces(kept, case.window)] if kept else []
    own += [growth(case.window.ticks)] if GROWTH in names else []
    light = [selected(case.metric, metrics)] if metrics else []
    light += [smooth_max] if SMOOTH_MAX in names else []
    own += [scored(together(*light), case.window)] if light else []
    return TrainingMetric(names, known, together(*own))


def least_scale(column: str) -> tuple[str, float] | None:
    """Floor of the automatic scale of a column: (metric, share of it), or None.

    A command that is smooth before must not make its own smoothness the price of all accuracy.
    """
    stem, change = "command_rms", "command_change_rms"
    return (column.replace(change, stem), SMOOTH) if column.startswith(change) else None


def _shapes(case: Case, metric: Metric) -> dict[str, Any]:
    """The report of a metric as shapes."""
    loop = case.loop
    first = jax.eval_shape(loop.reference.sample, case.path, jnp.zeros((), jnp.int32))
    shapes = jax.eval_shape(lambda setpoint: metric.finish(metric.init(setpoint)), first)
    return jax.tree.map(lambda x: jnp.zeros((1, *x.shape), x.dtype), shapes)


def _on_contour(report: dict[str, Any]) -> bool:
    return "contour" in report


def _mean_squares(case: Case) -> dict[str, MeanSquare]:
    """Column -> what it is the root mean square of."""
    unit = case.loop.plant.command_unit
    table = {key("command_rms", unit): COMMAND, key("command_change_rms", unit): CHANGE}
    table["following_rms_um"] = FOLLOWING
    if _on_contour(_shapes(case, case.metric)):
        table["contour_rms_um"] = CONTOUR
    return table


# --- what the runs sum up ----------------------------------------------------------------------


class _Sums(NamedTuple):
    """last: command before, (axes,). squares: (pieces,) of each `MeanSquare`, SI."""

    last: Array
    squares: dict[str, Array]


@functools.cache
def pieces(squared: tuple[MeanSquare, ...], window: Window) -> Metric:
    """What each piece of the window adds to mean squares: name -> (pieces,), SI.

    It looks at the window itself, and not through `scored`: the first change of the command in it
    is from the period before.

    Args:
        squared: what is summed up.
        window: ticks that count.
    """
    ticks = window.stop - window.start
    length = -(-ticks // PIECES)
    count = -(-ticks // length)

    def init(setpoint: Setpoint) -> _Sums:
        zero = jnp.zeros_like(setpoint.position)
        return _Sums(zero, {s.name: jnp.zeros(count, zero.dtype) for s in squared})

    def update(acc: _Sums, sample: Sample, dt: float) -> tuple[_Sums, None]:
        before = jnp.where(sample.step == 0, sample.command, acc.last)
        inside = (sample.step >= window.start) & (sample.step < window.stop)
        piece = jnp.clip((sample.step - window.start) // length, 0, count - 1)
        sums = {}
        for s in squared:
            sums[s.name] = acc.squares[s.name].at[piece].add(s.of(sample, before) * inside)
        return _Sums(sample.command, sums), None

    def finish(acc: _Sums) -> dict[str, Array]:
        return {name: value / ticks for name, value in acc.squares.items()}

    return Metric(name="pieces", init=init, update=update, finish=finish)


class _Peaks(NamedTuple):
    """count: of the samples. largest: of the squares x so far, m2. power: sum of
    (x / largest)^(ORDER / 2). All ()."""

    count: Array
    largest: Array
    power: Array


@pytree
class SmoothMax:
    """Power mean of the contour error: its peaks above all."""

    contour_smooth_max: Array = signal("m", "", "(mean eps^16)^(1/16)", shown="um")


def _no_peaks(setpoint: Setpoint) -> _Peaks:
    zero = jnp.zeros((), setpoint.position.dtype)
    return _Peaks(zero, zero, zero)


def _with_peak(acc: _Peaks, sample: Sample, dt: float) -> tuple[_Peaks, None]:
    """Summed up in units of the largest error so far, which has no gradient of its own."""
    value, half = _contour(sample, sample.command), ORDER // 2
    largest = jnp.maximum(acc.largest, jax.lax.stop_gradient(value))
    safe = jnp.where(largest > 0, largest, jnp.ones_like(largest))
    power = acc.power * (acc.largest / safe) ** half + (value / safe) ** half
    return _Peaks(acc.count + 1, largest, power), None


def _smooth_maximum(acc: _Peaks) -> SmoothMax:
    some = acc.power > 0
    safe = jnp.where(some, acc.power / acc.count, jnp.ones_like(acc.power))
    mean = jnp.where(some, safe ** (1 / ORDER), jnp.zeros_like(safe))
    return SmoothMax(contour_smooth_max=mean * root(acc.largest))


#: (mean eps^ORDER)^(1/ORDER) of the contour error; report `SmoothMax`.
smooth_max = Metric(name="smooth_max", init=_no_peaks, update=_with_peak, finish=_smooth_maximum)


@functools.cache
def growth(ticks: int) -> Metric:
    """RMS |r - x| of the last third of a run over that of the middle third, (); 0 without error."""
    third = max(ticks // 3, 1)

    def init(setpoint: Setpoint) -> Array:
        return jnp.zeros(3, setpoint.position.dtype)

    def update(acc: Array, sample: Sample, dt: float) -> tuple[Array, None]:
        back = jnp.clip((ticks - 1 - sample.step) // third, 0, 2)
        return acc.at[back].add(_tracking(sample, sample.command)), None

    def finish(acc: Array) -> Array:
        late, middle = acc[0], acc[1]
        safe = jnp.where(middle > 0, middle, jnp.ones_like(middle))
        return root(jnp.where(middle > 0, late / safe, jnp.zeros_like(middle)))

    return Metric(name="growth", init=init, update=update, finish=finish)


# --- what is made of it ------------------------------------------------------------------------


def _arrays(report: Any, plant: Plant) -> dict[str, Array]:
    """Metrics of a batch by column, leaves (lanes,) or (lanes, axes), in display units."""
    table = {}
    for metric in reported_metrics(report, plant, batch=1):
        if metric.axes:
            table[metric.key] = root(jnp.mean(metric.values**2, axis=-1))
        table |= metric.columns()
    return table


class MetricColumns(NamedTuple):
    """Metrics of a batch of runs, in display units.

    Attributes:
        columns: (lanes,) each.
        pieces: of a column that is a root mean square, (lanes, pieces), whose squares add up to
            that of the column.
    """

    columns: dict[str, Array]
    pieces: dict[str, Array]


def training_columns(case: Case, metric: TrainingMetric, report: Any) -> MetricColumns:
    """The columns of a batch of runs.

    Args:
        case: of the runs.
        metric: that they computed.
        report: of `rollouts`; no NaN.
    """
    table = _arrays(report["scored"], case.loop.plant) if "scored" in report else {}
    squares, parts = _mean_squares(case), {}
    for name in metric.columns:
        if name in squares:
            parts[name] = root(report["pieces"][squares[name].name]) * squares[name].scale
            table[name] = root(jnp.sum(parts[name] ** 2, axis=-1))
    if GROWTH in metric.columns:
        table[GROWTH] = report["growth"]
    return MetricColumns({name: table[name] for name in metric.columns}, parts)
