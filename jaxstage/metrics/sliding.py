"""What a Lyapunov argument about a sliding variable promises, measured."""

import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxstage.model.blocks import Metric
from jaxstage.model.fields import pytree, signal
from jaxstage.model.signals import Sample, Setpoint


@pytree
class SlidingFigures:
    """Figures of the sliding variable. With s s' <= -eta |s| the share is 1 while s is not 0, the
    integral stays bounded and the mean goes to 0."""

    sliding_integral: Array = signal("m", "int |s| dt", "integral of |s|", shape="(axes,)")
    sliding_mean: Array = signal("m/s", "", "mean of |s|", shape="(axes,)", shown="mm/s")
    reaching_share: Array = signal("1", "", "share of periods in which |s| fell", shape="(axes,)")


@pytree
class SlidingSums:
    """Running sums of |s|."""

    integral: Array = signal("m", "", "integral of |s| so far", shape="(axes,)")
    last: Array = signal("m/s", "", "|s| of the period before", shape="(axes,)")
    fell: Array = signal("1", "", "periods in which |s| fell", shape="(axes,)")
    time: Array = signal("s", "", "time so far")
    count: Array = signal("1", "", "periods so far")


@functools.cache
def sliding_figures(surface: Callable[[Any], Array]) -> Metric:
    """int |s| dt, mean |s| and the share of periods with falling |s|, per axis.

    surface: picks s (axes,) in m/s out of the controller's memory. Means are NaN for an empty
    window, the share for one of a single tick too.
    """

    def init(setpoint: Setpoint) -> SlidingSums:
        zero = jnp.zeros_like(setpoint.position)
        return SlidingSums(integral=zero, last=zero, fell=zero, time=zero[0], count=zero[0])

    def update(acc: SlidingSums, sample: Sample, dt: float) -> tuple[SlidingSums, None]:
        size = jnp.abs(surface(sample.memory))
        fell = (acc.count > 0) & (size < acc.last)
        return SlidingSums(
            integral=acc.integral + size * dt,
            last=size,
            fell=acc.fell + fell.astype(size.dtype),
            time=acc.time + dt,
            count=acc.count + 1,
        ), None

    def finish(acc: SlidingSums) -> SlidingFigures:
        mean = acc.integral / jnp.where(acc.count > 0, acc.time, jnp.nan)
        share = acc.fell / jnp.where(acc.count > 1, acc.count - 1, jnp.nan)
        return SlidingFigures(
            sliding_integral=acc.integral, sliding_mean=mean, reaching_share=share
        )

    return Metric(name="sliding_figures", init=init, update=update, finish=finish)
