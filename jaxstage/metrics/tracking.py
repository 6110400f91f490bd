"""Tracking and following errors: how well tool and drives follow their commands.

    e = r - x,   E = |e| over all axes

r: commanded position; x: true position of the tool, or of the drive in tool units, where most
encoders sit.
"""

import jax.numpy as jnp
from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments, moments_of
from jaxstage.metrics.windows import recorded
from jaxstage.model.array_types import PerAxis
from jaxstage.model.fields import pytree, signal
from jaxstage.model.signals import Sample
from jaxstage.numerics.geometry import norm

AXES = "(axes,)"


def following_error(sample: Sample) -> PerAxis:
    """e = r - x of each axis, (axes,) m, from the true tool position."""
    return sample.setpoint.position - sample.output.position


def drive_error(sample: Sample) -> PerAxis:
    """e = r - x_d of each axis, (axes,) m, from the true drive position."""
    return sample.setpoint.position - sample.output.drive_position


def error_between(sample: Sample, dt: float) -> Array:
    """r + r' tau + r'' tau^2 / 2 - x at the end of each substep, (substeps, axes) m."""
    setpoint, tool = sample.setpoint, sample.between.position
    count = tool.shape[0]
    tau = (dt / count * jnp.arange(1, count + 1, dtype=tool.dtype))[:, None]
    carried = setpoint.velocity[None] * tau + setpoint.acceleration[None] * tau**2 / 2
    return setpoint.position[None] + carried - tool


@pytree
class Tracking:
    """Average tracking error and its standard deviation; E = |r - x| over all axes.

    Mao et al., Energies 2021, 14, 7802, equations (35) and (36) with n = K samples.
    """

    ate: Array = signal("m", "T_E", "average tracking error", shown="um")
    tesd: Array = signal("m", "T_S", "standard deviation of the tracking error", shown="um")
    tracking_max: Array = signal("m", "max E", "largest tracking error", shown="um")


@pytree
class Following:
    """Following error of each axis."""

    following_rms: Array = signal("m", "", "RMS", shape=AXES, shown="um")
    following_mean: Array = signal("m", "", "mean magnitude", shape=AXES, shown="um")
    following_max: Array = signal("m", "", "largest magnitude", shape=AXES, shown="um")


@pytree
class Between:
    """Largest following error of each axis at the samples and at the substeps."""

    following_max_between: Array = signal(
        "m", "", "largest magnitude, between the samples too", shape=AXES, shown="um"
    )


@pytree
class DriveFollowing:
    """Following error of each drive."""

    drive_following_rms: Array = signal("m", "", "RMS", shape=AXES, shown="um")
    drive_following_mean: Array = signal("m", "", "mean magnitude", shape=AXES, shown="um")
    drive_following_max: Array = signal("m", "", "largest magnitude", shape=AXES, shown="um")
    drive_following_variance: Array = signal(
        "m2", "", "population variance", shape=AXES, shown="um2"
    )


def _tracking(error: Moments) -> Tracking:
    return Tracking(
        ate=moments.mean(error),
        tesd=moments.root(moments.variance(error)),
        tracking_max=moments.largest(error),
    )


def _following(magnitude: Moments) -> Following:
    return Following(
        following_rms=moments.rms(magnitude),
        following_mean=moments.mean(magnitude),
        following_max=moments.largest(magnitude),
    )


def _with_substeps(sample: Sample, dt: float) -> tuple[Array]:
    inside = jnp.max(jnp.abs(error_between(sample, dt)), axis=0)
    return (jnp.maximum(jnp.abs(following_error(sample)), inside),)


def _drive_errors(sample: Sample, dt: float) -> tuple[Array, Array]:
    error = drive_error(sample)
    return error, jnp.abs(error)


def _drive_following(error: Moments, magnitude: Moments) -> DriveFollowing:
    return DriveFollowing(
        drive_following_rms=moments.rms(error),
        drive_following_mean=moments.mean(magnitude),
        drive_following_max=moments.largest(error),
        drive_following_variance=moments.variance(error),
    )


#: ATE and TESD; report `Tracking`.
tracking = moments_of(
    "tracking", lambda sample, dt: (norm(following_error(sample)),), _tracking, moments.one_number
)

#: Following error per axis; report `Following`.
following = moments_of(
    "following", lambda sample, dt: (jnp.abs(following_error(sample)),), _following
)

#: Largest following error, between the samples too, where a controller does not look; report
#: `Between`.
between = moments_of(
    "between",
    _with_substeps,
    lambda magnitude: Between(following_max_between=moments.largest(magnitude)),
)

#: Following error of the drives; report `DriveFollowing`.
drive_following = moments_of(
    "drive_following",
    _drive_errors,
    _drive_following,
    lambda setpoint: moments.each_axis(setpoint) * 2,
)

#: Stores the following error of the drives in every tick, (ticks, axes) m. No report of its own.
recorded_drive_error = recorded("recorded_drive_error", drive_error)
