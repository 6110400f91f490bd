"""LuGre friction: bristles that bend before they slip, for rotating bodies.

    s(v) = F_c + (F_s - F_c) exp(-(v/v_s)^2)
    z' = v - sigma_0 |v| z / s(v),   F = sigma_0 z + sigma_1 z' + sigma_2 v                  (3)

v: speed of the body in rad/s; z: deflection of the bristles in rad; F: torque in N m.

| symbol | field | unit |
|---|---|---|
| F_c, F_s | coulomb, static | N m |
| v_s | stribeck | rad/s |
| sigma_0 | bristle_stiffness | N m/rad |
| sigma_1 | bristle_damping | N m s/rad |
| sigma_2 | viscous | N m s/rad |

Sliding steadily, z = s(v)/sigma_0 sgn v. With constant sigma_1 the model is passive only for
sigma_1 (F_s - F_c)/F_c < sigma_2; beyond that, sigma_1 z' makes torque peaks above F_s.
Source: the model of Canudas de Wit et al. as used by Zhang et al., Sensors 2023, 23, 9755,
equation (3); the implicit step is derived here.
"""

import jax.numpy as jnp
from jax import Array

from jaxstage.model.array_types import PerAxis
from jaxstage.model.fields import param, pytree
from jaxstage.numerics.smooth import magnitude, sign

AXES = "(axes,)"
PASSES = 2


@pytree
class Lugre:
    """Parameters of the friction, one value per axis."""

    coulomb: Array = param("N m", "F_c", "sliding friction", shape=AXES, above=0.0)
    static: Array = param(
        "N m", "F_s", "break-away friction", shape=AXES, above=0.0, at_least="coulomb"
    )
    stribeck: Array = param("rad/s", "v_s", "Stribeck speed", shape=AXES, above=0.0)
    bristle_stiffness: Array = param(
        "N m/rad", "sigma_0", "stiffness of the bristles", shape=AXES, above=0.0
    )
    bristle_damping: Array = param(
        "N m s/rad", "sigma_1", "damping of the bristles", shape=AXES, low=0.0
    )
    viscous: Array = param("N m s/rad", "sigma_2", "viscous friction", shape=AXES, low=0.0)


def level(params: Lugre, speed: PerAxis) -> PerAxis:
    """s(v): the friction torque of slow steady sliding, in N m. speed: rad/s."""
    fading = jnp.exp(-((speed / params.stribeck) ** 2))
    return params.coulomb + (params.static - params.coulomb) * fading


def bristle_rate(params: Lugre, speed: PerAxis, bristle: PerAxis) -> PerAxis:
    """z' in rad/s. speed: rad/s; bristle: z in rad."""
    slipping = params.bristle_stiffness * magnitude(speed) / level(params, speed)
    return speed - slipping * bristle


def friction_torque(params: Lugre, speed: PerAxis, bristle: PerAxis) -> PerAxis:
    """F in N m, against the motion."""
    return (
        params.bristle_stiffness * bristle
        + params.bristle_damping * bristle_rate(params, speed, bristle)
        + params.viscous * speed
    )


def dissipated(params: Lugre, speed: PerAxis, bristle: PerAxis) -> PerAxis:
    """F v - d/dt (sigma_0 z^2 / 2) in W: what friction turns into heat."""
    rate = bristle_rate(params, speed, bristle)
    elastic = params.bristle_stiffness * bristle * (speed - rate)
    return elastic + params.bristle_damping * rate * speed + params.viscous * speed**2


def implicit_step(
    params: Lugre, inertia: PerAxis, push: PerAxis, bristle: PerAxis, guess: PerAxis, dt: float
) -> tuple[PerAxis, PerAxis]:
    """Speed and bristle after an implicit Euler step of a body under this friction.

    M v + h F = p,   z = z_0 + h z' = (z_0 + h v) / (1 + a |v|),   a = h sigma_0 / s

    With s known, m = M + h sigma_2, b = p + sigma_1 z_0 and k = sigma_1 + h sigma_0 this is

        m a v |v| + (m + h k) v - a b |v| = b - k z_0

    a quadratic whose root v has the sign of its right-hand side. s is taken at ``guess``, then at
    the speed found: two passes keep the order of a second-order method. inertia: M in kg m2; push:
    p in N m s; bristle: z_0 in rad; guess: rad/s; dt: h in s.
    """
    stiff = params.bristle_damping + dt * params.bristle_stiffness
    mass = inertia + dt * params.viscous
    total = push + params.bristle_damping * bristle
    free = total - stiff * bristle
    speed, slip = guess, jnp.zeros_like(guess)
    for _ in range(PASSES):
        slip = dt * params.bristle_stiffness / level(params, speed)
        half = (mass + dt * stiff - slip * sign(free) * total) / 2
        square = half**2 + mass * slip * magnitude(free)
        moves = square > 0
        below = half + jnp.sqrt(jnp.where(moves, square, 1))
        moves = moves & (below > 0)
        speed = jnp.where(moves, free / jnp.where(moves, below, 1), 0)
    return speed, (bristle + dt * speed) / (1 + slip * magnitude(speed))
