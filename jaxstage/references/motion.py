"""Trajectories computed inside the tick: nothing is stored, so every run may have its own.

`analytic` takes any position function of time; `nurbs_lap` runs through a NURBS whose arrays are
the parameters. Both are cached: equal arguments give the identical definition.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.model.blocks import Reference
from jaxstage.model.signals import Nearest, Setpoint
from jaxstage.numerics.geometry import bend, norm, unit
from jaxstage.references.nearest import project
from jaxstage.references.nurbs import Nurbs, degree, in_span, span_of

#: r(params, time s) in m, (axes,)
Position = Callable[[Any, Array], Array]


#: (params, tick) -> t in s
Clock = Callable[[Any, Array], Array]

#: T(params) in s, after which a motion repeats
Lap = Callable[[Any], Array]


@cache
def analytic(name: str, position: Position, dt: float, lap: Lap | None = None) -> Reference[Any]:
    """Analytic trajectory: r(t), r'(t), r''(t) by nested differentiation at t = k dt.

    Where |r'| <= 1e-6 dt |r''| (rest, reversal) the tangent is that of r'' and the curvature 0.
    ``nearest`` is the local minimum downhill from the commanded time (`nearest.project`). There is
    no lap, so its `arc` counts from the commanded point (negative: behind it); its `reach` is 0
    where the search has not settled.

    Args:
        name: unique in the library.
        position: r, a pure function (params, time () s) -> (axes,) m.
        dt: control period in s.
        lap: of a motion that repeats: its period, see `time_of`. Without one, single precision
            rounds k dt, and with it the setpoint, by up to 6e-8 of the way made so far.
    """
    time = partial(time_of, dt=dt, lap=lap)
    return Reference(
        name=name,
        sample=partial(_analytic_sample, position, time, dt),
        nearest=partial(_analytic_nearest, position, time),
        period=lambda params: dt,
    )


def _analytic_sample(
    position: Position, time: Clock, dt: float, params: Any, tick: Array
) -> Setpoint:
    r, v, a = _motion(position, params, time(params, tick))
    floor = 1e-6 * dt * norm(a)
    return Setpoint(
        position=r,
        velocity=v,
        acceleration=a,
        tangent=unit(v, unit(a, jnp.zeros_like(a)), floor),
        curvature=bend(v, a, floor),
    )


def _analytic_nearest(
    position: Position, clock: Clock, params: Any, tick: Array, tool: Array
) -> Nearest:
    begin = clock(params, tick)
    time, settled = project(partial(_motion, position, params), begin, tool)
    point = position(params, time)
    speed = jax.vmap(lambda t: norm(_motion(position, params, t)[1]))
    arc = _quadrature(speed, begin, time)
    return Nearest(
        point=point,
        distance=norm(tool - point),
        arc=arc,
        reach=jnp.where(settled, jnp.inf, jnp.zeros_like(arc)),
    )


def float_kind(params: Any) -> np.dtype:
    """Float type of the parameters, JAX's default without any."""
    kinds = [jnp.asarray(leaf).dtype for leaf in jax.tree.leaves(params)]
    real = [kind for kind in kinds if jnp.issubdtype(kind, jnp.floating)]
    return real[0] if real else jnp.zeros(()).dtype


def time_of(params: Any, tick: Array, dt: float, lap: Lap | None = None) -> Array:
    """Time k dt of a tick, in the float type of the parameters (JAX's default without any).

    In single precision, of a motion that repeats it is the time since a whole number of laps,
    k dt - L T = (k - L n) dt - L (T - n dt), with n = round(T/dt). The bracket is counted in
    integers, so that the same phase has the same time in every lap; T - n dt counts as 0 below 4
    roundings of T.

    Args:
        params: of the motion.
        tick: k, () integer.
        dt: control period in s.
        lap: T(params), the period; None for a motion that does not repeat.
    """
    kind, tick = float_kind(params), jnp.asarray(tick)
    if lap is None or kind == jnp.float64:
        return tick.astype(kind) * dt
    whole = jnp.abs(jnp.asarray(lap(params), kind))
    # one lap of all the ticks there are, where it is longer than can be counted: a motion at rest
    counted = (whole > 0) & (whole < 2**30 * dt)
    whole = jnp.where(counted, whole, 2**30 * dt)
    ticks = jnp.maximum(jnp.round(whole / dt), 1)
    rest = whole - ticks * dt
    unheard = jnp.abs(rest) <= 4 * jnp.finfo(kind).eps * whole
    rest = rest - jax.lax.stop_gradient(jnp.where(unheard, rest, 0))
    count = jax.lax.stop_gradient(ticks).astype(tick.dtype)
    laps = jnp.floor(tick.astype(kind) / count.astype(kind)).astype(tick.dtype)
    left = tick - laps * count  # the quotient is rounded: one lap too many or too few
    off = (left >= count).astype(tick.dtype) - (left < 0).astype(tick.dtype)
    left, laps = left - off * count, laps + off
    return left.astype(kind) * dt - laps.astype(kind) * rest


def _motion(position: Position, params: Any, time: Array) -> tuple[Array, Array, Array]:
    def rate(f: Callable[[Array], Array]) -> Callable[[Array], Array]:
        return lambda t: jax.jvp(f, (t,), (jnp.ones_like(t),))[1]

    at = partial(position, params)
    return at(time), rate(at)(time), rate(rate(at))(time)


