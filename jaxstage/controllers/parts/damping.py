"""Damping function psi of a nonlinear sliding surface, and its rate.

    psi = beta / (1 - 1/e) [exp(rho - 1) - 1/e]                                     (8)

rho compares the speed of the axis with the commanded one, so psi grows from 0 at rest to beta at
the commanded speed. The forms differ in rho:

| form | rho | psi |
|---|---|---|
| `raw` | (y'/r')^2, as printed | not defined at a reversal of r', without bound above |
| `bounded_below` | (y'^2 + v0^2) / (r'^2 + v0^2) | smooth, without bound above |
| `bounded` | the same, at most 1 | 0 <= psi <= beta |
| `constant` | 1 | beta: a linear surface |

The surface s = e' + (lam + gam psi) e has the rate of psi in its derivative. psi' needs y'', hence
the command that it is a term of: an algebraic loop. The forms of a `DampingRate`:

| form | psi' |
|---|---|
| `ignored` | 0 |
| `differenced` | (psi_k - psi_{k-1}) / dt |
| `modelled` | the loop solved: (psi_y' a + psi_r' r'') / (1 - psi_y' sigma gam e) |

where psi_y', psi_r' are the partial derivatives of psi and a the acceleration that the law asks for
without the term. sigma is the sign of the term sigma gam psi' e in the command: +1 follows from the
surface with psi >= 0, -1 is the sign as printed.

Source: Msukwa and Uchiyama, IEEE Access 7 (2019), equations (7), (8), (12); v0, the bound and the
rates are choices: the paper leaves reversals and the loop open.
"""

import functools
import math
from collections.abc import Callable
from typing import Generic, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from jaxstage.model.blocks import Params
from jaxstage.model.fields import definition, gain, pytree
from jaxstage.numerics.smooth import away_from_zero, within

#: psi(commanded velocity, measured velocity), both in m/s
Psi = Callable[[Array, Array], Array]


@definition
class Damping(Generic[Params]):
    """A damping function psi.

    Attributes:
        name: what it is called.
        apply: (params, commanded velocity m/s, measured velocity m/s) -> psi, () 1.
    """

    name: str
    apply: Callable[[Params, Array, Array], Array]


@pytree
class FinalDamping:
    """Parameter of `raw` and `constant`."""

    final: Array = gain("1", "beta", "psi at the commanded speed", low=0.0)


@pytree
class BoundedDamping:
    """Parameters of `bounded` and `bounded_below`."""

    final: Array = gain("1", "beta", "psi at the commanded speed", low=0.0)
    speed: Array = gain("m/s", "v0", "speed below which psi is blurred", above=0.0, shown="mm/s")


def _of_ratio(final: Array, ratio: Array) -> Array:
    return final / (1 - math.exp(-1)) * (jnp.exp(ratio - 1) - math.exp(-1))


def _blurred(params: BoundedDamping, commanded: Array, seen: Array) -> Array:
    return (seen**2 + params.speed**2) / (commanded**2 + params.speed**2)


def _raw(params: FinalDamping, commanded: Array, seen: Array) -> Array:
    """(8) as printed.

    Raises:
        ValueError: at a commanded velocity of 0 m/s, when called directly. Traced it gives NaN.
    """
    if not isinstance(commanded, Tracer) and np.any(np.asarray(commanded) == 0):
        raise ValueError("psi as printed is not defined at a commanded velocity of 0 m/s")
    return _of_ratio(params.final, (seen / commanded) ** 2)


def _bounded_below(params: BoundedDamping, commanded: Array, seen: Array) -> Array:
    return _of_ratio(params.final, _blurred(params, commanded, seen))


def _bounded(params: BoundedDamping, commanded: Array, seen: Array) -> Array:
    return _of_ratio(params.final, within(_blurred(params, commanded, seen), 0.0, 1.0))


def _constant(params: FinalDamping, commanded: Array, seen: Array) -> Array:
    return params.final


#: (8) as printed; params `FinalDamping`.
raw = Damping(name="raw", apply=_raw)

#: Smooth everywhere, but without bound where the axis is faster than commanded; `BoundedDamping`.
bounded_below = Damping(name="bounded_below", apply=_bounded_below)

#: 0 <= psi <= beta; params `BoundedDamping`.
bounded = Damping(name="bounded", apply=_bounded)

#: psi = beta; params `FinalDamping`.
constant = Damping(name="constant", apply=_constant)


class Motion(NamedTuple):
    """What psi' is made of, at one tick, each ().

    Attributes:
        commanded: r', m/s.
        commanded_rate: r'', m/s2.
        seen: y', m/s.
        acceleration: a, what the law demands without the term, m/s2.
        feedback: sigma gam e, what the term makes of psi', m/s.
    """

    commanded: Array
    commanded_rate: Array
    seen: Array
    acceleration: Array
    feedback: Array


@definition
class DampingRate:
    """A form of psi', and the sign of its term in the command.

    Attributes:
        name: what it is called.
        sign: sigma, 1 or -1.
        of: (psi, motion, psi one period ago, dt s) -> psi', () 1/s.
    """

    name: str
    sign: int
    of: Callable[[Psi, Motion, Array, float], Array]


def _ignored(psi: Psi, motion: Motion, last: Array, dt: float) -> Array:
    return jnp.zeros_like(last)


def _differenced(psi: Psi, motion: Motion, last: Array, dt: float) -> Array:
    return (psi(motion.commanded, motion.seen) - last) / dt


def _modelled(psi: Psi, motion: Motion, last: Array, dt: float) -> Array:
    """The loop solved for psi'; its denominator is kept 0.1 from 0 (chosen)."""
    at = (motion.commanded, motion.seen)
    zero, one = jnp.zeros_like(motion.seen), jnp.ones_like(motion.seen)
    _, by_seen = jax.jvp(psi, at, (zero, one))
    _, free = jax.jvp(psi, at, (motion.commanded_rate, motion.acceleration))
    return free / away_from_zero(1 - by_seen * motion.feedback, 0.1)


#: psi' = 0.
ignored = DampingRate(name="ignored", sign=1, of=_ignored)


def _checked(sign: int) -> int:
    if sign not in (1, -1):
        raise ValueError(f"sign = {sign}: must be 1 (consistent) or -1 (as printed)")
    return sign


@functools.cache
def differenced(sign: int = 1) -> DampingRate:
    """Backward difference of psi over one period.

    Args:
        sign: sigma, 1 (consistent) or -1 (as printed).

    Raises:
        ValueError: for another sign.
    """
    return DampingRate(name="differenced", sign=_checked(sign), of=_differenced)


@functools.cache
def modelled(sign: int = 1) -> DampingRate:
    """Model-based psi': the algebraic loop solved with the nominal axis.

    Args:
        sign: sigma, 1 (consistent) or -1 (as printed).

    Raises:
        ValueError: for another sign.
    """
    return DampingRate(name="modelled", sign=_checked(sign), of=_modelled)
