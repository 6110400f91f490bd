"""Sliding mode on a nonlinear surface: its slope grows with the speed; fixed or adaptive gain.

    e = r - y,   s = e' + A e,   A = lam + gam psi                                  (7)
    u = (1/K_f) { J [ r'' + A e' + K s + q w(s) + sigma gam psi' e ] + B y' }       (12)

Away from the commanded speed psi is small and the error decays slowly at lam; at the commanded
speed it decays at lam + gam beta. With gam = 0, or with constant psi, the surface is linear.

| symbol | field | unit | published value |
|---|---|---|---|
| lam | slope | 1/s | 40 (SMC*: 80) |
| gam | damping_slope | 1/s | 1.8 |
| psi: beta, v0 | damping | 1, m/s | 10, - |
| K: K0, ... | reaching | 1/s | 80 |
| q | switching_gain | m/s2 | 0.3 |
| w | the `Switch` | 1 | sgn |
| J, B, K_f | nominal mass, damping, force_constant | kg, N s/m, N/command | - |

The unit of q contradicts (12), where Q sgn(s) stands beside the force J{...} and not inside: read
that way the published number is 0.3 N, and q = 0.3 N / J.
Source: Msukwa and Uchiyama, IEEE Access 7 (2019), equations (7)-(14). (12) prints the opposite sign
of the psi' term (sigma = -1); sigma, psi', w and the forms of psi and K are choices of the maker.
"""

import functools
from typing import Any

from jax import Array

from jaxstage.controllers.parts.damping import Damping, DampingRate, Motion, bounded, ignored
from jaxstage.controllers.parts.error_rate import ErrorRate, measured
from jaxstage.controllers.parts.nominal import RigidAxis
from jaxstage.controllers.parts.reaching import ReachingGain, fixed
from jaxstage.controllers.parts.surface import errors
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import gain, part, pytree, replace, signal
from jaxstage.model.signals import Measurement, Setpoint
from jaxstage.numerics.smooth import Switch, exact


@pytree
class NonlinearSurface:
    """Gains of the nonlinear-surface law, one axis."""

    slope: Array = gain("1/s", "lam", "slope of the surface at rest", above=0.0)
    damping_slope: Array = gain("1/s", "gam", "slope added for each unit of psi", low=0.0)
    switching_gain: Array = gain("m/s2", "q", "switching gain", low=0.0)
    damping: Any = part("parameters of psi")
    reaching: Any = part("parameters of the reaching gain")
    switch: Any = part("parameters of the switch")
    nominal: RigidAxis = part("what the law assumes about the axis")


@pytree
class SurfaceMemory:
    """Sliding variable, psi, reaching gain and error rate of a sample."""

    surface: Array = signal("m/s", "s", "sliding variable", shown="mm/s")
    damping: Array = signal("1", "psi", "damping function")
    reaching: Array = signal("1/s", "K", "reaching gain of this sample")
    error_rate: Any = part("memory of the error rate")


@functools.cache
def nonlinear_surface(
    damping: Damping = bounded,
    reaching: ReachingGain = fixed,
    switch: Switch = exact,
    damping_rate: DampingRate = ignored,
    error_rate: ErrorRate = measured,
) -> Controller[NonlinearSurface, SurfaceMemory]:
    """Nonlinear-surface sliding-mode law of one axis; gains `NonlinearSurface`.

    Args:
        damping: psi: `bounded`, `bounded_below`, `raw` or `constant` of `parts.damping`.
        reaching: K: a form of `parts.reaching`.
        switch: w(s): `exact`, `smooth`, `sat` or `implicit`.
        damping_rate: psi': `ignored`, `differenced(sign)` or `modelled(sign)`.
        error_rate: e': `measured` or `differenced` of `parts.error_rate`.

    Returns:
        The controller. Equal arguments give the identical one.
    """

    def init(
        gains: NonlinearSurface, setpoint: Setpoint, measurement: Measurement
    ) -> SurfaceMemory:
        error, rate = errors(setpoint, measurement)
        psi = damping.apply(gains.damping, setpoint.velocity, measurement.velocity)
        return SurfaceMemory(
            surface=rate + (gains.slope + gains.damping_slope * psi) * error,
            damping=psi,
            reaching=reaching.start(gains.reaching),
            error_rate=error_rate.init(error),
        )

    def control(
        gains: NonlinearSurface,
        memory: SurfaceMemory,
        setpoint: Setpoint,
        measurement: Measurement,
        dt: float,
    ) -> tuple[Array, SurfaceMemory]:
        error, _ = errors(setpoint, measurement)
        rate, kept = error_rate.of(memory.error_rate, setpoint, measurement, dt)
        psi_at = functools.partial(damping.apply, gains.damping)
        psi = psi_at(setpoint.velocity, measurement.velocity)
        slope = gains.slope + gains.damping_slope * psi
        surface = rate + slope * error
        q = gains.switching_gain
        switched = q * switch.apply(gains.switch, surface, q * dt)
        free = setpoint.acceleration + slope * rate + memory.reaching * surface + switched
        motion = Motion(
            commanded=setpoint.velocity,
            commanded_rate=setpoint.acceleration,
            seen=measurement.velocity,
            acceleration=free,
            feedback=damping_rate.sign * gains.damping_slope * error,
        )
        total = free + motion.feedback * damping_rate.of(psi_at, motion, memory.damping, dt)
        axis = gains.nominal
        demand = (axis.mass * total + axis.damping * measurement.velocity) / axis.force_constant
        return demand, replace(memory, surface=surface, damping=psi, error_rate=kept)

    def settle(
        gains: NonlinearSurface, memory: SurfaceMemory, demand: Array, command: Array, dt: float
    ) -> SurfaceMemory:
        after = reaching.update(gains.reaching, memory.reaching, memory.surface, dt)
        return replace(memory, reaching=after)

    parts = (damping.name, reaching.name, switch.name, damping_rate.name, error_rate.name)
    return Controller(
        name=f"nonlinear_surface[{', '.join(parts)}]", init=init, control=control, settle=settle
    )
