"""Distance of the tool from the curve it should cut."""

from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments
from jaxstage.metrics.tracking import following_error
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import part, pytree, signal
from jaxstage.model.signals import Sample, Setpoint
from jaxstage.numerics.geometry import norm, normal_part


@pytree
class Contour:
    """True contour error: distance to the nearest point of the curve on the local branch.

    Where the following error exceeds the arc length searched (the reference's window) the nearest
    point may lie outside of it, and the distance found is an upper bound.
    """

    contour_rms: Array = signal("m", "", "RMS", shown="um")
    contour_mean: Array = signal("m", "", "mean", shown="um")
    contour_max: Array = signal("m", "", "largest", shown="um")
    contour_beyond_share: Array = signal(
        "1", "", "share of ticks with a following error beyond the arc length searched"
    )


@pytree
class ContourSums:
    """Moments of the contour error, and of being beyond the search."""

    error: Moments = part("moments of the contour error")
    beyond: Moments = part("moments of 1 where the following error is beyond the search")


@pytree
class TangentContour:
    """Contour error as papers estimate it: distance to the tangent at the commanded point."""

    contour_tangent_rms: Array = signal("m", "", "RMS", shown="um")
    contour_tangent_mean: Array = signal("m", "", "mean", shown="um")
    contour_tangent_max: Array = signal("m", "", "largest", shown="um")


def _init(setpoint: Setpoint) -> ContourSums:
    none = moments.empty(setpoint.position[0])
    return ContourSums(error=none, beyond=none)


def _update(acc: ContourSums, sample: Sample, dt: float) -> tuple[ContourSums, None]:
    beyond = norm(following_error(sample)) > sample.nearest.reach
    return ContourSums(
        error=moments.add(acc.error, sample.nearest.distance),
        beyond=moments.add(acc.beyond, beyond.astype(sample.nearest.distance.dtype)),
    ), None


def _finish(acc: ContourSums) -> Contour:
    return Contour(
        contour_rms=moments.root(moments.mean_square(acc.error)),
        contour_mean=moments.mean(acc.error),
        contour_max=moments.largest(acc.error),
        contour_beyond_share=moments.mean(acc.beyond),
    )


def _tangent_init(setpoint: Setpoint) -> Moments:
    return moments.empty(setpoint.position[0])


def _tangent_update(acc: Moments, sample: Sample, dt: float) -> tuple[Moments, None]:
    aside = normal_part(following_error(sample), sample.setpoint.tangent)
    return moments.add(acc, norm(aside)), None


def _tangent_finish(acc: Moments) -> TangentContour:
    return TangentContour(
        contour_tangent_rms=moments.root(moments.mean_square(acc)),
        contour_tangent_mean=moments.mean(acc),
        contour_tangent_max=moments.largest(acc),
    )


#: True contour error; report `Contour`.
contour = Metric(name="contour", init=_init, update=_update, finish=_finish)

#: The tangent estimate |e - (e.t) t|; report `TangentContour`.
tangent_contour = Metric(
    name="tangent_contour", init=_tangent_init, update=_tangent_update, finish=_tangent_finish
)
