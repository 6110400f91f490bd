"""Tangent estimate of the contour error, its covariant rate, and how a PID law reads both.

    eps = e - (e.t) t,   t' = (r'' - (r''.t) t) / sqrt(|r'|^2 + v_0^2)
    eps' = e' - (e'.t + e.t') t - (e.t) t'
    D   = eps' - (eps'.t) t = e' - (e'.t) t - (e.t) t'          covariant rate, normal to the path
    E   = sqrt(|eps|^2 + w^2) - w,   E' = eps.D / sqrt(|eps|^2 + w^2)     smooth magnitude

|eps| and eps / |eps| have no derivative at 0, so wherever the magnitude is needed the rounded E
takes its place. In three dimensions the magnitude carries no sign.

A PID law on this error needs three vectors, and there are two readings of it, a `Form` each:

| form | P | I | D |
|---|---|---|---|
| `vector` | eps | I, I' = eps - (I.t') t | D |
| `scalar` | n E | n J, J' = E | n E' |

with n = eps / sqrt(|eps|^2 + w^2). In `vector` the integral is carried along parallel to the path:
kept in fixed axes it would turn into the tangent, where no contour error could unwind it. In
`scalar`, the literal reading of "coupled gains times a PID of the contour error", J never falls.

Source: Science Progress 2021, doi:10.1177/00368504211011847, in words ("shortest distance from the
actual position to the tangent of the reference position", "direction of the normalized estimated
contour error vector"); equations after Yeh and Hsu, which the paper cites. The rate, its
projection, the rounding w, v_0 and the transport are derived here.
"""

from collections.abc import Callable
from typing import Generic, NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxstage.controllers.parts.surface import errors
from jaxstage.model.blocks import Params
from jaxstage.model.fields import definition, gain, pytree, signal
from jaxstage.model.signals import Measurement, Setpoint
from jaxstage.numerics.geometry import dot, normal_part

AXES = "(axes,)"


@pytree
class ContourError:
    """Tangent estimate of the contour error at one instant."""

    deviation: Array = signal("m", "eps", "estimated contour error", shape=AXES, shown="um")
    rate: Array = signal("m/s", "D", "its covariant rate", shape=AXES, shown="mm/s")
    tangent: Array = signal("1", "t", "unit tangent of the path", shape=AXES)
    turning: Array = signal("1/s", "t'", "rate of the tangent", shape=AXES)


def contour_error(setpoint: Setpoint, seen: Measurement, rest_speed: Array) -> ContourError:
    """Tangent estimate of the contour error: eps, D, t and t' of one sample.

    Args:
        setpoint: of the tick.
        seen: the measurement of the tick.
        rest_speed: v_0, () m/s, > 0; keeps t' finite at rest.
    """
    error, rate = errors(setpoint, seen)
    tangent = setpoint.tangent
    speed = jnp.sqrt(dot(setpoint.velocity, setpoint.velocity) + rest_speed**2)
    turning = normal_part(setpoint.acceleration, tangent) / speed
    return ContourError(
        deviation=normal_part(error, tangent),
        rate=normal_part(rate, tangent) - dot(error, tangent) * turning,
        tangent=tangent,
        turning=turning,
    )


def magnitude(error: ContourError, rounding: Array) -> tuple[Array, Array, Array]:
    """Smooth magnitude of the contour error.

    Args:
        error: of the tick.
        rounding: w, () m, > 0.

    Returns:
        E, () m; E', () m/s; the direction n, (axes,), of length below 1.
    """
    square = dot(error.deviation, error.deviation)
    length = jnp.sqrt(square + rounding**2)
    slope = dot(error.deviation, error.rate) / length
    return square / (length + rounding), slope, error.deviation / length


class PidTerms(NamedTuple):
    """What the three gains multiply, each (axes,): m, m s and m/s."""

    proportional: Array
    integral: Array
    derivative: Array

    def weighted(self, proportional: Array, integral: Array, derivative: Array) -> Array:
        """PID sum U = K_P P + K_I I + K_D D, (axes,) m/s2; gains () in 1/s2, 1/s3 and 1/s."""
        return (
            proportional * self.proportional
            + integral * self.integral
            + (derivative * self.derivative)
        )


@definition
class Form(Generic[Params]):
    """Form of a PID law on the contour error: how it reads eps, I and D.

    Attributes:
        name: what it is called.
        start: (zeros (axes,)) -> the integral at the start, m s.
        terms: (params, error, integral) -> `PidTerms`.
        rate: (params, error, integral) -> derivative of the integral, m.
        share: (params, error, demand (axes,)) -> the part of the demand that the integral answers
            for, in the shape of the integral.
    """

    name: str
    start: Callable[[Array], Array]
    terms: Callable[[Params, ContourError, Array], PidTerms]
    rate: Callable[[Params, ContourError, Array], Array]
    share: Callable[[Params, ContourError, Array], Array]


def unwinding(
    form: Form[Params], params: Params, error: ContourError, cut: Array, stiffness: Array
) -> Array:
    """Back-calculation anti-windup: what the rate of the integral gets from a drive at its limit.

    share(cut) / stiffness, the error that would have met the limit.

    Args:
        form: of the law.
        params: of the form.
        error: contour error of the tick.
        cut: command minus demand, (axes,) m/s2.
        stiffness: K_P + K_I dt, () 1/s2; without any the result is 0.

    Returns:
        Addition to the rate of the integral, m, in its shape.
    """
    soft = stiffness > 0
    answer = form.share(params, error, cut) / jnp.where(soft, stiffness, 1)
    return jnp.where(soft, answer, 0)


def _vector_terms(params: tuple[()], error: ContourError, integral: Array) -> PidTerms:
    # the rate keeps I normal to a smooth path; at a corner the tangent jumps
    across = normal_part(integral, error.tangent)
    return PidTerms(proportional=error.deviation, integral=across, derivative=error.rate)


def _vector_rate(params: tuple[()], error: ContourError, integral: Array) -> Array:
    return error.deviation - dot(integral, error.turning) * error.tangent


@pytree
class Rounding:
    """Parameters of the `scalar` form."""

    rounding: Array = gain(
        "m", "w", "contour error below which its magnitude is rounded", above=0.0, shown="um"
    )


def _scalar_terms(params: Rounding, error: ContourError, integral: Array) -> PidTerms:
    size, rate, direction = magnitude(error, params.rounding)
    return PidTerms(
        proportional=size * direction, integral=integral * direction, derivative=rate * direction
    )


def _scalar_rate(params: Rounding, error: ContourError, integral: Array) -> Array:
    return magnitude(error, params.rounding)[0]


def _scalar_share(params: Rounding, error: ContourError, demand: Array) -> Array:
    return dot(demand, magnitude(error, params.rounding)[2])


#: the deviation as a vector; params ``()``
vector = Form(
    name="vector",
    start=lambda zero: zero,
    terms=_vector_terms,
    rate=_vector_rate,
    share=lambda params, error, demand: normal_part(demand, error.tangent),
)

#: the magnitude along the direction of the deviation; params `Rounding`
scalar = Form(
    name="scalar",
    start=lambda zero: jnp.sum(zero),
    terms=_scalar_terms,
    rate=_scalar_rate,
    share=_scalar_share,
)
