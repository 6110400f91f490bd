"""Orthogonal projection of a point onto a curve: the local minimum of the distance |p - r(q)|.

From a start, Newton on g = d . r' with d = p - r. Where the quadratic model of the squared distance
is poor the step follows the osculating circle instead, and the speed |r'| as it changes:

    poor where  |r'|^2 - d.r'' < |r'|^2 / 2,  |kappa tau| > (1 - d.k) / 2,  |a_t tau| > |r'|^2 / 2
    sigma = tau / max(sqrt((kappa tau)^2 + max(1 - d.k, 0)^2), |kappa tau| / 0.6)
    step  = 2 sigma / (|r'| + sqrt(|r'|^2 + 2 a_t sigma)),   -|r'| / a_t where the root is none

with tau = d . t, a_t = r'' . t and the curvature vector k = (r'' - a_t t) / |r'|^2, kappa = |k|.
sigma is an arc length of at most 0.6 rad, so that a step stays in its valley; from rest, r' = 0,
the step is sqrt(2 d.r'') / |r''|. Both converge quadratically where d.k < 1, near the centre of
curvature too, where Newton alone overshoots.

Source: Hu and Wallner, Computer Aided Geometric Design 22 (2005), a second-order algorithm for
orthogonal projection onto curves; limits chosen.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.numerics.geometry import dot, norm, projection_step

STEPS = 6  # exact to rounding where all are easy
FURTHER = 2  # steps of those that are not there yet
LEAP = 0.6  # rad, the longest step on a bend

#: point and derivatives (axes,) at a parameter ()
Curve = Callable[[Array], tuple[Array, Array, Array]]


class Projection(NamedTuple):
    """Where the distance is least. settled: false where the last step still changed it."""

    parameter: Array
    settled: Array


def project(
    curve: Curve, start: Array, tool: Array, ends: tuple[Array, Array] | None = None
) -> Projection:
    """Local minimum of the distance, downhill from a start.

    Only the last step carries a gradient: that of the implicit function at the minimum.

    Args:
        curve: r, r', r'' at a parameter.
        start: of the parameter, ().
        tool: p, (axes,) m.
        ends: least and largest parameter, (); None for a curve without ends.

    Returns:
        The parameter, and whether it has settled: the last step lowered the distance by less than
        a thousandth and it ends in a minimum.
    """

    def kept(q: Array) -> Array:
        return q if ends is None else jnp.clip(q, *ends)

    q = kept(start)
    for further in [False] * (STEPS - 1) + [True] * FURTHER:
        r, first, second = curve(q)
        moved = kept(q + step(tool - r, first, second))
        far = norm(first) * jnp.abs(moved - q) > 1e-9  # m
        q = jax.lax.stop_gradient(jnp.where(far, moved, q) if further else moved)
    r, first, second = curve(q)
    offset = tool - r
    q = kept(q + step(offset, first, second))
    before, after = norm(offset), norm(tool - curve(q)[0])
    uphill = dot(first, first) < dot(offset, second)
    return Projection(q, ~uphill & settled(before, after, tool))


def settled(before: Array, after: Array, tool: Array) -> Array:
    """Whether a step of the search lowered the distance by less than a thousandth, or nothing.

    Args:
        before: distance before it, () m.
        after: distance after it, () m.
        tool: (axes,) m; 1 nm and its rounding count as nothing.
    """
    rounding = 8 * jnp.finfo(after.dtype).eps * jnp.max(jnp.abs(tool))
    return before - after <= 1e-3 * after + 1e-9 + rounding


def step(offset: Array, first: Array, second: Array) -> Array:
    """Step of the parameter towards the nearest point of a curve r, see the equations above.

    Args:
        offset: d, (axes,) m.
        first: r', (axes,).
        second: r'', (axes,).
    """
    square, turned = dot(first, first), dot(second, second)
    ahead, inward, change = dot(offset, first), dot(offset, second), dot(first, second)
    moving = square > 0
    inverse = jnp.where(moving, 1 / jnp.where(moving, square, 1), 0)
    gauss = ahead * inverse
    along = 1 - (inward - change * gauss) * inverse
    turn = jnp.maximum(turned - change * change * inverse, 0) * gauss * gauss * inverse
    gain = change * inverse
    easy = (2 * (square - inward) >= square) & (4 * turn <= along * jnp.abs(along))
    easy = easy & (2 * jnp.abs(gain * gauss) <= 1)

    slope = jnp.maximum(turn + jnp.maximum(along, 0) ** 2, turn / LEAP**2)
    sloped = slope > 0
    arc = jnp.where(sloped, gauss / jnp.sqrt(jnp.where(sloped, slope, 1)), 0)
    left = jnp.where(moving, 1 + 2 * gain * arc, 2 * inward * turned)
    onward = left > 0
    root = jnp.where(onward, jnp.sqrt(jnp.where(onward, left, 1)), 0)
    above = jnp.where(moving, jnp.where(onward, 2 * arc, -1), root)
    below = jnp.where(moving, jnp.where(onward, 1 + root, gain), turned)
    curved = above / jnp.where(below == 0, 1, below)
    return jnp.where(easy, projection_step(offset, first, second), curved)
