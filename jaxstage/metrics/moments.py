"""Running moments: mean, RMS, maximum and variance of a signal, without cancellation."""

from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

from jaxstage.model.blocks import Metric, Report
from jaxstage.model.fields import pytree, signal
from jaxstage.model.signals import Sample, Setpoint


@pytree
class Moments:
    """Count, mean, sum of squared deviations and largest magnitude of a signal."""

    count: Array = signal("1", "n", "samples so far")
    mean: Array = signal("1", "", "running mean, in the unit of the signal", shape="any")
    spread: Array = signal("1", "", "sum of squared deviations from the mean", shape="any")
    largest: Array = signal("1", "", "largest magnitude", shape="any")


def empty(like: Array) -> Moments:
    """No samples yet of a signal with the shape and type of ``like``."""
    zero = jnp.zeros_like(like)
    return Moments(count=jnp.zeros((), like.dtype), mean=zero, spread=zero, largest=zero)


def add(moments: Moments, value: Array) -> Moments:
    """One more sample (Welford): float32 sums of 1e5 samples keep their digits.

    m <- m + (x - m)/n,   S <- S + (x - m_before)(x - m)
    """
    count = moments.count + 1
    delta = value - moments.mean
    mean = moments.mean + delta / count
    return Moments(
        count=count,
        mean=mean,
        spread=moments.spread + delta * (value - mean),
        largest=jnp.maximum(moments.largest, jnp.abs(value)),
    )


def per_sample(moments: Moments) -> Array:
    """1 / count, NaN before the first sample: an empty window has no result."""
    return jnp.where(moments.count > 0, 1 / jnp.maximum(moments.count, 1), jnp.nan)


def mean(moments: Moments) -> Array:
    """Arithmetic mean, NaN without samples."""
    return moments.mean + 0 * per_sample(moments)


def variance(moments: Moments) -> Array:
    """Population variance S / n, NaN without samples."""
    return moments.spread * per_sample(moments)


def mean_square(moments: Moments) -> Array:
    """Mean of the squares, NaN without samples."""
    return variance(moments) + moments.mean**2


def rms(moments: Moments) -> Array:
    """Root of the mean of the squares, NaN without samples."""
    return root(mean_square(moments))


def root(value: Array) -> Array:
    """Square root with gradient 0 at 0."""
    positive = value > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, value, jnp.ones_like(value))), value)


def largest(moments: Moments) -> Array:
    """Largest magnitude, NaN without samples."""
    return moments.largest + 0 * per_sample(moments)


def each_axis(setpoint: Setpoint) -> tuple[Array]:
    """Shape of one signal (axes,), for `moments_of`."""
    return (setpoint.position,)


def one_number(setpoint: Setpoint) -> tuple[Array]:
    """Shape of one scalar signal, for `moments_of`."""
    return (setpoint.position[0],)


def moments_of(
    name: str,
    signals: Callable[[Sample, float], tuple[Array, ...]],
    report: Callable[..., Report],
    like: Callable[[Setpoint], tuple[Array, ...]] = each_axis,
) -> Metric[tuple[Moments, ...], Report]:
    """The metric that keeps the moments of some signals.

    Args:
        name: of the metric.
        signals: ``(sample, dt) -> signals`` of a period.
        report: makes the report of the `Moments` of each of them.
        like: ``setpoint -> arrays`` with the shapes and types of the signals.
    """

    def init(setpoint: Setpoint) -> tuple[Moments, ...]:
        return tuple(empty(array) for array in like(setpoint))

    def update(
        acc: tuple[Moments, ...], sample: Sample, dt: float
    ) -> tuple[tuple[Moments, ...], None]:
        values = signals(sample, dt)
        return tuple(add(m, value) for m, value in zip(acc, values, strict=True)), None

    return Metric(name=name, init=init, update=update, finish=lambda acc: report(*acc))
