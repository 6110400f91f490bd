"""Every kink of the library: sign, clip, dead band, play, floor.

A kink that a user may want to soften is a `Switch`: a definition that maps a sliding variable to
w in [-1, 1]. Its forms are interchangeable and carry their width as a gain with a unit.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.model.fields import definition, gain, pytree

#: prefix of the scopes that name the kinks of a compiled loop, see `gradients.kinks`
KINK = "kink_"


def positive(x: Array) -> Array:
    """max(x, 0)."""
    with jax.named_scope(KINK + "positive"):
        return jnp.maximum(x, jnp.zeros_like(x))


def sign(x: Array) -> Array:
    """sgn x, with sgn 0 = 0 and gradient 0."""
    with jax.named_scope(KINK + "sign"):
        return jnp.sign(x)


def magnitude(x: Array) -> Array:
    """|x|, with gradient sgn x: 0 at 0."""
    with jax.named_scope(KINK + "magnitude"):
        return jnp.abs(x)


def clamp(x: Array, limit: Array) -> Array:
    """clip(x, -limit, limit) whose derivative at the limit is that of the limit.

    With limit 0 it is 0 with derivative 0 everywhere, x = 0 included: no friction and no
    backlash are transparent to a gradient too. (`jnp.clip` shares a tie between its branches.)
    """
    with jax.named_scope(KINK + "clamp"):
        return jnp.where(x >= limit, limit, jnp.where(x <= -limit, -limit, x))


@jax.custom_jvp
def quantise(x: Array, step: Array) -> Array:
    """step * floor(x / step + 1/2), round half up; a step of 0 leaves x.

    Its derivative is that of x: a staircase that is followed closely has the slope of its ramp,
    and the true derivative, 0, would cut the feedback of every loop with an encoder.
    """
    with jax.named_scope(KINK + "quantise"):
        safe = jnp.where(step > 0, step, jnp.ones_like(step))
        return jnp.where(step > 0, safe * jnp.floor(x / safe + 0.5), x)


@quantise.defjvp
def _quantise_jvp(
    primals: tuple[Array, Array], tangents: tuple[Array, Array]
) -> tuple[Array, Array]:
    value = quantise(*primals)
    return value, jnp.broadcast_to(tangents[0], value.shape)


@definition
class DryFriction:
    """How dry friction holds an axis in one implicit step.

    held(push, limit): what friction takes of a push, at most the limit; both in one unit and
    homogeneous, so speeds and forces may be given alike.
    """

    name: str
    held: Callable[[Array, Array], Array]


def _sticking(push: Array, limit: Array) -> Array:
    return clamp(push, limit)


def _creeping(push: Array, limit: Array) -> Array:
    safe = jnp.where(limit > 0, limit, jnp.ones_like(limit))
    return jnp.where(limit > 0, limit * jnp.tanh(push / safe), jnp.zeros_like(push))


#: clip(push, -limit, limit), the proximal map of dry friction: a small push sticks exactly.
sticking = DryFriction(name="sticking", held=_sticking)

#: limit tanh(push / limit): smooth, so a small push creeps. A surrogate for searches.
creeping = DryFriction(name="creeping", held=_creeping)


def play(state: Array, value: Array, half_width: Array) -> Array:
    """Backlash: the state stays until the value pushes it, clip(state, value - d, value + d)."""
    return value - clamp(value - state, half_width)


def cell(coordinate: Array, cells: int) -> Array:
    """Index of the unit cell that holds the coordinate, clip(floor z, 0, cells - 1)."""
    # clipped before the cast: the compiled engine then knows the range of the index
    with jax.named_scope(KINK + "cell"):
        return jnp.clip(jnp.floor(coordinate), 0, cells - 1).astype(jnp.int32)


def within(x: Array, low: Array | float, high: Array | float) -> Array:
    """clip(x, low, high): an input kept on its grid, a gain kept in its range."""
    with jax.named_scope(KINK + "within"):
        return jnp.clip(x, low, high)


def away_from_zero(x: Array, floor: float) -> Array:
    """x with a magnitude of at least ``floor`` and its own sign (+ at 0): a safe denominator."""
    with jax.named_scope(KINK + "away_from_zero"):
        limit = jnp.full_like(x, floor)
        return jnp.where(jnp.abs(x) >= floor, x, jnp.where(x < 0, -limit, limit))


def beyond(x: Array, limit: Array) -> Array:
    """|x| sgn(|x| - limit): the magnitude, negative within the limit. It jumps at the limit."""
    size = magnitude(x)
    with jax.named_scope(KINK + "beyond"):
        return size * jnp.sign(size - limit)


def switched(x: Array, threshold: Array, above: Array, below: Array) -> Array:
    """``above`` where x > threshold, else ``below``: a law of two branches, which jumps."""
    with jax.named_scope(KINK + "switched"):
        return jnp.where(x > threshold, above, below)


@definition
class Switch:
    """w(s) in [-1, 1] in place of sgn s.

    apply(params, surface, reach): ``surface`` s in m/s; ``reach`` in m/s is the change of s that
    full switching makes in one control period (switching gain times dt).
    """

    name: str
    apply: Callable[[Any, Array, Array], Array]


def _exact(params: tuple[()], surface: Array, reach: Array) -> Array:
    return sign(surface)


@pytree
class SmoothWidth:
    """Parameters of the `smooth` and `sat` switches."""

    width: Array = gain("m/s", "phi", "width of the switch", above=0.0, shown="mm/s")


def _smooth(params: SmoothWidth, surface: Array, reach: Array) -> Array:
    return jnp.tanh(surface / params.width)


def _sat(params: SmoothWidth, surface: Array, reach: Array) -> Array:
    with jax.named_scope(KINK + "layer"):
        return jnp.clip(surface / params.width, -1, 1)


@pytree
class Layer:
    """Parameters of the `implicit` switch."""

    layer: Array = gain(
        "1", "kappa", "boundary layer in units of the change of s per period", above=0.0
    )


def _implicit(params: Layer, surface: Array, reach: Array) -> Array:
    width = params.layer * reach
    safe = jnp.where(width > 0, width, jnp.ones_like(width))
    with jax.named_scope(KINK + "layer"):
        return jnp.where(width > 0, jnp.clip(surface / safe, -1, 1), jnp.sign(surface))


#: w = sgn s, with sgn 0 = 0; params ``()``. Its gradient is zero.
exact = Switch(name="exact", apply=_exact)

#: w = tanh(s / width); params `SmoothWidth`.
smooth = Switch(name="smooth", apply=_smooth)

#: w = sat(s / width) = clip(s / width, -1, 1), the classical boundary layer; params `SmoothWidth`.
sat = Switch(name="sat", apply=_sat)

#: w = clip(s / (kappa eta dt), -1, 1); params `Layer`. kappa = 1 is the implicit (dead-beat)
#: step: it reaches s = 0 and stays. With delay, quantisation or filters kappa 4 to 8 is needed.
implicit = Switch(name="implicit", apply=_implicit)
