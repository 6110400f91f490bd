"""What an adaptive sliding law ended with."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.model.blocks import Metric
from jaxstage.model.fields import part, pytree, signal
from jaxstage.model.signals import Sample, Setpoint


@pytree
class Adapted:
    """Slope, switching gain and sharpness of each axis in the last tick."""

    surface_slope_end: Array = signal("1/s", "c", "slope of the surface", shape="(axes,)")
    switching_gain_end: Array = signal("m/s2", "eps", "switching gain", shape="(axes,)")
    sharpness_end: Array = signal("s/m", "a", "sharpness of the switch", shape="(axes,)")
    sampled_gain_end: Array = signal(
        "1", "eps a T/2 + c T", "change of s in a period per s", shape="(axes,)"
    )


@pytree
class LastAdapted:
    """The values of the last tick, if there was one."""

    values: Adapted = part("values of the last tick")
    seen: Array = signal("1", "", "1 once there was a tick")


@functools.cache
def adapted(pick: Callable[[Any, float], tuple[Array, Array, Array, Array]]) -> Metric:
    """The adapted values that the law used last.

    pick(memory, dt): c, eps, a and eps a T/2 + c T, each (axes,), out of the law's memory.
    """

    def gather(values: tuple[Array, Array, Array, Array]) -> Adapted:
        slope, gain, sharpness, sampled = values
        return Adapted(
            surface_slope_end=slope,
            switching_gain_end=gain,
            sharpness_end=sharpness,
            sampled_gain_end=sampled,
        )

    def init(setpoint: Setpoint) -> LastAdapted:
        none = jnp.zeros_like(setpoint.position)
        return LastAdapted(values=gather((none, none, none, none)), seen=none[0])

    def update(acc: LastAdapted, sample: Sample, dt: float) -> tuple[LastAdapted, None]:
        values = gather(pick(sample.memory, dt))
        return LastAdapted(values=values, seen=jnp.ones_like(acc.seen)), None

    def finish(acc: LastAdapted) -> Adapted:
        return jax.tree.map(lambda x: jnp.where(acc.seen > 0, x, jnp.nan), acc.values)

    return Metric(name="adapted", init=init, update=update, finish=finish)
