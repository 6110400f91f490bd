"""Trifolium, a closed curve of three leaves, in closed form.

    x_1 = -(r/2) (cos 2 th + cos 4 th),   x_2 = (r/2) (sin 2 th - sin 4 th)         (22)
    |dx/dth| = r sqrt(5 - 4 cos 6 th),    length for th = 0 .. 2 pi: L = 13.364893 r

which is (22) multiplied out. The curve closes at th = pi: in the time T, th = 0 .. 2 pi, it is
traced twice, and three times a trace it runs through the origin. Two timings of the phase:

    `uniform_phase`   th' = 2 pi / T, as printed; the speed varies by a factor of 3
    `constant_feed_phase`   |x'| = L / T;  th' = v / (r g),  th'' = -v^2 g'(th) / (r^2 g^3),
                            g = sqrt(5 - 4 cos 6 th)

Source: Msukwa and Uchiyama, IEEE Access 7 (2019), equation (22). r and T are not printed.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.model.blocks import Reference
from jaxstage.model.fields import known, pytree
from jaxstage.model.signals import Nearest, Setpoint
from jaxstage.numerics.geometry import bend, norm
from jaxstage.references.checked import positive
from jaxstage.references.motion import time_of
from jaxstage.references.nearest import project

STEPS = 6  # Newton, exact to rounding
TERMS = 48  # of the arc length; they fall as 2^-n


@pytree
class Trifolium:
    """Parameters of a motion along a trifolium."""

    radius: Array = known("m", "r", "half the radius of a leaf", above=0.0, shown="mm")
    lap_time: Array = known("s", "T", "time for tracing the curve twice", above=0.0)


def make_trifolium(radius: float, lap_time: float) -> Trifolium:
    """Checked parameters of a trifolium.

    Args:
        radius: r, half the radius of a leaf, m.
        lap_time: T, time for tracing the curve twice, s.

    Raises:
        ValueError: unless both are finite and > 0.
    """
    return Trifolium(
        radius=positive("radius", radius, "m"), lap_time=positive("lap_time", lap_time, "s")
    )


@functools.cache
def _series() -> tuple[float, np.ndarray]:
    """c_0 and a_n, n = 1 .. TERMS, of int sqrt(5 - 4 cos p) dp = c_0 (p + sum a_n sin n p)."""
    count = 1024
    angle = 2 * np.pi * np.arange(count) / count
    cosine = np.fft.rfft(np.sqrt(5 - 4 * np.cos(angle))).real / count
    n = np.arange(1, TERMS + 1)
    return float(cosine[0]), 2 * cosine[1 : TERMS + 1] / (cosine[0] * n)


def length(params: Trifolium) -> Array:
    """Length L of two traces, the way in the time T, () m."""
    return 2 * jnp.pi * _series()[0] * params.radius


def _stretched(angle: Array) -> Array:
    """p + sum a_n sin n p: 6 times the arc length of th = p / 6, in units of L / (2 pi)."""
    terms = jnp.asarray(_series()[1], angle.dtype)
    n = jnp.arange(1, TERMS + 1, dtype=angle.dtype)
    return angle + jnp.sum(terms * jnp.sin(n * angle))


def _speed(phase: Array) -> Array:
    """g = |dx/dth| / r, between 1 and 3."""
    return jnp.sqrt(5 - 4 * jnp.cos(6 * phase))


#: th in rad, th' and th'' at a time in s
Phase = Callable[[Trifolium, Array], tuple[Array, Array, Array]]


def uniform_phase(params: Trifolium, time: Array) -> tuple[Array, Array, Array]:
    """Uniform phase th = 2 pi t / T.

    Args:
        params: of the trifolium.
        time: t, () s.

    Returns:
        th in rad, th' in rad/s, th'' in rad/s2.
    """
    rate = 2 * jnp.pi / params.lap_time
    return rate * time, rate, jnp.zeros_like(rate)


def constant_feed_phase(params: Trifolium, time: Array) -> tuple[Array, Array, Array]:
    """Phase of constant feed: th from the arc length L t / T by Newton.

    The last step carries the gradient.

    Args:
        params: of the trifolium.
        time: t, () s.

    Returns:
        th in rad, th' in rad/s, th'' in rad/s2.
    """
    mean = _series()[0]
    way = 12 * jnp.pi * time / params.lap_time
    angle = way
    for last in [False] * (STEPS - 1) + [True]:
        angle = angle - (_stretched(angle) - way) * mean / _speed(angle / 6)
        angle = angle if last else jax.lax.stop_gradient(angle)
    phase = angle / 6
    speed = _speed(phase)
    rate = 2 * jnp.pi * mean / (params.lap_time * speed)
    bending = 12 * jnp.sin(6 * phase) / speed
    return phase, rate, -(rate**2) * bending / speed


def _curve(radius: Array, phase: Array) -> tuple[Array, Array, Array]:
    """x, dx/dth, d2x/dth2, each (2,) m."""
    two, four = 2 * phase, 4 * phase
    half = radius / 2
    place = jnp.stack([-(jnp.cos(two) + jnp.cos(four)), jnp.sin(two) - jnp.sin(four)])
    first = jnp.stack([2 * jnp.sin(two) + 4 * jnp.sin(four), 2 * jnp.cos(two) - 4 * jnp.cos(four)])
    second = jnp.stack(
        [4 * jnp.cos(two) + 16 * jnp.cos(four), -4 * jnp.sin(two) + 16 * jnp.sin(four)]
    )
    return half * place, half * first, half * second


@functools.cache
def trifolium(dt: float, phase: Phase = uniform_phase) -> Reference[Trifolium]:
    """Motion along a trifolium, computed in the tick; parameters from `make_trifolium`.

    ``nearest`` is the local minimum downhill from the commanded phase (`nearest.project`), so it
    stays on the leaf being traced: near the origin another one may be closer. Its `arc` is the arc
    length from th = 0, twice round; its `reach` 0 where the search has not settled.

    Args:
        dt: control period in s; t = k dt.
        phase: `uniform_phase` or `constant_feed_phase`.
    """

    def at(params: Trifolium, tick: Array) -> tuple[Array, Array, Array]:
        return phase(params, time_of(params, tick, dt, lambda params: params.lap_time))

    def sample(params: Trifolium, tick: Array) -> Setpoint:
        angle, rate, rate_change = at(params, tick)
        place, first, second = _curve(params.radius, angle)
        return Setpoint(
            position=place,
            velocity=first * rate,
            acceleration=second * rate**2 + first * rate_change,
            tangent=first / (params.radius * _speed(angle)),
            curvature=bend(first, second),
        )

    def nearest(params: Trifolium, tick: Array, tool: Array) -> Nearest:
        begin, _, _ = at(params, tick)
        angle, settled = project(functools.partial(_curve, params.radius), begin, tool)
        point = _curve(params.radius, angle)[0]
        return Nearest(
            point=point,
            distance=norm(tool - point),
            arc=length(params) / (12 * jnp.pi) * _stretched(6 * angle),
            reach=jnp.where(settled, jnp.inf, jnp.zeros_like(angle)),
        )

    return Reference(name="trifolium", sample=sample, nearest=nearest, period=lambda params: dt)
