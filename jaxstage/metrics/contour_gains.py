"""What a scheduled cross-coupled law made of its gains."""

import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import part, pytree, signal
from jaxstage.model.signals import Sample, Setpoint


@pytree
class ContourGains:
    """K_P, K_I, K_D of a cross-coupled law: mean over the run, and at its end."""

    contour_proportional_mean: Array = signal("1/s2", "K_P", "mean gain on the contour error")
    contour_integral_mean: Array = signal("1/s3", "K_I", "mean gain on its integral")
    contour_derivative_mean: Array = signal("1/s", "K_D", "mean gain on its rate")
    contour_proportional_end: Array = signal("1/s2", "K_P", "gain at the end")
    contour_integral_end: Array = signal("1/s3", "K_I", "gain at the end")
    contour_derivative_end: Array = signal("1/s", "K_D", "gain at the end")


@pytree
class GainSums:
    """Moments of the three gains, and the last of them."""

    gains: Moments = part("moments of the three gains")
    last: Array = signal("1", "", "the gains of the last tick, each in its unit", shape="(3,)")


@functools.cache
def contour_gains(pick: Callable[[Any], tuple[Array, Array, Array]]) -> Metric:
    """Mean and end of K_P, K_I, K_D; ``pick(memory)`` takes them out of the memory."""

    def init(setpoint: Setpoint) -> GainSums:
        none = jnp.zeros(3, setpoint.position.dtype)
        return GainSums(gains=moments.empty(none), last=none)

    def update(acc: GainSums, sample: Sample, dt: float) -> tuple[GainSums, None]:
        now = jnp.stack(pick(sample.memory))
        return GainSums(gains=moments.add(acc.gains, now), last=now), None

    def finish(acc: GainSums) -> ContourGains:
        mean = moments.mean(acc.gains)
        return ContourGains(
            contour_proportional_mean=mean[0],
            contour_integral_mean=mean[1],
            contour_derivative_mean=mean[2],
            contour_proportional_end=acc.last[0],
            contour_integral_end=acc.last[1],
            contour_derivative_end=acc.last[2],
        )

    return Metric(name="contour_gains", init=init, update=update, finish=finish)
