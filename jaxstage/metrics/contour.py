"""Distance of the tool from the curve it should cut."""

from jax import Array

from jaxstage.blocks import Metric
from jaxstage.fields import pytree, signal
from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments
from jaxstage.metrics.tracking import following_error
from jaxstage.numerics.geometry import norm, normal_part
from jaxstage.signals import Sample, Setpoint


@pytree
class Contour:
    """True contour error: distance to the nearest point of the curve on the local branch."""

    contour_rms: Array = signal("m", "", "RMS", shown="um")
    contour_mean: Array = signal("m", "", "mean", shown="um")
    contour_max: Array = signal("m", "", "largest", shown="um")


@pytree
class TangentContour:
    """Contour error as papers estimate it: distance to the tangent at the commanded point."""

    contour_tangent_rms: Array = signal("m", "", "RMS", shown="um")
    contour_tangent_mean: Array = signal("m", "", "mean", shown="um")
    contour_tangent_max: Array = signal("m", "", "largest", shown="um")


def _init(setpoint: Setpoint) -> Moments:
    return moments.empty(setpoint.position[0])


def _update(acc: Moments, sample: Sample, dt: float) -> tuple[Moments, None]:
    return moments.add(acc, sample.nearest.distance), None


def _finish(acc: Moments) -> Contour:
    return Contour(
        contour_rms=moments.root(moments.mean_square(acc)),
        contour_mean=moments.mean(acc),
        contour_max=moments.largest(acc),
    )


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
    name="tangent_contour", init=_init, update=_tangent_update, finish=_tangent_finish
)
