"""Probability distributions as quantile functions, so that any design in [0, 1] draws them.

Each maker checks its numbers and raises ValueError, naming the one that is wrong.
"""

import functools
import inspect
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from jaxstage.model.fields import definition
from jaxstage.model.settings import nearest_name

#: probabilities outside [TAIL, 1 - TAIL] are drawn as its ends: 6.2 standard deviations
TAIL = 2.0**-32
#: the corner of a value without bounds, in standard deviations
CORNER = 3.0


@definition
class Distribution:
    """A distribution of one number.

    Attributes:
        text: For people.
        quantile: Probabilities in [0, 1] to values, elementwise.
        low, high: The corners: bounds of the values where they have any.
    """

    text: str
    quantile: Callable[[np.ndarray], np.ndarray]
    low: float
    high: float


def _finite(**numbers: float) -> None:
    for name, value in numbers.items():
        if not math.isfinite(value):
            raise ValueError(f"{name} = {value}: must be finite")


def _ordered(low: float, high: float) -> None:
    if not low < high:
        raise ValueError(f"low = {low:g}, high = {high:g}: low must be < high")


def _positive(name: str, value: float) -> None:
    if not value > 0:
        raise ValueError(f"{name} = {value:g}: must be > 0")


@functools.cache
def uniform(low: float, high: float) -> Distribution:
    """Uniform: quantile low + (high - low) p."""
    _finite(low=low, high=high)
    _ordered(low, high)

    def quantile(p: np.ndarray) -> np.ndarray:
        return low + (high - low) * p

    return Distribution(text=f"uniform {low:g}..{high:g}", quantile=quantile, low=low, high=high)


@functools.cache
def triangular(low: float, mode: float, high: float) -> Distribution:
    """Triangular: density rising from low to mode and falling to high."""
    _finite(low=low, mode=mode, high=high)
    _ordered(low, high)
    if not low <= mode <= high:
        raise ValueError(f"mode = {mode:g}: must be in {low:g}..{high:g}")
    width, share = high - low, (mode - low) / (high - low)

    def quantile(p: np.ndarray) -> np.ndarray:
        rising = low + width * np.sqrt(share * p)
        falling = high - width * np.sqrt((1 - share) * (1 - p))
        return np.where(p < share, rising, falling)

    text = f"triangular {low:g}..{mode:g}..{high:g}"
    return Distribution(text=text, quantile=quantile, low=low, high=high)


@functools.cache
def normal(
    mean: float, deviation: float, low: float = -math.inf, high: float = math.inf
) -> Distribution:
    """Normal with mean and standard deviation, truncated to low..high.

    With F the distribution of the standard normal, quantile = mean + deviation F^-1(F(a) + p
    (F(b) - F(a))), a and b the standardised bounds.
    """
    _finite(mean=mean, deviation=deviation)
    _positive("deviation", deviation)
    _ordered(low, high)
    left, right = ndtr((low - mean) / deviation), ndtr((high - mean) / deviation)
    if not right - left > TAIL:
        raise ValueError(f"low = {low:g}, high = {high:g}: nothing of the distribution is left")

    def quantile(p: np.ndarray) -> np.ndarray:
        within = left + np.clip(p, TAIL, 1 - TAIL) * (right - left)
        return np.clip(mean + deviation * ndtri(within), low, high)

    cut = "" if left == 0 and right == 1 else f", cut to {low:g}..{high:g}"
    return Distribution(
        text=f"normal {mean:g} +- {deviation:g}{cut}",
        quantile=quantile,
        low=max(low, mean - CORNER * deviation),
        high=min(high, mean + CORNER * deviation),
    )


@functools.cache
def lognormal(
    median: float, deviation: float, low: float = 0.0, high: float = math.inf
) -> Distribution:
    """Log-normal: exp of a normal with mean log(median) and standard deviation ``deviation``,
    truncated to low..high."""
    _finite(median=median, deviation=deviation, low=low)
    _positive("median", median)
    if low < 0:
        raise ValueError(f"low = {low:g}: must be >= 0")
    _ordered(low, high)
    least = math.log(low) if low > 0 else -math.inf
    most = math.log(high) if math.isfinite(high) else math.inf
    logarithm = normal(math.log(median), deviation, least, most)

    def quantile(p: np.ndarray) -> np.ndarray:
        return np.exp(logarithm.quantile(p))

    cut = "" if low == 0 and math.isinf(high) else f", cut to {low:g}..{high:g}"
    try:
        ends = math.exp(logarithm.low), math.exp(logarithm.high)
    except OverflowError:
        raise ValueError(f"median = {median:g}, deviation = {deviation:g}: too wide") from None
    text = f"log-normal {median:g}, deviation {deviation:g}{cut}"
    return Distribution(text=text, quantile=quantile, low=ends[0], high=ends[1])


@functools.cache
def discrete(values: tuple[float, ...], weights: tuple[float, ...] = ()) -> Distribution:
    """Categorical over numbers: one of the values, each with probability weight / sum(weights);
    all alike if the weights are left out."""
    weights = weights or (1.0,) * len(values)
    if not values or len(values) != len(weights):
        raise ValueError(f"{len(values)} values with {len(weights)} weights: must be as many")
    _finite(**{f"values[{i}]": v for i, v in enumerate(values)})
    for index, weight in enumerate(weights):
        if not (math.isfinite(weight) and weight > 0):
            raise ValueError(f"weights[{index}] = {weight:g}: must be > 0")
    order = np.argsort(values)
    steps = np.cumsum(np.asarray(weights)[order])
    bounds, ordered = steps[:-1] / steps[-1], np.asarray(values, float)[order]

    def quantile(p: np.ndarray) -> np.ndarray:
        return ordered[np.searchsorted(bounds, p, side="right")]

    text = "one of " + ", ".join(f"{v:g}" for v in values)
    return Distribution(
        text=text, quantile=quantile, low=float(ordered[0]), high=float(ordered[-1])
    )


#: by the names that a scenario file uses
DISTRIBUTIONS: dict[str, Callable[..., Distribution]] = {
    maker.__name__: maker for maker in (normal, lognormal, uniform, triangular, discrete)
}

#: arguments of the makers that are lists
LISTS = ("values", "weights")


def from_table(table: Mapping[str, Any]) -> Distribution:
    """The distribution that a table names: ``distribution`` and the arguments of its maker.

    Raises ValueError for an unknown name, an argument that is missing or unknown, no number.
    """
    name = table.get("distribution")
    if not isinstance(name, str) or name not in DISTRIBUTIONS:
        hint = nearest_name(str(name), DISTRIBUTIONS)
        raise ValueError(f"distribution = {name}{hint}: one of {', '.join(DISTRIBUTIONS)}")
    maker = DISTRIBUTIONS[name]
    numbers = {key: _argument(key, value) for key, value in table.items() if key != "distribution"}
    try:
        inspect.signature(maker).bind(**numbers)
    except TypeError as error:
        raise ValueError(f"{name}: {error}") from None
    return maker(**numbers)


def _argument(name: str, value: Any) -> float | tuple[float, ...]:
    if name not in LISTS:
        return _number(name, value)
    if not isinstance(value, list | tuple):
        raise ValueError(f"{name} = {value}: must be a list of numbers")
    return tuple(_number(f"{name}[{i}]", v) for i, v in enumerate(value))


def _number(name: str, value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise ValueError(f"{name} = {value}: must be a number")
    try:
        return float(value)
    except OverflowError:
        bits = int(value).bit_length()
        raise ValueError(f"{name}: a number of {bits} bits, must be finite") from None
