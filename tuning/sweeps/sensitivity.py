"""Which uncertain value matters: Sobol indices, rank correlation, and the gradient tornado.

Sobol indices need a sweep of the design ``saltelli`` and independent values; S1 is the share of
the figure's variance that a value explains on its own, ST the share with all its interactions
(Saltelli et al., Comput. Phys. Commun. 181, 2010; computed by SALib). The tornado needs one
differentiated run: the slope at the nominal plant, times the spread.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from scipy import stats

from jaxstage.fields import in_units_of, leaves, replace
from jaxstage.gradients import select, value_and_gradient
from jaxstage.metrics.table import key
from jaxstage.rollout import simulate
from jaxstage.studies import Case
from tuning.scenarios import Space

#: of the blocks of a Saltelli design, how many may hold a lost run before no index is given
MOST_LOST = 0.1
#: runs that a tenth of the sweep can speak for
FEWEST = 100
#: the tornado goes from this quantile to its mirror image
QUANTILE = 0.05


class Indices(NamedTuple):
    """Sobol indices of the uncertain numbers, and the half width of their 95 % intervals.

    dropped: share of the blocks that were left out, as they hold a lost run.
    """

    names: tuple[str, ...]
    first: np.ndarray
    first_error: np.ndarray
    total: np.ndarray
    total_error: np.ndarray
    dropped: float


def names_of(space: Space) -> tuple[str, ...]:
    """One label an independent number: the setting, with its axis where each has its own."""
    return tuple(label for item in space.uncertain for label in item.numbers().values())


def sobol_indices(names: Sequence[str], values: np.ndarray, seed: int = 0) -> Indices:
    """Indices of a figure over a Saltelli design, (blocks x (len(names) + 2),), NaN where lost.

    Raises ValueError where SALib is not installed, or too many blocks hold a lost run.
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
    problem = {"num_vars": len(names), "names": list(names), "bounds": [[0, 1]] * len(names)}
    found = sobol.analyze(
        problem, blocks[whole].reshape(-1), calc_second_order=False, num_resamples=200, seed=seed
    )
    first, first_error, total, total_error = (
        np.asarray(found[name]) for name in ("S1", "S1_conf", "ST", "ST_conf")
    )
    return Indices(tuple(names), first, first_error, total, total_error, dropped)


def rank_correlation(parameter: np.ndarray, values: np.ndarray) -> float | None:
    """Spearman's rho of a parameter and a figure, (n,) each, where there is one."""
    kept = np.isfinite(values)
    if kept.sum() < 3 or np.ptp(parameter[kept]) == 0 or np.ptp(values[kept]) == 0:
        return None
    return float(np.corrcoef(stats.rankdata(parameter[kept]), stats.rankdata(values[kept]))[0, 1])


def at_the_ends(parameter: np.ndarray, values: np.ndarray) -> tuple[float, float] | None:
    """Median figure of the plants in the lowest and in the highest tenth of a parameter, (n,) each:
    what the sweep itself says about the effect of that value. None for fewer than `FEWEST`."""
    if len(values) < FEWEST:
        return None
    low, high = np.quantile(parameter, [0.1, 0.9])
    with np.errstate(invalid="ignore"):
        ends = (values[parameter <= low], values[parameter >= high])
    medians = [float(np.median(np.where(np.isnan(end), np.inf, end))) for end in ends]
    return (medians[0], medians[1]) if np.isfinite(medians).all() else None


class Bar(NamedTuple):
    """One number of a tornado: the figure, to first order, at its 5 % and 95 % quantile.

    column: of the value in the table of runs.
    """

    name: str
    column: str
    low: float
    high: float


class Tornado(NamedTuple):
    """nominal: the figure of the nominal plant. bars: by descending width. left_out: what has no
    slope here (values of the reference)."""

    nominal: float
    bars: tuple[Bar, ...]
    left_out: tuple[str, ...]


def tornado(case: Case, space: Space, column: str) -> Tornado:
    """The effect of each uncertain number on a figure, from one run in reverse mode.

    column: a figure as `rows.figure_columns` names it. Raises ValueError where the nominal run is
    lost.
    """
    items = [item for item in space.uncertain if not item.path.startswith("reference.")]
    chosen = select((), case.scenario, tuple(item.path for item in items))
    segment = max(1, math.isqrt(case.window.ticks))
    loop = replace(case.loop, segment=segment)
    figure = _figure(case, column)

    def function(x: Array) -> Array:
        _, scenario = chosen.rebuild(x)
        return figure(simulate(loop, case.gains, scenario, case.path, case.window.ticks).report)

    value, slope = jax.jit(value_and_gradient(function, forward=False))(chosen.vector)
    if not np.isfinite(value):
        raise ValueError(f"the nominal run of {case.name} is lost: there is no slope")
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


def _ends(item: Any) -> tuple[float, float]:
    low, high = item.distribution.quantile(np.array([QUANTILE, 1 - QUANTILE]))
    return float(low), float(high)


def _figure(case: Case, column: str) -> Callable[[Any], Array]:
    """Picks a column, in its display unit, out of a report that may be traced."""

    def pick(report: Any) -> Array:
        plant = case.loop.plant
        for path, general, value in leaves(report):
            quantity = in_units_of(general, plant.command_unit)
            name = path.rsplit(".", 1)[-1]
            if key(name, quantity.shown) == column and value.ndim == 0:
                return value * quantity.factor
            for i, axis in enumerate(plant.axes):
                if value.ndim and key(f"{name}_{axis}", quantity.shown) == column:
                    return value[i] * quantity.factor
        raise ValueError(f"{case.name} has no figure {column}")

    return pick
