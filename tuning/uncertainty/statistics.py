"""Statistics of a Monte-Carlo sample: yield, quantiles, conditional value at risk, pairs.

Every estimate comes with a 95 % interval; where the runs are too few for a claim, it says so.
Metrics are errors: smaller is better. A lost run has no value and counts as worse than all.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import stats

CONFIDENCE = 0.95
RESAMPLES = 999
#: a quantile or a worst share needs so many runs beyond it
TAIL_OF_QUANTILE, TAIL_OF_CVAR = 10, 50
_NUMBERS_AT_ONCE = 4_000_000


class Interval(NamedTuple):
    """An estimate and its interval."""

    value: float
    low: float
    high: float


class Share(NamedTuple):
    """A share of runs with its exact interval (Clopper and Pearson, Biometrika 26, 1934)."""

    count: int
    of: int
    value: float
    low: float
    high: float

    def text(self) -> str:
        """In per cent, with the interval."""
        return f"{self.value:.2%} ({self.low:.2%}..{self.high:.2%})"


def share(count: int, of: int, confidence: float = CONFIDENCE) -> Share:
    """count of ``of`` runs; the interval covers the true probability at least so often."""
    if of < 1:
        return Share(0, 0, math.nan, 0.0, 1.0)
    interval = stats.binomtest(count, of).proportion_ci(confidence, method="exact")
    return Share(count, of, count / of, float(interval.low), float(interval.high))


class YieldClaim(NamedTuple):
    """Whether a share of at least ``target`` is shown, refuted, or open. needed: runs that would
    decide it if the share stays as it is, None where no number would."""

    target: float
    verdict: str
    needed: int | None

    def text(self) -> str:
        """The verdict, and how many runs would decide where it is open."""
        needed = f": about {self.needed} runs would decide it" if self.needed else ""
        return f"{self.verdict}{needed}"


SHOWN, REFUTED, OPEN = "shown", "refuted", "not enough samples"


def claim(met: Share, target: float, confidence: float = CONFIDENCE) -> YieldClaim:
    """Judge the claim that the true share is at least ``target``, in (0, 1)."""
    if not 0 < target < 1:
        raise ValueError(f"--target {target:g}: must be > 0 and < 1")
    if met.low >= target:
        return YieldClaim(target, SHOWN, None)
    if met.high < target:
        return YieldClaim(target, REFUTED, None)
    return YieldClaim(target, OPEN, _needed(met, target, confidence))


def _needed(met: Share, target: float, confidence: float) -> int | None:
    """The fewest runs, by doubling and halving, that decide if the share stays as it is."""
    if not met.of:
        return None

    def decided(runs: int) -> bool:
        later = share(round(met.value * runs), runs, confidence)
        return later.low >= target or later.high < target

    high = met.of
    while not decided(high):
        high *= 2
        if high > 10**9:
            return None
    low = high // 2
    while high - low > max(1, high // 100):
        middle = (low + high) // 2
        low, high = (low, middle) if decided(middle) else (middle, high)
    return high


def percentile(level: float) -> Callable[..., np.ndarray]:
    """The statistic: that percentile along an axis, one of the values."""

    def statistic(x: np.ndarray, axis: int = -1) -> np.ndarray:
        return np.percentile(x, level, axis=axis, method="higher")

    return statistic


def worst_mean(x: np.ndarray, axis: int = -1, level: float = 0.95) -> np.ndarray:
    """Conditional value at risk: the mean of the worst 1 - level along an axis.

    Rockafellar and Uryasev, Journal of Risk 2, 2000.
    """
    x = np.moveaxis(x, axis, -1)
    kept = math.ceil(round((1 - level) * x.shape[-1], 9))
    return np.mean(np.partition(x, x.shape[-1] - kept, axis=-1)[..., -kept:], axis=-1)


def bootstrap(
    values: np.ndarray,
    statistic: Callable[..., np.ndarray],
    seed: int = 0,
    confidence: float = CONFIDENCE,
) -> Interval:
    """Percentile bootstrap of a statistic of values (n,), with `RESAMPLES` resamples.

    Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section 13.3.
    """
    resampled = stats.bootstrap(
        (values,),
        statistic,
        n_resamples=RESAMPLES,
        vectorized=True,
        axis=-1,
        method="percentile",
        confidence_level=confidence,
        batch=max(1, _NUMBERS_AT_ONCE // len(values)),
        rng=np.random.default_rng(seed),
    )
    interval = resampled.confidence_interval
    return Interval(float(statistic(values)), float(interval.low), float(interval.high))


class MetricStatistics(NamedTuple):
    """Statistics of one metric. An entry is None where it cannot be said; ``reasons`` says why.

    Attributes:
        mean: Of the runs that were not lost.
        p50, p95: Median and 95 % quantile; lost runs count as worst.
        cvar95: Conditional value at risk, the mean of the worst 5 %.
        reasons: Name of an entry that is None -> why.
    """

    mean: Interval | None
    p50: Interval | None
    p95: Interval | None
    cvar95: Interval | None
    reasons: dict[str, str]


def metric_statistics(values: np.ndarray) -> MetricStatistics:
    """Statistics of a metric, (n,), NaN where a run was lost."""
    ranked = np.where(np.isnan(values), np.inf, values)
    complete = values[np.isfinite(values)]
    lost, runs = len(values) - len(complete), len(values)
    reasons: dict[str, str] = {}

    def refused(name: str, tail: float, least: int) -> bool:
        if lost >= tail * runs:
            reasons[name] = f"{lost} of {runs} runs have no value"
        elif tail * runs < least:
            reasons[name] = f"not enough samples: needs {math.ceil(round(least / tail, 6))} runs"
        return name in reasons

    mean = None
    if len(complete) < 2:
        reasons["mean"] = f"{len(complete)} of {runs} runs have a value"
    else:
        mean = bootstrap(complete, np.mean)
    p50 = None if refused("p50", 0.5, TAIL_OF_QUANTILE) else _ranked(ranked, 50)
    p95 = None if refused("p95", 0.05, TAIL_OF_QUANTILE) else _ranked(ranked, 95)
    if lost:
        reasons["cvar95"] = f"{lost} of {runs} runs, the worst, have no value"
    none = lost or refused("cvar95", 0.05, TAIL_OF_CVAR)
    cvar95 = None if none else bootstrap(values, worst_mean)
    return MetricStatistics(mean, p50, p95, cvar95, reasons)


def _ranked(ranked: np.ndarray, level: float) -> Interval:
    """A percentile of values that may be infinite: what lies above all finite ones is."""
    largest = np.max(ranked[np.isfinite(ranked)])
    interval = bootstrap(np.minimum(ranked, largest + 1), percentile(level))
    return Interval(*(math.inf if x > largest else x for x in interval))


class PairedComparison(NamedTuple):
    """Paired comparison: two controllers on the same plants.

    Attributes:
        first, second: Their names.
        plants: How many plants both met.
        survived: Plants that neither lost.
        difference: Of the metrics, first minus second, mean over the survived plants.
        better: Plants on which the first has the smaller metric, a lost run losing to any other;
            plants on which both are lost count for neither.
    """

    first: str
    second: str
    plants: int
    survived: int
    difference: Interval | None
    better: Share


def paired(first: str, a: np.ndarray, second: str, b: np.ndarray) -> PairedComparison:
    """Compare two metrics run by run, (n,) each, NaN where lost."""
    both = np.isfinite(a) & np.isfinite(b)
    gap = (a - b)[both]
    better = int(np.sum(np.where(np.isnan(a), np.inf, a) < np.where(np.isnan(b), np.inf, b)))
    difference = bootstrap(gap, np.mean) if len(gap) > 1 else None
    return PairedComparison(first, second, len(a), len(gap), difference, share(better, len(a)))
