"""PID cross-coupled contour control: an acceleration that pushes the tool back to the path.

    U = K_P eps + K_I I + K_D D,   u_i = u_axis,i + U_i / a_n,i       (the sum: `cross_coupled`)

eps, I, D: contour error, its integral and its rate, see `parts.contour_error` for their two forms.

| symbol | field | unit |
|---|---|---|
| K_P | proportional_gain | 1/s2 |
| K_I | integral_gain | 1/s3 |
| K_D | derivative_gain | 1/s |
| v_0 | rest_speed | m/s |

U is normal to the path, so it cannot remove a tangential error. Ideal sliding mode absorbs it:
with sgn and a switching gain above |U| the coupling does nothing; it needs a boundary layer.
Anti-windup by back-calculation: what the drive cuts off is taken out of I.

Source: Science Progress 2021, doi:10.1177/00368504211011847: PID, coupled gains and their
distribution to the axes in words. The vector form, the scaling by 1/a_n, which makes the
correction point along the deviation with unequal axes, and the addition at the current are chosen.
"""

import functools
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxstage.controllers.parts.contour_error import (
    ContourError,
    Form,
    contour_error,
    unwinding,
    vector,
)
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import gain, part, pytree, replace, signal
from jaxstage.model.signals import Measurement, Setpoint
from jaxstage.numerics.integrate import shifted


@pytree
class PidContour:
    """Gains of the PID cross-coupled law, shared by all axes."""

    proportional_gain: Array = gain("1/s2", "K_P", "on the contour error", low=0.0)
    integral_gain: Array = gain("1/s3", "K_I", "on its integral", low=0.0)
    derivative_gain: Array = gain("1/s", "K_D", "on its rate", low=0.0)
    rest_speed: Array = gain(
        "m/s", "v_0", "feed below which the path counts as at rest", above=0.0, shown="mm/s"
    )
    form: Any = part("parameters of the form")


@pytree
class PidContourMemory:
    """Integral of the contour error, and the contour error last measured."""

    integral: Array = signal("m s", "I", "integral of the contour error", shape="any")
    error: ContourError = part("contour error of the tick")


def rate(form: Form, gains: PidContour, memory: PidContourMemory) -> Array:
    """State derivative I' of the integral, at the contour error in the memory: m, as `integral`."""
    return form.rate(gains.form, memory.error, memory.integral)


@functools.cache
def pid_contour(form: Form = vector) -> Controller[PidContour, PidContourMemory]:
    """PID contour law of any number of axes, for `cross_coupled`; gains `PidContour`.

    Args:
        form: how the contour error is read, `vector` or `scalar`.

    Returns:
        The controller, whose demand is an acceleration, (axes,) m/s2.
    """

    def init(gains: PidContour, setpoint: Setpoint, seen: Measurement) -> PidContourMemory:
        return PidContourMemory(
            integral=form.start(jnp.zeros_like(seen.position)),
            error=contour_error(setpoint, seen, gains.rest_speed),
        )

    def control(
        gains: PidContour,
        memory: PidContourMemory,
        setpoint: Setpoint,
        seen: Measurement,
        dt: float,
    ) -> tuple[Array, PidContourMemory]:
        error = contour_error(setpoint, seen, gains.rest_speed)
        terms = form.terms(gains.form, error, memory.integral)
        demand = terms.weighted(gains.proportional_gain, gains.integral_gain, gains.derivative_gain)
        return demand, replace(memory, error=error)

    def settle(
        gains: PidContour, memory: PidContourMemory, demand: Array, command: Array, dt: float
    ) -> PidContourMemory:
        stiffness = gains.proportional_gain + gains.integral_gain * dt
        unwound = unwinding(form, gains.form, memory.error, command - demand, stiffness)
        slope = rate(form, gains, memory) + unwound
        return replace(memory, integral=shifted(memory.integral, slope, dt))

    return Controller(name=f"pid_contour[{form.name}]", init=init, control=control, settle=settle)
