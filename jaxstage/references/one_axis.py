"""Reciprocating motion and step of one axis, computed inside the tick.

A line has no contour: the nearest point of it lies wherever the tool stands.
"""

import functools

import jax.numpy as jnp
from jax import Array

from jaxstage.model.blocks import Reference
from jaxstage.model.fields import param, pytree
from jaxstage.references.checked import finite, positive
from jaxstage.references.motion import analytic


@pytree
class Swing:
    """Raised cosine r = A (1 + cos(2 pi t/T)): to and fro, from rest at 2 A to 0 and back."""

    amplitude: Array = param("m", "A", "half the stroke", above=0.0, shown="mm")
    period: Array = param("s", "T", "time to and fro", above=0.0)


@pytree
class StepMotion:
    """Step command: r = h from the start, for an axis that stands elsewhere."""

    height: Array = param("m", "h", "commanded position", shown="mm")


def swing(amplitude: float, period: float) -> Swing:
    """Checked parameters of a raised-cosine motion.

    Args:
        amplitude: A, half the stroke, m.
        period: T, s.

    Raises:
        ValueError: unless both are finite and > 0.
    """
    return Swing(
        amplitude=positive("amplitude", amplitude, "m"), period=positive("period", period, "s")
    )


def step(height: float) -> StepMotion:
    """Checked parameters of a step. height: h, m. Raises ValueError unless it is finite."""
    return StepMotion(height=finite("height", height))


def _raised_cosine(motion: Swing, time: Array) -> Array:
    return (motion.amplitude * (1 + jnp.cos(2 * jnp.pi * time / motion.period)))[None]


def _period(motion: Swing) -> Array:
    return motion.period


def _constant(motion: StepMotion, time: Array) -> Array:
    return motion.height[None]


@functools.cache
def swinging(dt: float) -> Reference[Swing]:
    """Raised-cosine motion of one axis; parameters `Swing`. dt: control period in s."""
    return analytic("swinging", _raised_cosine, dt, _period)


@functools.cache
def stepping(dt: float) -> Reference[StepMotion]:
    """Step of one axis; parameters `StepMotion`. dt: control period in s."""
    return analytic("stepping", _constant, dt)
