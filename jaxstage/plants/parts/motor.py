"""A DC servo motor behind a current amplifier, with its electrical account.

    i = g_a u  as long as  |R i + k_t w| <= V_s,  else  R i = +-V_s - k_t w
    P = R i^2 + k_t i w,     drawn = max(P, 0) - eta_r max(-P, 0)

u: command in V; i: current; w: speed of the rotor in rad/s. k_t w is the back-EMF (in SI the EMF
constant is the torque constant), k_t i the torque. The current loop is taken as much faster than a
substep, and the inductance as nothing; a lag is the business of the drive.

| symbol | field | unit |
|---|---|---|
| k_t | torque_constant | N m/A |
| R | resistance | ohm |
| n, h | inertia, damping | kg m2, N m s/rad |
| g_a | amplifier_gain | A/V |
| V_s | supply_voltage, inf: never reached | V |
| eta_r | regeneration: 1 braking power is credited, 0 it is lost | 1 |
"""

import jax.numpy as jnp
from jax import Array

from jaxstage.model.array_types import PerAxis
from jaxstage.model.fields import param, pytree
from jaxstage.numerics.smooth import clamp, positive

AXES = "(axes,)"


@pytree
class Motor:
    """Parameters of the motors, one value per axis."""

    torque_constant: Array = param("N m/A", "k_t", "torque per current", shape=AXES, above=0.0)
    resistance: Array = param("ohm", "R_a", "armature resistance", shape=AXES, low=0.0)
    inertia: Array = param("kg m2", "n", "inertia of rotor and screw", shape=AXES, low=0.0)
    damping: Array = param("N m s/rad", "h", "viscous damping of the rotor", shape=AXES, low=0.0)
    amplifier_gain: Array = param("A/V", "g_a", "current per command", shape=AXES, above=0.0)
    supply_voltage: Array = param(
        "V", "V_s", "largest motor voltage", shape=AXES, above=0.0, infinite=True
    )
    regeneration: Array = param(
        "1", "eta_r", "share of the braking power taken back", shape=AXES, low=0.0, high=1.0
    )


def current(motor: Motor, command: PerAxis, speed: PerAxis) -> PerAxis:
    """i in A within the supply voltage. command: V; speed: rad/s, both (axes,).

    Without resistance the voltage says nothing about the current, which is then g_a u.
    """
    linear = motor.amplifier_gain * command
    resists = motor.resistance > 0
    safe = jnp.where(resists, motor.resistance, jnp.ones_like(motor.resistance))
    emf = motor.torque_constant * speed
    limited = (clamp(safe * linear + emf, motor.supply_voltage) - emf) / safe
    reached = resists & (jnp.abs(safe * linear + emf) > motor.supply_voltage)
    return jnp.where(reached, limited, linear)


def returned(motor: Motor, flowing: PerAxis, speed: PerAxis) -> PerAxis:
    """max(-P, 0) in W: electrical power that a braking motor gives back at an instant."""
    return positive(-(motor.resistance * flowing**2 + motor.torque_constant * flowing * speed))
