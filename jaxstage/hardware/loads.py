"""Loads: external forces on the axes in N, positive against +x, evaluated inside the integrator.

| load | force |
|---|---|
| `no_load` | 0 |
| `sine_load` | F_0 + A sin(omega t + phi) |
| `coupling_load` | C v |
| `all_loads` | the sum of several |
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.model.array_types import PerAxis, RandomKey, Scalar
from jaxstage.model.blocks import Load
from jaxstage.model.fields import param, pytree
from jaxstage.model.signals import Output


@pytree
class SineLoad:
    """Parameters of `sine_load`, one value per axis."""

    amplitude: Array = param("N", "A", "amplitude", shape="(axes,)")
    frequency: Array = param("rad/s", "omega", "angular frequency", shape="(axes,)", low=0.0)
    phase: Array = param("rad", "phi", "phase at t = 0", shape="(axes,)")
    bias: Array = param("N", "F_0", "constant part", shape="(axes,)")


def _sine(params: SineLoad, time: Scalar, key: RandomKey, output: Output) -> PerAxis:
    return params.bias + params.amplitude * jnp.sin(params.frequency * time + params.phase)


@pytree
class CouplingLoad:
    """Parameters of `coupling_load`."""

    coupling: Array = param(
        "N s/m", "C", "force on the row's axis per velocity of the column's", shape="(axes, axes)"
    )


def _coupling(params: CouplingLoad, time: Scalar, key: RandomKey, output: Output) -> PerAxis:
    return params.coupling @ output.velocity


@functools.cache
def all_loads(*loads: Load[Any]) -> Load[tuple[Any, ...]]:
    """The sum of several loads; params is the tuple of theirs. Each draws from a key of its own."""

    def force(params: tuple[Any, ...], time: Scalar, key: RandomKey, output: Output) -> PerAxis:
        keys = jax.random.split(key, len(loads))
        each = [
            load.force(own, time, k, output)
            for load, own, k in zip(loads, params, keys, strict=True)
        ]
        return sum(each[1:], start=each[0])

    return Load(name=" + ".join(load.name for load in loads), force=force)


#: No external force; params ``()``.
no_load: Load[tuple[()]] = Load(
    name="no_load", force=lambda params, time, key, output: jnp.zeros_like(output.position)
)

#: F = F_0 + A sin(omega t + phi); params `SineLoad`.
sine_load = Load(name="sine_load", force=_sine)

#: F = C v: each axis feels the others move (cross-coupling); params `CouplingLoad`.
coupling_load = Load(name="coupling_load", force=_coupling)
