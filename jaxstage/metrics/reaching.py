"""What an adaptive reaching gain does."""

import functools
from collections.abc import Callable
from typing import Any

from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import pytree, signal
from jaxstage.model.signals import Sample, Setpoint


@pytree
class ReachingGainUsed:
    """Reaching gain of each axis, as the law used it."""

    reaching_gain_mean: Array = signal("1/s", "", "mean", shape="(axes,)")
    reaching_gain_max: Array = signal("1/s", "", "largest", shape="(axes,)")


@functools.cache
def reaching_gain(gain: Callable[[Any], Array]) -> Metric:
    """Mean and maximum of K; ``gain(memory)`` picks K (axes,) in 1/s out of the memory."""

    def update(acc: Moments, sample: Sample, dt: float) -> tuple[Moments, None]:
        return moments.add(acc, gain(sample.memory)), None

    def init(setpoint: Setpoint) -> Moments:
        return moments.empty(setpoint.position)

    def finish(acc: Moments) -> ReachingGainUsed:
        return ReachingGainUsed(
            reaching_gain_mean=moments.mean(acc), reaching_gain_max=moments.largest(acc)
        )

    return Metric(name="reaching_gain", init=init, update=update, finish=finish)