def _quadrature(integrand: Callable[[Array], Array], start: Array, end: Array) -> Array:
    """Gauss, 8 points. start, end: ()."""
    x, w = np.polynomial.legendre.leggauss(8)
    middle, half = (start + end) / 2, (end - start) / 2
    values = integrand(middle + half * jnp.asarray(x, half.dtype))
    return half * jnp.sum(values * jnp.asarray(w, half.dtype))


@cache
def nurbs_lap(ticks_per_lap: int, dt: float) -> Reference[Nurbs]:
    """Uniform-parameter lap of a NURBS, computed in every tick; the parameters are a `Nurbs`.

    u = u_0 + (u_end - u_0) (k mod n)/n, u' = (u_end - u_0)/(n dt): the setpoints of `make_path`
    with `uniform_parameter`.
    ``nearest`` is the local minimum (`nearest.project`) within the commanded span and, each on its
    own, the spans before and after it (over the closure too), so corners are exact. Its `reach` is
    the distance to the nearer end of these spans; inf where they are the whole curve, 0 where the
    search has not settled.

    Args:
        ticks_per_lap: n.
        dt: control period in s.

    Raises:
        ValueError: for n < 1.
    """
    if ticks_per_lap < 1:
        raise ValueError(f"ticks_per_lap must be >= 1; got {ticks_per_lap}")
    return Reference(
        name="nurbs_lap",
        sample=partial(_lap_sample, ticks_per_lap, dt),
        nearest=partial(_lap_nearest, ticks_per_lap),
        period=lambda curve: dt,
    )


def _lap_phase(count: int, curve: Nurbs, tick: Array) -> tuple[Array, Array]:
    """Span and u of a tick: integers first, and a few roundings of slack at the knots."""
    knots = curve.knots
    whole = knots[-1] - knots[0]
    phase = (jnp.asarray(tick) % count).astype(knots.dtype) / count
    u = knots[0] + whole * phase
    slack = 8 * jnp.finfo(knots.dtype).eps * jnp.maximum(jnp.abs(knots[0]), jnp.abs(knots[-1]))
    span = span_of(curve, u, slack)
    return span, jnp.maximum(u, knots[span])


def _lap_sample(count: int, dt: float, curve: Nurbs, tick: Array) -> Setpoint:
    curve = jax.tree.map(jnp.asarray, curve)
    span, u = _lap_phase(count, curve, tick)
    r, first, second = in_span(curve, span, u)
    rate = (curve.knots[-1] - curve.knots[0]) / (count * dt)
    floor = 1e-6 / count * norm(second) * (curve.knots[-1] - curve.knots[0])
    return Setpoint(
        position=r,
        velocity=first * rate,
        acceleration=second * rate * rate,
        tangent=unit(first, unit(second, jnp.zeros_like(second)), floor),
        curvature=bend(first, second, floor),
    )


def _lap_nearest(count: int, curve: Nurbs, tick: Array, tool: Array) -> Nearest:
    curve = jax.tree.map(jnp.asarray, curve)
    knots, points = curve.knots, curve.control_points
    own, u_own = _lap_phase(count, curve, tick)
    first, last = degree(curve), points.shape[0] - 1
    extent = jnp.max(jnp.max(points, axis=0) - jnp.min(points, axis=0))
    closed = jnp.max(jnp.abs(points[-1] - points[0])) <= 1e-6 * extent
    before = jnp.sum(knots < knots[own], dtype=jnp.int32) - 1
    after = jnp.sum(knots <= knots[own + 1], dtype=jnp.int32) - 1
    before = jnp.where(before < first, jnp.where(closed, last, own), before)
    after = jnp.where(after > last, jnp.where(closed, first, own), after)
    span = jnp.stack([own, before, after])
    start = jnp.stack([u_own, knots[before + 1], knots[after]])
    point, distance, u, settled = jax.vmap(partial(_in_one_span, curve, tool))(span, start)
    best = jnp.argmin(distance)
    used = jnp.sum(knots[1:] > knots[:-1], dtype=jnp.int32)
    apart = jnp.stack([before != own, (after != own) & (after != before)])
    searched = 1 + jnp.sum(apart, dtype=jnp.int32)
    here, *ends = (
        in_span(curve, i, u)[0]
        for i, u in ((own, u_own), (before, knots[before]), (after, knots[after + 1]))
    )
    reach = jnp.minimum(*(norm(end - here) for end in ends))
    reach = jnp.where(searched < used, reach, jnp.inf)
    return Nearest(
        point=point[best],
        distance=distance[best],
        arc=_lap_arc(curve, u[best]),
        reach=jnp.where(settled[best], reach, 0),
    )


def _in_one_span(
    curve: Nurbs, tool: Array, span: Array, start: Array
) -> tuple[Array, Array, Array, Array]:
    """Nearest point, distance and u within one span, from u = start; and whether it has settled."""
    ends = curve.knots[span], curve.knots[span + 1]
    u, settled = project(partial(in_span, curve, span), start, tool, ends)
    point = in_span(curve, span, u)[0]
    return point, norm(tool - point), u, settled


def _lap_arc(curve: Nurbs, u: Array) -> Array:
    """Arc length up to u, by 8 Gauss points in each span; costs nothing where it is not used."""

    def of_span(span: Array) -> Array:
        low, high = curve.knots[span], curve.knots[span + 1]
        safe = jnp.where(high > low, span, span_of(curve, low))
        speed = jax.vmap(lambda v: norm(in_span(curve, safe, v)[1]))
        return _quadrature(speed, low, jnp.clip(u, low, high))

    every = jnp.arange(degree(curve), curve.weights.shape[-1], dtype=jnp.int32)
    return jnp.sum(jax.vmap(of_span)(every))
