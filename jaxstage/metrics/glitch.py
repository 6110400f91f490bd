"""Quadrant glitch: the peak of the following error after an axis reverses."""

import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxstage.metrics.tracking import drive_error, following_error
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import definition, pytree, signal
from jaxstage.model.signals import Sample, Setpoint
from jaxstage.numerics.geometry import norm

AXES = "(axes,)"


def direction(velocity: Array) -> Array:
    """Sign of each axis velocity, 0 below 1e-9 of the feed: rounding is not motion.

    velocity: (..., axes) m/s.
    """
    feed = norm(velocity)[..., None]
    return jnp.where(jnp.abs(velocity) > 1e-9 * feed, jnp.sign(velocity), jnp.zeros_like(velocity))


@pytree
class QuadrantGlitch:
    """Peak following error of an axis after each reversal of its commanded velocity."""

    glitch_mean: Array = signal("m", "", "mean of the peaks", shape=AXES, shown="um")
    glitch_max: Array = signal("m", "", "largest peak", shape=AXES, shown="um")
    reversals: Array = signal("1", "", "reversals seen", shape=AXES)


@pytree
class DriveGlitch:
    """Peak following error of a drive after each reversal of its commanded velocity."""

    drive_glitch_mean: Array = signal("m", "", "mean of the peaks", shape=AXES, shown="um")
    drive_glitch_max: Array = signal("m", "", "largest peak", shape=AXES, shown="um")
    drive_reversals: Array = signal("1", "", "reversals seen", shape=AXES)


@pytree
class GlitchSums:
    """Peaks so far; the open one belongs to the last reversal."""

    direction: Array = signal(
        "1", "", "last direction of motion; 0 at rest so far, 2 not known yet", shape=AXES
    )
    elapsed: Array = signal("s", "", "time since the reversal", shape=AXES)
    peak: Array = signal("m", "", "peak since the reversal", shape=AXES)
    total: Array = signal("m", "", "sum of the finished peaks", shape=AXES)
    largest: Array = signal("m", "", "largest peak", shape=AXES)
    count: Array = signal("1", "", "reversals", shape=AXES)


@definition
class ErrorSide:
    """Whose following error peaks: that of the tool, which cuts, or of the drive.

    Attributes:
        name: begins the name of the metric.
        error: ``sample -> error``, (axes,) m.
        report: ``(mean, largest, count) -> report`` of the peaks, each (axes,).
    """

    name: str
    error: Callable[[Sample], Array]
    report: Callable[[Array, Array, Array], Any]


#: The tool.
tool = ErrorSide(
    name="",
    error=following_error,
    report=lambda mean, largest, count: QuadrantGlitch(
        glitch_mean=mean, glitch_max=largest, reversals=count
    ),
)

#: The drive.
drive = ErrorSide(
    name="drive_",
    error=drive_error,
    report=lambda mean, largest, count: DriveGlitch(
        drive_glitch_mean=mean, drive_glitch_max=largest, drive_reversals=count
    ),
)


@functools.cache
def quadrant_glitch(span: float = 0.1, side: ErrorSide = tool) -> Metric[GlitchSums, Any]:
    """Peak |e| within ``span`` seconds after each reversal of the commanded velocity, per axis.

    A peak ends early at the next reversal; setting off from rest counts as one. NaN for an axis
    that never reverses.

    Args:
        span: time after a reversal that belongs to its peak, in s.
        side: `tool` or `drive`.
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
        return side.report(
            jnp.where(seen, mean, jnp.nan), jnp.where(seen, acc.largest, jnp.nan), acc.count
        )

    return Metric(name=f"{side.name}quadrant_glitch", init=init, update=update, finish=finish)
