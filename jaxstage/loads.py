"""External forces on the axes. Positive against +x. Evaluated inside the integrator."""

import jax.numpy as jnp
from jax import Array

from jaxstage.blocks import Load
from jaxstage.fields import param, pytree
from jaxstage.signals import Output


def _none(params: tuple[()], time: Array, key: Array, output: Output) -> Array:
    return jnp.zeros_like(output.position)


@pytree
class SineLoad:
    """Parameters of `sine_load`, one value per axis."""

    amplitude: Array = param("N", "A", "amplitude", shape="(axes,)")
    frequency: Array = param("rad/s", "omega", "angular frequency", shape="(axes,)", low=0.0)
    phase: Array = param("rad", "phi", "phase at t = 0", shape="(axes,)")
    bias: Array = param("N", "F_0", "constant part", shape="(axes,)")


def _sine(params: SineLoad, time: Array, key: Array, output: Output) -> Array:
    return params.bias + params.amplitude * jnp.sin(params.frequency * time + params.phase)


#: No external force; params ``()``.
no_load = Load(name="no_load", force=_none)

#: F = F_0 + A sin(omega t + phi); params `SineLoad`.
sine_load = Load(name="sine_load", force=_sine)
