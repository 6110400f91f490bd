"""Small disturbances at the places where a loop is cut, and the motion of its operating point.

Each wrapper adds something that the law does not hear of: to what reaches the plant (after limits,
delay and lag, so that anti-windup and observers stay quiet), to the force, to the measured
position, or to the setpoint. At zero the wrapped loop is the loop.
"""

import functools
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxstage.model.blocks import Drive, Load, Reference, Sensor
from jaxstage.model.fields import param, part, pytree, replace, signal
from jaxstage.model.signals import Measurement, Output, Setpoint
from jaxstage.references.motion import analytic


@pytree
class Injected:
    """Parameters of `injected`."""

    added: Array = param("1", "d", "added to the applied command, in its unit", shape="(axes,)")
    drive: Any = part("parameters of the drive")


@functools.cache
def injected(drive: Drive) -> Drive:
    """A drive whose output is ``applied + d``."""

    def init(params: Injected, command: Array) -> Any:
        return drive.init(params.drive, command)

    def apply(params: Injected, memory: Any, demand: Array, dt: float) -> tuple[Array, Array, Any]:
        command, applied, after = drive.apply(params.drive, memory, demand, dt)
        return command, applied + params.added, after

    return replace(drive, name=f"injected[{drive.name}]", init=init, apply=apply)


@pytree
class Oscillating:
    """Parameters of `oscillating`."""

    amplitude: Array = param("1", "a", "of the sine, in the unit of the command", shape="(axes,)")
    turns: Array = param("1", "n", "whole periods in a window")
    window: Array = param("1", "M", "control periods of a window")
    drive: Any = part("parameters of the drive")


@pytree
class OscillatingMemory:
    """Memory of `oscillating`."""

    drive: Any = part("memory of the drive")
    tick: Array = signal("1", "k", "control periods done")


@functools.cache
def oscillating(drive: Drive) -> Drive:
    """A drive whose output is ``applied + a sin(2 pi (n k mod M)/M)`` in control period k.

    n and M are whole numbers: the angle keeps its digits, and M periods hold whole turns.
    """

    def init(params: Oscillating, command: Array) -> OscillatingMemory:
        return OscillatingMemory(
            drive=drive.init(params.drive, command), tick=jnp.zeros((), jnp.int32)
        )

    def apply(
        params: Oscillating, memory: OscillatingMemory, demand: Array, dt: float
    ) -> tuple[Array, Array, OscillatingMemory]:
        command, applied, after = drive.apply(params.drive, memory.drive, demand, dt)
        turned = (params.turns * memory.tick) % params.window
        phase = turned.astype(applied.dtype) / params.window.astype(applied.dtype)
        sine = params.amplitude * jnp.sin(2 * jnp.pi * phase)
        return command, applied + sine, OscillatingMemory(drive=after, tick=memory.tick + 1)

    return replace(drive, name=f"oscillating[{drive.name}]", init=init, apply=apply)


@pytree
class Pushed:
    """Parameters of `pushed`."""

    added: Array = param("N", "F", "added to the external force", shape="(axes,)")
    load: Any = part("parameters of the load")


@functools.cache
def pushed(load: Load) -> Load:
    """A load with a constant force added, positive against +x."""

    def force(params: Pushed, time: Array, key: Array, output: Output) -> Array:
        return load.force(params.load, time, key, output) + params.added

    return replace(load, name=f"pushed[{load.name}]", force=force)


@pytree
class Displaced:
    """Parameters of `displaced`."""

    added: Array = param("m", "d", "added to the measured position", shape="(axes,)")
    sensor: Any = part("parameters of the sensor")


@functools.cache
def displaced(sensor: Sensor) -> Sensor:
    """A sensor whose measured tool position is off by d; its velocity is not."""

    def init(params: Displaced, output: Output) -> Any:
        return sensor.init(params.sensor, output)

    def read(
        params: Displaced, memory: Any, key: Array, output: Output, dt: float
    ) -> tuple[Measurement, Any]:
        seen, after = sensor.read(params.sensor, memory, key, output, dt)
        return replace(seen, position=seen.position + params.added), after

    return Sensor(name=f"displaced[{sensor.name}]", init=init, read=read)


@pytree
class Shifted:
    """Parameters of `shifted`."""

    position: Array = param("m", "dr", "added to the commanded position", shape="(axes,)")
    velocity: Array = param("m/s", "dr'", "added to the commanded velocity", shape="(axes,)")
    acceleration: Array = param("m/s2", "dr''", "added to the acceleration", shape="(axes,)")
    path: Any = part("parameters of the reference")


@functools.cache
def shifted(reference: Reference) -> Reference:
    """A reference whose setpoint is off by (dr, dr', dr''), each on its own."""

    def sample(params: Shifted, tick: Array) -> Setpoint:
        at = reference.sample(params.path, tick)
        return replace(
            at,
            position=at.position + params.position,
            velocity=at.velocity + params.velocity,
            acceleration=at.acceleration + params.acceleration,
        )

    return Reference(
        name=f"shifted[{reference.name}]",
        sample=sample,
        nearest=lambda params, tick, tool: reference.nearest(params.path, tick, tool),
        period=lambda params: reference.period(params.path),
    )


@pytree
class Straight:
    """Parameters of `straight`: where the motion begins, and its velocity."""

    begin: Array = param("m", "p0", "position at tick 0", shape="(axes,)", shown="mm")
    velocity: Array = param("m/s", "v", "constant velocity", shape="(axes,)", shown="mm/s")


def _line(params: Straight, time: Array) -> Array:
    return params.begin + params.velocity * time


def straight(dt: float) -> Reference:
    """The motion r = p0 + v t; v = 0 is standstill. dt: control period in s."""
    return analytic("straight", _line, dt)
