"""Commanded motions of one axis, computed inside the tick: a swing to and fro, and a step.

A line has no contour: the nearest point of it lies wherever the tool stands.
"""

import functools

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.model.blocks import Reference
from jaxstage.model.fields import param, pytree
from jaxstage.references.motion import analytic


@pytree
class Swing:
    """A motion to and fro: r = A (1 + cos(2 pi t/T)), from rest at 2 A to 0 and back."""

    amplitude: Array = param("m", "A", "half the stroke", above=0.0, shown="mm")
    period: Array = param("s", "T", "time to and fro", above=0.0)


@pytree
class StepMotion:
    """A step: r = h from the start, for an axis that stands elsewhere."""

    height: Array = param("m", "h", "commanded position", shown="mm")


def swing(amplitude: float, period: float) -> Swing:
    """A checked swing. amplitude: m; period: s. Raises ValueError unless both are finite, > 0."""
    for name, value, unit in (("amplitude", amplitude, "m"), ("period", period, "s")):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be finite and > 0 {unit}; got {value!r}")
    return Swing(
        amplitude=np.asarray(amplitude, float),  # type: ignore[arg-type]
        period=np.asarray(period, float),  # type: ignore[arg-type]
    )


def step(height: float) -> StepMotion:
    """A checked step. height: m. Raises ValueError unless it is finite."""
    if not np.isfinite(height):
        raise ValueError(f"height must be finite; got {height!r}")
    return StepMotion(height=np.asarray(height, float))  # type: ignore[arg-type]


def _swung(path: Swing, time: Array) -> Array:
    return (path.amplitude * (1 + jnp.cos(2 * jnp.pi * time / path.period)))[None]


def _held(path: StepMotion, time: Array) -> Array:
    return path.height[None]


@functools.cache
def swinging(dt: float) -> Reference:
    """The motion of a `Swing`; one axis. dt: control period in s."""
    return analytic("swinging", _swung, dt)


@functools.cache
def stepping(dt: float) -> Reference:
    """The motion of a `StepMotion`; one axis. dt: control period in s."""
    return analytic("stepping", _held, dt)
