"""Dry friction as a smooth force, for machines that are integrated explicitly.

    F_f(v) = [F_c + (F_s - F_c) exp(-(v/v_s)^2)] tanh(v / w)

| symbol | field | unit |
|---|---|---|
| F_c | coulomb | N |
| F_s | static | N |
| v_s | stribeck | m/s |
| w | width | m/s |

It creeps in place of sticking: below w the axis feels a damping of F_s / w, and an explicit step h
is stable only for h F_s / (w M) < 2.8 (fourth order).
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxstage.model.array_types import PerAxis
from jaxstage.model.fields import definition, param, pytree

AXES = "(axes,)"


@definition
class FrictionLaw:
    """How large dry friction can be: ``limit(params, velocity)``, (axes,) N, from the parameters of
    the machine and the velocity (axes,) in m/s."""

    name: str
    limit: Callable[[Any, PerAxis], PerAxis]


@pytree
class CreepingFriction:
    """Parameters of the friction, one value per axis."""

    coulomb: Array = param("N", "F_c", "Coulomb friction", shape=AXES, low=0.0)
    static: Array = param(
        "N", "F_s", "break-away friction", shape=AXES, low=0.0, at_least="coulomb"
    )
    stribeck: Array = param("m/s", "v_s", "Stribeck velocity", shape=AXES, above=0.0)
    width: Array = param("m/s", "w", "speed at which it has set in", shape=AXES, above=0.0)


def friction_force(params: CreepingFriction, velocity: PerAxis) -> PerAxis:
    """F_f(v) in N, against the motion; velocity in m/s."""
    fading = jnp.exp(-((velocity / params.stribeck) ** 2))
    limit = params.coulomb + (params.static - params.coulomb) * fading
    return limit * jnp.tanh(velocity / params.width)
