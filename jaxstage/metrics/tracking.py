"""How well the axes follow their commands."""

import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import definition, pytree, signal
from jaxstage.model.signals import Sample, Setpoint
from jaxstage.numerics.geometry import norm


def following_error(sample: Sample) -> Array:
    """e = r - x of each axis, (axes,) m, from the true tool position."""
    return sample.setpoint.position - sample.output.position


@pytree
class Tracking:
    """Average tracking error and its standard deviation; E = |r - x| over all axes.

    Mao et al., Energies 2021, 14, 7802, equations (35) and (36) with n = K samples.
    """

    ate: Array = signal("m", "T_E", "average tracking error", shown="um")
    tesd: Array = signal("m", "T_S", "standard deviation of the tracking error", shown="um")
    tracking_max: Array = signal("m", "max E", "largest tracking error", shown="um")


def _tracking_init(setpoint: Setpoint) -> Moments:
    return moments.empty(setpoint.position[0])


def _tracking_update(acc: Moments, sample: Sample, dt: float) -> tuple[Moments, None]:
    return moments.add(acc, norm(following_error(sample))), None


def _tracking_finish(acc: Moments) -> Tracking:
    return Tracking(
        ate=moments.mean(acc),
        tesd=moments.root(moments.variance(acc)),
        tracking_max=moments.largest(acc),
    )


@pytree
class Following:
    """Following error of each axis."""

    following_rms: Array = signal("m", "", "RMS", shape="(axes,)", shown="um")
    following_mean: Array = signal("m", "", "mean magnitude", shape="(axes,)", shown="um")
    following_max: Array = signal("m", "", "largest magnitude", shape="(axes,)", shown="um")


def _following_init(setpoint: Setpoint) -> Moments:
    return moments.empty(setpoint.position)


def _following_update(acc: Moments, sample: Sample, dt: float) -> tuple[Moments, None]:
    return moments.add(acc, jnp.abs(following_error(sample))), None


def _following_finish(acc: Moments) -> Following:
    return Following(
        following_rms=moments.root(moments.mean_square(acc)),
        following_mean=moments.mean(acc),
        following_max=moments.largest(acc),
    )


def direction(velocity: Array) -> Array:
    """Sign of each axis velocity, 0 below 1e-9 of the feed: rounding is not motion.

    velocity: (..., axes) m/s.
    """
    feed = norm(velocity)[..., None]
    return jnp.where(jnp.abs(velocity) > 1e-9 * feed, jnp.sign(velocity), jnp.zeros_like(velocity))


@pytree
class QuadrantGlitch:
    """Peak following error of an axis after each reversal of its commanded velocity."""

    glitch_mean: Array = signal("m", "", "mean of the peaks", shape="(axes,)", shown="um")
    glitch_max: Array = signal("m", "", "largest peak", shape="(axes,)", shown="um")
    reversals: Array = signal("1", "", "reversals seen", shape="(axes,)")


@pytree
class GlitchSums:
    """Peaks so far; the open one belongs to the last reversal."""

    direction: Array = signal(
        "1", "", "last direction of motion; 0 at rest so far, 2 not known yet", shape="(axes,)"
    )
    elapsed: Array = signal("s", "", "time since the reversal", shape="(axes,)")
    peak: Array = signal("m", "", "peak since the reversal", shape="(axes,)")
    total: Array = signal("m", "", "sum of the finished peaks", shape="(axes,)")
    largest: Array = signal("m", "", "largest peak", shape="(axes,)")
    count: Array = signal("1", "", "reversals", shape="(axes,)")


@definition
class Side:
    """Whose following error figures are about: that of the tool, which cuts, or of the drive.

    name: begins the names of its metrics. glitch(mean, largest, count): report of its glitches.
    """

    name: str
    error: Callable[[Sample], Array]
    glitch: Callable[[Array, Array, Array], Any]


def _tool_glitch(mean: Array, largest: Array, count: Array) -> QuadrantGlitch:
    return QuadrantGlitch(glitch_mean=mean, glitch_max=largest, reversals=count)


#: The tool; the other side is `drive.drive`.
tool = Side(name="", error=following_error, glitch=_tool_glitch)


@functools.cache
def quadrant_glitch(span: float = 0.1, side: Side = tool) -> Metric:
    """Peak |e| within ``span`` seconds after each reversal of the commanded velocity, per axis.

    A peak ends early at the next reversal; setting off from rest counts as one. NaN for an axis
    that never reverses.
    """

    def init(setpoint: Setpoint) -> GlitchSums:
        zero = jnp.zeros_like(setpoint.position)
        return GlitchSums(
            direction=zero + 2, elapsed=zero, peak=zero, total=zero, largest=zero, count=zero
        )

    def update(acc: GlitchSums, sample: Sample, dt: float) -> tuple[GlitchSums, None]:
        heading = direction(sample.setpoint.velocity)
        unknown = acc.direction == 2
        turned = ~unknown & (heading != 0) & (heading != acc.direction)
        elapsed = jnp.where(turned, jnp.zeros_like(acc.elapsed), acc.elapsed + dt)
        watched = turned | ((acc.count > 0) & (elapsed < span))
        error = jnp.where(watched, jnp.abs(side.error(sample)), jnp.zeros_like(acc.peak))
        peak = jnp.where(turned, error, jnp.maximum(acc.peak, error))
        return GlitchSums(
            direction=jnp.where(unknown | (heading != 0), heading, acc.direction),
            elapsed=elapsed,
            peak=peak,
            total=acc.total + jnp.where(turned, acc.peak, jnp.zeros_like(acc.peak)),
            largest=jnp.maximum(acc.largest, error),
            count=acc.count + turned.astype(acc.count.dtype),
        ), None

    def finish(acc: GlitchSums) -> Any:
        seen = acc.count > 0
        mean = (acc.total + acc.peak) / jnp.maximum(acc.count, 1)
        return side.glitch(
            jnp.where(seen, mean, jnp.nan), jnp.where(seen, acc.largest, jnp.nan), acc.count
        )

    return Metric(name=f"{side.name}quadrant_glitch", init=init, update=update, finish=finish)


#: ATE and TESD; report `Tracking`.
tracking = Metric(
    name="tracking", init=_tracking_init, update=_tracking_update, finish=_tracking_finish
)

#: Following error per axis; report `Following`.
following = Metric(
    name="following", init=_following_init, update=_following_update, finish=_following_finish
)
