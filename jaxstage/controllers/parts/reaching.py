"""Reaching law s' = -K s of sliding mode: the gain K, and how it adapts.

| form | K' | range | params |
|---|---|---|---|
| `fixed` | 0 | | `FixedGain` |
| `adaptive` | a if K > alpha, else mu (14) | 0 .. K_max | `AdaptiveGain` |
| `adaptive_floored` | a | alpha .. K_max | `AdaptiveGain` |
| `adaptive_smooth` | kbar m (m^2 - eps^2) / (m^2 + eps^2) | alpha .. K_max | `AdaptiveGain` |
| `integral` | rho s^2 | 0 .. K_max | `IntegralGain` |

with a = kbar m sgn(m - eps), m the magnitude of s.

Each is an explicit Euler step of one period, used from the next sample on. `adaptive` jumps between
its branches, which ruins gradients; `adaptive_floored` keeps K at the floor instead and differs
only there (mu has no effect). It still jumps at m = eps, so its gradient by eps is 0 although eps
matters. `adaptive_smooth` (chosen) has tanh ln(m / eps) in place of sgn(m - eps): the same zero and
the same limits far from it, without a jump, for tuning eps by gradients.

K rises while |s| > eps and falls while |s| < eps. In a smooth loop |s| is about |d| / (J K), so K
settles near |d| / (J eps), whatever its start, and rises above K(0) only if eps < |d| / (J K(0)).

Source: Msukwa and Uchiyama, IEEE Access 7 (2019), equation (14); the integral law is that of their
reference [32]. The cap is a choice. All values of (14) are missing there.
"""

from collections.abc import Callable
from typing import Generic

from jax import Array

from jaxstage.model.blocks import Params
from jaxstage.model.fields import definition, gain, pytree
from jaxstage.numerics.smooth import away_from_zero, beyond, magnitude, switched, within


@definition
class ReachingGain(Generic[Params]):
    """A form of the reaching gain.

    Attributes:
        name: what it is called.
        start: (params) -> K, () 1/s.
        update: (params, K 1/s, s m/s, dt s) -> K of the next sample, once a period.
    """

    name: str
    start: Callable[[Params], Array]
    update: Callable[[Params, Array, Array, float], Array]


@pytree
class FixedGain:
    """Parameter of `fixed`."""

    start: Array = gain("1/s", "K0", "reaching gain", low=0.0)


@pytree
class AdaptiveGain:
    """Parameters of `adaptive` and `adaptive_floored`."""

    start: Array = gain("1/s", "K0", "reaching gain at the start", low=0.0)
    rate: Array = gain("1/(m s)", "kbar", "adaptation rate", low=0.0)
    dead_zone: Array = gain("m/s", "eps", "|s| below which K falls", low=0.0, shown="mm/s")
    floor: Array = gain("1/s", "alpha", "K at which it no longer falls", low=0.0)
    recovery: Array = gain("1/s2", "mu", "rate of K at the floor", low=0.0)
    cap: Array = gain("1/s", "K_max", "largest K", above=0.0, infinite=True)


@pytree
class IntegralGain:
    """Parameters of `integral`."""

    start: Array = gain("1/s", "K0", "reaching gain at the start", low=0.0)
    rate: Array = gain("1/m2", "rho", "adaptation rate", low=0.0)
    cap: Array = gain("1/s", "K_max", "largest K", above=0.0, infinite=True)


def _start(params: FixedGain | AdaptiveGain | IntegralGain) -> Array:
    return params.start


def _fixed(params: FixedGain, value: Array, surface: Array, dt: float) -> Array:
    return params.start


def _adaptive(params: AdaptiveGain, value: Array, surface: Array, dt: float) -> Array:
    change = params.rate * beyond(surface, params.dead_zone)
    change = switched(value, params.floor, change, params.recovery)
    return within(value + dt * change, 0.0, params.cap)


def _adaptive_floored(params: AdaptiveGain, value: Array, surface: Array, dt: float) -> Array:
    change = params.rate * beyond(surface, params.dead_zone)
    return within(value + dt * change, params.floor, params.cap)


def _adaptive_smooth(params: AdaptiveGain, value: Array, surface: Array, dt: float) -> Array:
    here, turn = surface**2, params.dead_zone**2
    share = (here - turn) / away_from_zero(here + turn, 1e-30)
    change = params.rate * magnitude(surface) * share
    return within(value + dt * change, params.floor, params.cap)


def _integral(params: IntegralGain, value: Array, surface: Array, dt: float) -> Array:
    return within(value + dt * params.rate * surface**2, 0.0, params.cap)


#: K = K0; params `FixedGain`.
fixed = ReachingGain(name="fixed", start=_start, update=_fixed)

#: Equation (14) with a cap; params `AdaptiveGain`.
adaptive = ReachingGain(name="adaptive", start=_start, update=_adaptive)

#: Equation (14) without its second branch, continuous in K; params `AdaptiveGain`.
adaptive_floored = ReachingGain(name="adaptive_floored", start=_start, update=_adaptive_floored)

#: As `adaptive_floored`, continuous in s and eps too; params `AdaptiveGain`.
adaptive_smooth = ReachingGain(name="adaptive_smooth", start=_start, update=_adaptive_smooth)

#: Only ever rises; params `IntegralGain`.
integral = ReachingGain(name="integral", start=_start, update=_integral)
