"""Contour error: the distance of the tool from the curve it should cut.

    eps = min_s |p - c(s)|,      its tangent estimate |e - (e . t) t| with e = r - p

p: tool; c(s): commanded curve; r, t: commanded point and unit tangent there.
"""

from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments, moments_of
from jaxstage.metrics.tracking import following_error
from jaxstage.model.fields import pytree, signal
from jaxstage.model.signals import Sample
from jaxstage.numerics.geometry import norm, normal_part


@pytree
class ContourMetrics:
    """True contour error: distance to the nearest point of the curve on the local branch.

    Where the following error exceeds the arc length searched (the reference's window) the nearest
    point may lie outside of it, and the distance is an upper bound.
    """

    contour_rms: Array = signal("m", "", "RMS", shown="um")
    contour_mean: Array = signal("m", "", "mean", shown="um")
    contour_max: Array = signal("m", "", "largest", shown="um")
    contour_beyond_share: Array = signal(
        "1", "", "share of ticks with a following error beyond the arc length searched"
    )


@pytree
class TangentContour:
    """Contour error as papers estimate it: distance to the tangent at the commanded point."""

    contour_tangent_rms: Array = signal("m", "", "RMS", shown="um")
    contour_tangent_mean: Array = signal("m", "", "mean", shown="um")
    contour_tangent_max: Array = signal("m", "", "largest", shown="um")


def _distances(sample: Sample, dt: float) -> tuple[Array, Array]:
    distance = sample.nearest.distance
    beyond = norm(following_error(sample)) > sample.nearest.reach
    return distance, beyond.astype(distance.dtype)


def _report(error: Moments, beyond: Moments) -> ContourMetrics:
    return ContourMetrics(
        contour_rms=moments.rms(error),
        contour_mean=moments.mean(error),
        contour_max=moments.largest(error),
        contour_beyond_share=moments.mean(beyond),
    )


def _beside_tangent(sample: Sample, dt: float) -> tuple[Array]:
    return (norm(normal_part(following_error(sample), sample.setpoint.tangent)),)


def _tangent_report(error: Moments) -> TangentContour:
    return TangentContour(
        contour_tangent_rms=moments.rms(error),
        contour_tangent_mean=moments.mean(error),
        contour_tangent_max=moments.largest(error),
    )


#: True contour error; report `ContourMetrics`.
contour = moments_of(
    "contour", _distances, _report, lambda setpoint: moments.one_number(setpoint) * 2
)

#: The tangent estimate |e - (e.t) t|; report `TangentContour`.
tangent_contour = moments_of(
    "tangent_contour", _beside_tangent, _tangent_report, moments.one_number
)
