"""Proportional-integral position law in velocity form.

    u <- u + K (c1 e + e') dt,   so u = K (e + c1 int e dt)

It is what the CMAC sliding-mode law becomes while the state stays in one cell, with
K = 2 r1 nu b |xi|^2: a test of the published claim that learning does more than integrate.

| symbol | field | unit |
|---|---|---|
| K | proportional_gain | command/m |
| c1 | slope | 1/s |

Anti-windup: the command is set back to what the drive could give and integrates on from there.
"""

import jax.numpy as jnp
from jax import Array

from jaxstage.controllers.parts.surface import errors, linear_surface
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import gain, pytree, signal
from jaxstage.model.signals import Measurement, Setpoint


@pytree
class Pi:
    """Gains of the PI law, one axis."""

    proportional_gain: Array = gain("command/m", "K", "proportional gain", low=0.0)
    slope: Array = gain("1/s", "c1", "inverse of the integral time", low=0.0)


@pytree
class PiMemory:
    """Integrated command, and the sliding variable that it integrates."""

    command: Array = signal("command", "u", "integrated command")
    surface: Array = signal("m/s", "s", "-(c1 e + e')", shown="mm/s")


def _init(gains: Pi, setpoint: Setpoint, measurement: Measurement) -> PiMemory:
    return PiMemory(
        command=jnp.zeros_like(measurement.position),
        surface=linear_surface(gains.slope, *errors(setpoint, measurement)),
    )


def _control(
    gains: Pi, memory: PiMemory, setpoint: Setpoint, measurement: Measurement, dt: float
) -> tuple[Array, PiMemory]:
    surface = linear_surface(gains.slope, *errors(setpoint, measurement))
    command = memory.command - gains.proportional_gain * surface * dt
    return command, PiMemory(command=command, surface=surface)


def _settle(gains: Pi, memory: PiMemory, demand: Array, command: Array, dt: float) -> PiMemory:
    return PiMemory(command=memory.command + (command - demand), surface=memory.surface)


#: The law for one axis; gains `Pi`.
pi = Controller(name="pi", init=_init, control=_control, settle=_settle)
