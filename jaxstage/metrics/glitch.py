"""Quadrant glitch: the peak of the following error after an axis reverses."""

import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Bool, Float

from jaxstage.metrics.tracking import drive_error, following_error
from jaxstage.model.array_types import PerAxis
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import definition, pytree, signal
from jaxstage.model.signals import Sample, Setpoint

AXES = "(axes,)"


#: axis speed in m/s at or below which an axis stands still: rounding of a setpoint at rest is less
STANDSTILL = 1e-6


def reversed_at(direction: PerAxis, velocity: PerAxis) -> tuple[PerAxis, Array]:
    """Whether an axis reverses: it moves against the direction of its last motion.

    Setting off from rest is no reversal, and neither is a halt before going on.

    Args:
        direction: sign of the last motion, (axes,); 0 before the first one.
        velocity: commanded, (axes,) m/s; up to `STANDSTILL` it is no motion.

    Returns:
        The direction after this tick, and a bool for each axis.
    """
    heading = jnp.where(
        jnp.abs(velocity) > STANDSTILL, jnp.sign(velocity), jnp.zeros_like(velocity)
    )
    return jnp.where(heading != 0, heading, direction), heading * direction < 0


def reversals(velocity: Float[Array, "ticks axes"]) -> Bool[Array, "ticks axes"]:
    """The ticks at which each axis reverses, by `reversed_at`. velocity: commanded, m/s."""
    _, turned = lax.scan(reversed_at, jnp.zeros_like(velocity[0]), velocity)
    return turned


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

    direction: Array = signal("1", "", "sign of the last motion, 0 before it", shape=AXES)
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

    A peak ends early at the next reversal. NaN for an axis that never reverses.

    Args:
        span: time after a reversal that belongs to its peak, in s.
        side: `tool` or `drive`.
    """

    def init(setpoint: Setpoint) -> GlitchSums:
        zero = jnp.zeros_like(setpoint.position)
        return GlitchSums(
            direction=zero, elapsed=zero, peak=zero, total=zero, largest=zero, count=zero
        )

    def update(acc: GlitchSums, sample: Sample, dt: float) -> tuple[GlitchSums, None]:
        direction, turned = reversed_at(acc.direction, sample.setpoint.velocity)
        elapsed = jnp.where(turned, jnp.zeros_like(acc.elapsed), acc.elapsed + dt)
        watched = turned | ((acc.count > 0) & (elapsed < span))
        error = jnp.where(watched, jnp.abs(side.error(sample)), jnp.zeros_like(acc.peak))
        peak = jnp.where(turned, error, jnp.maximum(acc.peak, error))
        return GlitchSums(
            direction=direction,
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
