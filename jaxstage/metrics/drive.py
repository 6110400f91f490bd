"""How well the drive follows: the motor, measured in tool units, where most encoders sit."""

import jax.numpy as jnp
from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments
from jaxstage.metrics.tracking import Side
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import part, pytree, signal
from jaxstage.model.signals import Sample, Setpoint


def drive_error(sample: Sample) -> Array:
    """e = r - x_d of each axis, (axes,) m, from the true drive position."""
    return sample.setpoint.position - sample.output.drive_position


@pytree
class DriveFollowing:
    """Following error of each drive."""

    drive_following_rms: Array = signal("m", "", "RMS", shape="(axes,)", shown="um")
    drive_following_mean: Array = signal("m", "", "mean magnitude", shape="(axes,)", shown="um")
    drive_following_max: Array = signal("m", "", "largest magnitude", shape="(axes,)", shown="um")
    drive_following_variance: Array = signal(
        "m2", "", "population variance", shape="(axes,)", shown="um2"
    )


@pytree
class DriveSums:
    """Moments of the following error and of its magnitude."""

    error: Moments = part("moments of the error")
    magnitude: Moments = part("moments of its magnitude")


def _init(setpoint: Setpoint) -> DriveSums:
    none = moments.empty(setpoint.position)
    return DriveSums(error=none, magnitude=none)


def _update(acc: DriveSums, sample: Sample, dt: float) -> tuple[DriveSums, None]:
    error = drive_error(sample)
    return DriveSums(
        error=moments.add(acc.error, error),
        magnitude=moments.add(acc.magnitude, jnp.abs(error)),
    ), None


def _finish(acc: DriveSums) -> DriveFollowing:
    return DriveFollowing(
        drive_following_rms=moments.root(moments.mean_square(acc.error)),
        drive_following_mean=moments.mean(acc.magnitude),
        drive_following_max=moments.largest(acc.error),
        drive_following_variance=moments.variance(acc.error),
    )


@pytree
class DriveGlitch:
    """Peak following error of a drive after each reversal of its commanded velocity."""

    drive_glitch_mean: Array = signal("m", "", "mean of the peaks", shape="(axes,)", shown="um")
    drive_glitch_max: Array = signal("m", "", "largest peak", shape="(axes,)", shown="um")
    drive_reversals: Array = signal("1", "", "reversals seen", shape="(axes,)")


def _glitch(mean: Array, largest: Array, count: Array) -> DriveGlitch:
    return DriveGlitch(drive_glitch_mean=mean, drive_glitch_max=largest, drive_reversals=count)


#: The drive, for `quadrant_glitch`.
drive = Side(name="drive_", error=drive_error, glitch=_glitch)

#: Following error of the drives; report `DriveFollowing`.
drive_following = Metric(name="drive_following", init=_init, update=_update, finish=_finish)

#: Stores the following error of the drives in every tick, (ticks, axes) m. No report of its own.
recorded_drive_error = Metric(
    name="recorded_drive_error",
    init=lambda setpoint: (),
    update=lambda acc, sample, dt: (acc, drive_error(sample)),
    finish=lambda acc: None,
)
