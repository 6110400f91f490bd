"""Sensors: what the controller sees of the truth.

`ideal_sensor` and `encoder` read; `noisy` and `motor_side` change what another sensor reads.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.model.array_types import PerAxis, RandomKey
from jaxstage.model.blocks import Memory, Params, Sensor
from jaxstage.model.fields import param, part, pytree, replace, signal
from jaxstage.model.signals import Measurement, Output
from jaxstage.numerics.filters import low_pass_weight
from jaxstage.numerics.smooth import quantise


def _truth(output: Output) -> Measurement:
    return Measurement(
        position=output.position,
        velocity=output.velocity,
        drive_position=output.drive_position,
        drive_velocity=output.drive_velocity,
    )


@pytree
class Encoder:
    """Parameters of `encoder`."""

    resolution: Array = param(
        "m", "Res", "smallest step of the position; 0: exact", low=0.0, shown="um"
    )
    bandwidth: Array = param(
        "Hz", "f_v", "low-pass of the differenced velocity; inf: none", above=0.0, infinite=True
    )


@pytree
class EncoderMemory:
    """Last positions read and the filtered velocities."""

    last: Measurement
    fresh: Array = signal("1", "", "1 until the first sample was read")


def _encoder_init(params: Encoder, output: Output) -> EncoderMemory:
    return EncoderMemory(last=_truth(output), fresh=jnp.ones((), output.position.dtype))


def _encoder_read(
    params: Encoder, memory: EncoderMemory, key: RandomKey, output: Output, dt: float
) -> tuple[Measurement, EncoderMemory]:
    """v <- v + (1 - exp(-2 pi f dt)) ((y_k - y_{k-1})/dt - v); the first sample is the truth."""
    last = memory.last
    weight = low_pass_weight(params.bandwidth, dt)
    position = quantise(output.position, params.resolution)
    drive = quantise(output.drive_position, params.resolution)

    def filtered(now: PerAxis, before: PerAxis, speed: PerAxis, true_speed: PerAxis) -> PerAxis:
        smoothed = speed + weight * ((now - before) / dt - speed)
        return jnp.where(memory.fresh > 0, true_speed, smoothed)

    seen = Measurement(
        position=position,
        velocity=filtered(position, last.position, last.velocity, output.velocity),
        drive_position=drive,
        drive_velocity=filtered(
            drive, last.drive_position, last.drive_velocity, output.drive_velocity
        ),
    )
    return seen, EncoderMemory(last=seen, fresh=jnp.zeros_like(memory.fresh))


#: The exact state; params ``()``.
ideal_sensor: Sensor[tuple[()], tuple[()]] = Sensor(
    name="ideal_sensor",
    init=lambda params, output: (),
    read=lambda params, memory, key, output, dt: (_truth(output), ()),
)

#: Quantised position, differenced and filtered velocity; params `Encoder`.
encoder = Sensor(name="encoder", init=_encoder_init, read=_encoder_read)


@functools.cache
def motor_side(sensor: Sensor[Params, Memory]) -> Sensor[Params, Memory]:
    """The sensor with the motor side in the place of the tool: any law then acts on the motor."""

    def read(
        params: Params, memory: Memory, key: RandomKey, output: Output, dt: float
    ) -> tuple[Measurement, Memory]:
        seen, kept = sensor.read(params, memory, key, output, dt)
        turned = replace(seen, position=seen.drive_position, velocity=seen.drive_velocity)
        return turned, kept

    return Sensor(name=f"motor_side[{sensor.name}]", init=sensor.init, read=read)


@pytree
class Noisy:
    """Parameters of `noisy`."""

    noise: Array = param("m", "sigma", "standard deviation of the position", low=0.0, shown="um")
    sensor: Any = part("parameters of the sensor")


@functools.cache
def noisy(sensor: Sensor[Any, Memory]) -> Sensor[Noisy, Memory]:
    """The sensor on a position with white noise, drawn anew in every period; params `Noisy`.

    Tool and drive side have noise of their own. A sensor that differences makes a velocity of it,
    one that quantises rounds it; a velocity that is not made from the position stays exact.
    """

    def init(params: Noisy, output: Output) -> Memory:
        return sensor.init(params.sensor, output)

    def read(
        params: Noisy, memory: Memory, key: RandomKey, output: Output, dt: float
    ) -> tuple[Measurement, Memory]:
        own, tool, drive = jax.random.split(key, 3)
        x, x_d = output.position, output.drive_position
        shaken = replace(
            output,
            position=x + params.noise * jax.random.normal(tool, x.shape, x.dtype),
            drive_position=x_d + params.noise * jax.random.normal(drive, x_d.shape, x_d.dtype),
        )
        return sensor.read(params.sensor, memory, own, shaken, dt)

    return Sensor(name=f"noisy[{sensor.name}]", init=init, read=read)


#: An `encoder` on a position with noise; params `Noisy` around `Encoder`.
noisy_encoder = noisy(encoder)
