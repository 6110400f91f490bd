"""Sensitivity of a metric to uncertain values: Sobol indices, rank correlation, tornado.

Sobol indices need a sweep of the design ``saltelli`` and independent values; S1 is the share of
the metric's variance that a value explains on its own, ST the share with all its interactions
(Saltelli et al., Comput. Phys. Commun. 181, 2010; computed by SALib). The tornado needs one
differentiated run: the slope at the nominal plant, times the spread.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from scipy import stats

from jaxstage.metrics.table import reported_metrics
from jaxstage.model.fields import replace
from jaxstage.simulate.gradients import select, value_and_gradient
from jaxstage.simulate.rollout import simulate
from jaxstage.studies import Case
from tuning.uncertainty.uncertain_space import Space, Uncertain

#: of the blocks of a Saltelli design, how many may hold a lost run before no index is given
MOST_LOST = 0.1
#: runs that a tenth of the sweep can speak for
FEWEST = 100
#: the tornado goes from this quantile to its mirror image
QUANTILE = 0.05


class Indices(NamedTuple):
    """Sobol indices of uncertain numbers, with the half width of their 95 % intervals.

    Attributes:
        names: Labels of the numbers, n of them.
        first, first_error: S1, (n,).
        total, total_error: ST, (n,).
        dropped: Share of the blocks that were left out, as they hold a lost run.
    """

    names: tuple[str, ...]
    first: np.ndarray
    first_error: np.ndarray
    total: np.ndarray
    total_error: np.ndarray
    dropped: float

    def rows(self) -> Iterator[tuple[Any, ...]]:
        """Name, S1, its error, ST, its error of each number."""
        return zip(
            self.names,
            self.first,
            self.first_error,
            self.total,
            self.total_error,
            strict=True,
        )


def names_of(space: Space) -> tuple[str, ...]:
    """One label an independent number: the setting, with its axis where each has its own."""
    return tuple(label for item in space.uncertain for label in item.numbers().values())


def sobol_indices(names: Sequence[str], values: np.ndarray, seed: int = 0) -> Indices:
    """Sobol indices of a metric over a Saltelli design.

    Args:
        names: Labels of the n uncertain numbers.
        values: The metric, (blocks x (n + 2),), NaN where a run was lost.
        seed: Of the bootstrap of the intervals.

    Raises:
        ValueError: Without SALib, where over `MOST_LOST` of the blocks hold a lost run, and where
            the metric does not vary.
    """
    try:
        from SALib.analyze import sobol
    except ImportError:
        raise ValueError("Sobol indices need SALib: pip install 'jaxstage[sensitivity]'") from None
    blocks = values.reshape(-1, len(names) + 2)
    whole = np.isfinite(blocks).all(axis=1)
    dropped = 1 - float(np.mean(whole))
    if dropped > MOST_LOST:
        raise ValueError(
            f"{dropped:.0%} of the blocks hold a lost run (at most {MOST_LOST:.0%}): what is left "
            "is no sample of the spreads, so there are no Sobol indices"
        )
    if np.ptp(blocks[whole]) == 0:
        raise ValueError("the metric is the same in all runs: there are no Sobol indices")
    problem = {"num_vars": len(names), "names": list(names), "bounds": [[0, 1]] * len(names)}
    answer = sobol.analyze(
        problem, blocks[whole].reshape(-1), calc_second_order=False, num_resamples=200, seed=seed
    )
    first, first_error, total, total_error = (
        np.asarray(answer[name]) for name in ("S1", "S1_conf", "ST", "ST_conf")
    )
    return Indices(tuple(names), first, first_error, total, total_error, dropped)


def rank_correlation(parameter: np.ndarray, values: np.ndarray) -> float | None:
    """Spearman's rho of a parameter and a metric, (n,) each; None where there is none. Lost runs,
    NaN, are worse than all others: what breaks a loop must not drop out of its reasons."""
    ranks = [stats.rankdata(x) for x in (parameter, np.where(np.isnan(values), np.inf, values))]
    if len(values) < 3 or not all(np.ptp(rank) for rank in ranks):
        return None
    return float(np.corrcoef(*ranks)[0, 1])


def at_the_ends(parameter: np.ndarray, values: np.ndarray) -> tuple[float, float] | None:
    """Median metric in the lowest and in the highest tenth of a parameter, (n,) each: what the
    sweep itself says about the effect of that value. None for fewer than `FEWEST` runs."""
    if len(values) < FEWEST:
        return None
    low, high = np.quantile(parameter, [0.1, 0.9])
    with np.errstate(invalid="ignore"):
        ends = (values[parameter <= low], values[parameter >= high])
    medians = [float(np.median(np.where(np.isnan(end), np.inf, end))) for end in ends]
    return (medians[0], medians[1]) if np.isfinite(medians).all() else None


class Bar(NamedTuple):
    """One number of a tornado: the metric, to first order, at its 5 % and 95 % quantile.

    column: of the value in the table of runs.
    """

    name: str
    column: str
    low: float
    high: float


class Tornado(NamedTuple):
    """First-order effects, widest first.

    Attributes:
        nominal: The metric of the nominal plant.
        bars: One a number, by descending width.
        left_out: Settings that have no slope: whole numbers, values of the reference, and what is
            nominally without limit.
    """

    nominal: float
    bars: tuple[Bar, ...]
    left_out: tuple[str, ...]


def tornado(case: Case, space: Space, column: str) -> Tornado:
    """The effect of each uncertain number on a metric, from one run in reverse mode.

    J(x) = J(x0) + dJ/dx (x - x0), at x of the quantiles `QUANTILE` and 1 - `QUANTILE`.

    Args:
        case: The nominal plant x0.
        space: What is uncertain.
        column: A metric as `metric_columns` names it.

    Raises:
        ValueError: Where the nominal run is lost, and where no slope is finite.
    """
    items = [item for item in space.uncertain if _has_slope(item)]
    if not items:
        raise ValueError("no uncertain value has a slope: there is no tornado")
    chosen = select((), case.scenario, tuple(item.path for item in items))
    segment = max(1, math.isqrt(case.window.ticks))
    loop = replace(case.loop, segment=segment)
    metric = _metric(case, column)

    def function(x: Array) -> Array:
        _, scenario = chosen.rebuild(x)
        return metric(simulate(loop, case.gains, scenario, case.path, case.window.ticks).report)

    value, slope = jax.jit(value_and_gradient(function, forward=False))(chosen.vector)
    if not np.isfinite(value):
        raise ValueError("the nominal run is lost: there is no tornado")
    if not np.isfinite(slope).all():
        raise ValueError("the slope of the nominal run is not finite: there is no tornado")
    bars, at, slopes = [], 0, np.asarray(slope, float)
    for item in items:
        part = slopes[at : at + item.nominal.size]
        at += item.nominal.size
        ends = [item.values(np.full((1, item.count()), q))[0].reshape(-1) for q in _ends(item)]
        effect = [part * (end - item.nominal.reshape(-1)) for end in ends]
        effect = [[e.sum()] for e in effect] if item.shared else effect
        bars += [
            Bar(name, column, float(value) + float(low), float(value) + float(high))
            for (column, name), low, high in zip(item.numbers().items(), *effect, strict=True)
        ]
    bars.sort(key=lambda bar: -abs(bar.high - bar.low))
    left_out = tuple(item.path for item in space.uncertain if item not in items)
    return Tornado(float(value), tuple(bars), left_out)


def _has_slope(item: Uncertain) -> bool:
    counted = item.path == "drive.delay"  # in whole control periods
    return not (counted or item.path.startswith("reference.")) and bool(
        np.isfinite(item.nominal).all()
    )


def _ends(item: Uncertain) -> tuple[float, float]:
    low, high = item.distribution.quantile(np.array([QUANTILE, 1 - QUANTILE]))
    return float(low), float(high)


def _metric(case: Case, column: str) -> Callable[[Any], Array]:
    """Picks a column, in its display unit, out of a report that may be traced."""

    def pick(report: Any) -> Array:
        for metric in reported_metrics(report, case.loop.plant):
            if column in metric.columns():
                return metric.columns()[column]
        raise ValueError(f"{case.name} has no metric {column}")

    return pick
