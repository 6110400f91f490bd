"""External forces on the axes. Positive against +x. Evaluated inside the integrator."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.model.blocks import Load
from jaxstage.model.fields import param, pytree
from jaxstage.model.signals import Output


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


@pytree
class CouplingLoad:
    """Parameters of `coupling_load`."""

    coupling: Array = param(
        "N s/m", "C", "force on the row's axis per velocity of the column's", shape="(axes, axes)"
    )


def _coupling(params: CouplingLoad, time: Array, key: Array, output: Output) -> Array:
    return params.coupling @ output.velocity


@functools.cache
def all_loads(*loads: Load) -> Load:
    """The sum of several loads; params is the tuple of theirs. Each draws from a key of its own."""

    def force(params: tuple[Any, ...], time: Array, key: Array, output: Output) -> Array:
        keys = jax.random.split(key, len(loads))
        each = [
            load.force(own, time, k, output)
            for load, own, k in zip(loads, params, keys, strict=True)
        ]
        return sum(each[1:], start=each[0])

    return Load(name=" + ".join(load.name for load in loads), force=force)


#: No external force; params ``()``.
no_load = Load(name="no_load", force=_none)

#: F = F_0 + A sin(omega t + phi); params `SineLoad`.
sine_load = Load(name="sine_load", force=_sine)

#: F = C v: each axis feels the others move (cross-coupling); params `CouplingLoad`.
coupling_load = Load(name="coupling_load", force=_coupling)
