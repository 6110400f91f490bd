"""Metrics of a law's own memory: sliding variable, reaching gain, adapted and scheduled gains."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments, moments_of
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import part, pytree, signal
from jaxstage.model.signals import Sample, Setpoint

AXES = "(axes,)"

# --- sliding variable --------------------------------------------------------------------------


@pytree
class SlidingMetrics:
    """What a Lyapunov argument promises of the sliding variable s, measured.

    With s s' <= -eta |s| the share is 1 while s is not 0, the integral stays bounded and the mean
    goes to 0.
    """

    sliding_integral: Array = signal("m", "int |s| dt", "integral of |s|", shape=AXES)
    sliding_mean: Array = signal("m/s", "", "mean of |s|", shape=AXES, shown="mm/s")
    reaching_share: Array = signal("1", "", "share of periods in which |s| fell", shape=AXES)


@pytree
class SlidingSums:
    """Running sums of |s|."""

    integral: Array = signal("m", "", "integral of |s| so far", shape=AXES)
    last: Array = signal("m/s", "", "|s| of the period before", shape=AXES)
    fell: Array = signal("1", "", "periods in which |s| fell", shape=AXES)
    time: Array = signal("s", "", "time so far")
    count: Array = signal("1", "", "periods so far")


@functools.cache
def sliding_metrics(surface: Callable[[Any], Array]) -> Metric[SlidingSums, SlidingMetrics]:
    """int |s| dt, mean |s| and the share of periods with falling |s|, per axis.

    Means are NaN for an empty window, the share for one of a single tick too.

    Args:
        surface: picks s (axes,) in m/s out of the controller's memory.
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

    def finish(acc: SlidingSums) -> SlidingMetrics:
        return SlidingMetrics(
            sliding_integral=acc.integral,
            sliding_mean=acc.integral / jnp.where(acc.count > 0, acc.time, jnp.nan),
            reaching_share=acc.fell / jnp.where(acc.count > 1, acc.count - 1, jnp.nan),
        )

    return Metric(name="sliding_metrics", init=init, update=update, finish=finish)


# --- reaching gain -----------------------------------------------------------------------------


@pytree
class ReachingGainUsed:
    """Reaching gain of each axis, as the law used it."""

    reaching_gain_mean: Array = signal("1/s", "", "mean", shape=AXES)
    reaching_gain_max: Array = signal("1/s", "", "largest", shape=AXES)


@functools.cache
def reaching_gain(
    gain: Callable[[Any], Array],
) -> Metric[tuple[Moments, ...], ReachingGainUsed]:
    """Mean and maximum of K; ``gain(memory)`` picks K (axes,) in 1/s out of the memory."""

    def report(used: Moments) -> ReachingGainUsed:
        return ReachingGainUsed(
            reaching_gain_mean=moments.mean(used), reaching_gain_max=moments.largest(used)
        )

    return moments_of("reaching_gain", lambda sample, dt: (gain(sample.memory),), report)


# --- adapted gains -----------------------------------------------------------------------------


@pytree
class Adapted:
    """Slope, switching gain and sharpness of each axis in the last tick."""

    surface_slope_end: Array = signal("1/s", "c", "slope of the surface", shape=AXES)
    switching_gain_end: Array = signal("m/s2", "eps", "switching gain", shape=AXES)
    sharpness_end: Array = signal("s/m", "a", "sharpness of the switch", shape=AXES)
    sampled_gain_end: Array = signal(
        "1", "eps a T/2 + c T", "change of s in a period per s", shape=AXES
    )


@pytree
class LastAdapted:
    """The values of the last tick, if there was one."""

    values: Adapted = part("values of the last tick")
    seen: Array = signal("1", "", "1 once there was a tick")


@functools.cache
def adapted(
    pick: Callable[[Any, float], tuple[Array, Array, Array, Array]],
) -> Metric[LastAdapted, Adapted]:
    """The adapted values that the law used last.

    Args:
        pick: ``(memory, dt) -> c, eps, a`` and ``eps a T/2 + c T``, each (axes,).
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


# --- scheduled contour gains -------------------------------------------------------------------


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
def contour_gains(
    pick: Callable[[Any], tuple[Array, Array, Array]],
) -> Metric[GainSums, ContourGains]:
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
