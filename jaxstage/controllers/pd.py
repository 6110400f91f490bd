"""Computed-force PD law: the model is cancelled, the error is a mass on a spring and a damper.

    u = (1/a_n) [ r'' + k_p e + k_d e' + (B v + F_L) / M_n ],   a_n = K_t / M_n

| symbol | field | unit |
|---|---|---|
| k_p | proportional_gain | 1/s2 |
| k_d | derivative_gain | 1/s |

Under an acceleration disturbance A sin(w t) the steady error has the amplitude
A / |k_p - w^2 + j k_d w|. With k_p = c k and k_d = c + k it has the poles of a sliding-mode law of
slope c inside a boundary layer, k = eta / phi, so that a comparison isolates what else differs.

Source: Science Progress 2021, doi:10.1177/00368504211011847, names a "PD robust controller" for
comparison; the law is chosen here.
"""

from jax import Array

from jaxstage.controllers.parts.nominal import RigidAxis, authority, drift
from jaxstage.controllers.parts.surface import errors
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import gain, part, pytree
from jaxstage.model.signals import Measurement, Setpoint


@pytree
class Pd:
    """Gains of the PD law, one axis."""

    proportional_gain: Array = gain("1/s2", "k_p", "on the following error", low=0.0)
    derivative_gain: Array = gain("1/s", "k_d", "on its rate", low=0.0)
    nominal: RigidAxis = part("what the law assumes about the axis")


def _init(gains: Pd, setpoint: Setpoint, measurement: Measurement) -> tuple[()]:
    return ()


def _control(
    gains: Pd, memory: tuple[()], setpoint: Setpoint, measurement: Measurement, dt: float
) -> tuple[Array, tuple[()]]:
    error, rate = errors(setpoint, measurement)
    acceleration = (
        setpoint.acceleration
        + gains.proportional_gain * error
        + gains.derivative_gain * rate
        - drift(gains.nominal, measurement.velocity)
    )
    return acceleration / authority(gains.nominal), ()


#: The law for one axis; gains `Pd`.
pd = Controller(name="pd", init=_init, control=_control)
