"""Ideal sliding mode: the model is known, dry friction is the bounded disturbance.

    e = r - y,  s = -(c1 e + e')                                                     (15)
    u = (1/b) (c1 e' - f + r'') - (eta_D / b) w(s),   eta_D = D + eta               (18), (19)
    f = -(B v + F_L) / M,   b = K_t / M

| symbol | field | unit |
|---|---|---|
| c1 | slope | 1/s |
| eta | switching_gain | m/s2 |
| D | disturbance_bound | m/s2 |
| w | the `Switch` the law was made with | 1 |

Once s has been reached |s| <= (eta_D + D) dt with sgn and about eta_D dt with the implicit form;
the following error is about |s| / c1. Source: Mao et al., Energies 2021, 14, 7802.
"""

import functools
from typing import Any

from jax import Array

from jaxstage.controllers.parts.nominal import RigidAxis, authority, drift
from jaxstage.controllers.parts.surface import errors, linear_surface
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import gain, known, part, pytree, signal
from jaxstage.model.signals import Measurement, Setpoint
from jaxstage.numerics.smooth import Switch, exact


@pytree
class Sliding:
    """Gains of the ideal sliding-mode law, one axis."""

    slope: Array = gain("1/s", "c1", "slope of the sliding surface", above=0.0)
    switching_gain: Array = gain("m/s2", "eta", "switching gain beyond the bound", low=0.0)
    disturbance_bound: Array = known("m/s2", "D", "bound of the disturbance F_s/M", low=0.0)
    switch: Any = part("parameters of the switch")
    nominal: RigidAxis = part("what the law assumes about the axis")


@pytree
class SlidingMemory:
    """Sliding variable of the last sample."""

    surface: Array = signal("m/s", "s", "sliding variable", shown="mm/s")


def _init(gains: Sliding, setpoint: Setpoint, measurement: Measurement) -> SlidingMemory:
    error, rate = errors(setpoint, measurement)
    return SlidingMemory(surface=linear_surface(gains.slope, error, rate))


@functools.cache
def sliding(switch: Switch = exact) -> Controller[Sliding, SlidingMemory]:
    """Ideal sliding-mode law of one axis; gains `Sliding`.

    Args:
        switch: w(s): `exact`, `smooth`, `sat` or `implicit`.

    Returns:
        The controller. Equal arguments give the identical one.
    """

    def control(
        gains: Sliding,
        memory: SlidingMemory,
        setpoint: Setpoint,
        measurement: Measurement,
        dt: float,
    ) -> tuple[Array, SlidingMemory]:
        error, rate = errors(setpoint, measurement)
        surface = linear_surface(gains.slope, error, rate)
        full = gains.disturbance_bound + gains.switching_gain
        switched = full * switch.apply(gains.switch, surface, full * dt)
        natural = drift(gains.nominal, measurement.velocity)
        acceleration = gains.slope * rate - natural + setpoint.acceleration - switched
        return acceleration / authority(gains.nominal), SlidingMemory(surface=surface)

    return Controller(name=f"sliding[{switch.name}]", init=_init, control=control)
