"""Vectors, directions and the projection of a point on a curve.

Everything acts on the last axis, works in one, two and three dimensions, and has a finite
gradient everywhere: a guarded square root never meets zero, in the value nor in the derivative.
NaN passes through.
"""

import jax.numpy as jnp
from jax import Array


def dot(a: Array, b: Array) -> Array:
    """a . b. a, b: (..., axes)."""
    return jnp.sum(a * b, axis=-1)


def norm(v: Array) -> Array:
    """|v|, with gradient 0 where v = 0. v: (..., axes)."""
    square = dot(v, v)
    zero = square == 0
    return jnp.where(zero, 0, jnp.sqrt(jnp.where(zero, 1, square)))


def unit(v: Array, fallback: Array, floor: Array | float = 0.0) -> Array:
    """v / |v| where |v| > floor, else ``fallback`` as it is.

    v, fallback: (..., axes), in any unit and dimensionless. floor: same unit as v, >= 0.
    """
    length = norm(v)
    small = length <= floor
    return jnp.where(small[..., None], fallback, v / jnp.where(small, 1, length)[..., None])


def normal_part(error: Array, tangent: Array) -> Array:
    """e - (e . t) t: what is left of an error beside the tangent.

    Its norm is the tangent estimate of the contour error: the distance of the tool to the
    tangent at the commanded point. error: (..., axes) m. tangent: (..., axes), unit length.
    """
    return error - dot(error, tangent)[..., None] * tangent


def left_normal(tangent: Array) -> Array:
    """(-t_y, t_x): the tangent turned left by a right angle. tangent: (..., 2)."""
    return jnp.stack([-tangent[..., 1], tangent[..., 0]], axis=-1)


def signed_side(offset: Array, tangent: Array) -> Array:
    """sign(t x d): 1 left of the direction of motion, -1 right of it, 0 on it.

    offset: (..., 2), tool minus nearest point. tangent: (..., 2).
    """
    return jnp.sign(dot(offset, left_normal(tangent)))


def bend(velocity: Array, acceleration: Array, floor: Array | float = 0.0) -> Array:
    """kappa = |a - (a . t) t| / |v|^2 in 1/m, t = v/|v|; 0 where |v| <= floor.

    velocity, acceleration: (..., axes), first and second derivative by the same parameter.
    """
    speed = norm(velocity)
    small = speed <= floor
    tangent = unit(velocity, jnp.zeros_like(velocity), floor)
    across = norm(normal_part(acceleration, tangent))
    return jnp.where(small, 0, across / jnp.where(small, 1, speed * speed))


def projection_step(offset: Array, first: Array, second: Array) -> Array:
    """g / den, the Newton step of the parameter towards the nearest point of a curve r.

    g = d . r', den = |r'|^2 - d . r'', d = p - r. Where den < |r'|^2 / 2 (beyond half the
    radius of curvature) den = |r'|^2; where r' = 0 the step is 0.
    offset: (axes,) m, d. first, second: (axes,), r' and r''.
    """
    square = dot(first, first)
    newton = square - dot(offset, second)
    den = jnp.where(newton < 0.5 * square, square, newton)
    still = den == 0
    return jnp.where(still, 0, dot(offset, first) / jnp.where(still, 1, den))
