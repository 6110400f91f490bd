"""Feed-rate timing of a lap: u(t), u'(t), u''(t) on integer ticks (host only).

The phase k/n is computed in double from integers, before any cast; a tick within a few roundings
of a knot is put on it, and takes the right limit there.
"""

import functools
from collections.abc import Callable

import numpy as np

from jaxstage.model.fields import pytree, signal
from jaxstage.references.arc import ArcTable, arc_at, arc_table, as_double, parameter_at
from jaxstage.references.checked import positive
from jaxstage.references.nurbs import Nurbs, in_span, span_of
from jaxstage.system.memory import memory_bytes

#: bytes a tick that making a lap takes at its peak, measured
TICK_BYTES = 2800
#: ticks are counted in 32 bits
MOST_TICKS = 2**31 - 1


@pytree
class Ticks:
    """Interpolated lap on integer ticks, float64 numpy."""

    span: np.ndarray = signal("1", "i", "knot span", shape="(ticks,)")
    u: np.ndarray = signal("1", "u", "curve parameter", shape="(ticks,)")
    rate: np.ndarray = signal("1/s", "u'", "du/dt", shape="(ticks,)")
    acceleration: np.ndarray = signal("1/s2", "u''", "d2u/dt2", shape="(ticks,)")
    arc: np.ndarray = signal("m", "s", "arc length since the start of the lap", shape="(ticks,)")
    lap_time: np.ndarray = signal("s", "T", "duration of the lap, a whole number of ticks")
    feed: np.ndarray = signal("m/s", "v", "ds/dt where it is the same at every tick, or else NaN")


#: turns a float64 curve and its arc table into the ticks of one lap
LapTiming = Callable[[Nurbs, ArcTable], Ticks]


def uniform_parameter(lap_time: float, dt: float) -> LapTiming:
    """Uniform-parameter timing.

    u_k = u_0 + (u_end - u_0) (k mod n)/n, u' = (u_end - u_0)/(n dt), n = round(T/dt).
    Source: Mao et al., Energies 2021, 14, 7802, eqs (32)-(34).

    Args:
        lap_time: T, s, >= dt.
        dt: control period in s.

    Raises:
        ValueError: unless both are finite and > 0 and T >= dt.
    """
    return _uniform_parameter(float(lap_time), float(dt))


@functools.cache
def _uniform_parameter(lap_time: float, dt: float) -> LapTiming:
    positive("lap_time", lap_time, "s")
    positive("dt", dt, "s")
    if lap_time < dt:
        raise ValueError(f"lap_time must be >= dt = {dt:g} s; got {lap_time:g} s")
    count = _tick_count(lap_time / dt, f"lap_time = {lap_time:g} s", dt)

    def timing(curve: Nurbs, table: ArcTable) -> Ticks:
        whole = np.ptp(curve.knots)
        u = curve.knots[0] + whole * (np.arange(count) / count)
        span = span_of(curve, u, slack=8 * np.finfo(float).eps * np.abs(curve.knots).max())
        u = np.maximum(u, curve.knots[span])
        rate = np.full(count, whole / (count * dt))
        return Ticks(
            span=span,
            u=u,
            rate=rate,
            acceleration=np.zeros(count),
            arc=arc_at(curve, table, u),
            lap_time=np.asarray(count * dt),
            feed=np.asarray(np.nan),
        )

    return timing


def constant_feed(feed: float, dt: float) -> LapTiming:
    """Constant-feed timing.

    s_k = L (k mod n)/n, u' = v/|C'|, u'' = -v^2 (C' . C'')/|C'|^4, n = round(L/(feed dt)).
    Where C' = 0, u' is infinite: here it is that of a place just inside the span, and the lap takes
    velocity and acceleration from the arc length, r' = v t and r'' = v^2 kappa n.

    Args:
        feed: mm/min, adjusted to v = L/(n dt) so that the lap is a whole number of ticks (see
            `path.mean_feed`).
        dt: control period in s.

    Raises:
        ValueError: unless both are finite and > 0; when the timing is applied, for a lap of under 2
            ticks.
    """
    return _constant_feed(float(feed), float(dt))


def _tick_count(periods: float, setting: str, dt: float) -> int:
    """The whole number of ticks of a lap of so many periods.

    Raises:
        ValueError: for a lap that does not fit into the memory while it is made.
    """
    half = memory_bytes() / 2
    most = min(half / TICK_BYTES, MOST_TICKS)
    if periods > most:
        raise ValueError(
            f"{setting} gives a lap of {periods * dt:.4g} s at dt = {dt:g} s, "
            f"{periods * TICK_BYTES / 1e9:.3g} GB while it is made, half the memory here is "
            f"{half / 1e9:.3g} GB: must be <= {most * dt:.4g} s at this dt"
        )
    return round(periods)


@functools.cache
def _constant_feed(feed: float, dt: float) -> LapTiming:
    positive("feed", feed, "mm/min")
    positive("dt", dt, "s")

    def timing(curve: Nurbs, table: ArcTable) -> Ticks:
        length = table.arc[-1]
        with np.errstate(divide="ignore", over="ignore"):
            periods = length / (feed / 6e4 * dt)
        count = _tick_count(periods, f"feed = {feed:g} mm/min", dt)
        if count < 2:
            limit = length / (2 * dt) * 6e4
            raise ValueError(f"feed must be <= {limit:g} mm/min: a lap needs 2 ticks; got {feed:g}")
        arc = length * (np.arange(count) / count)
        span, u = parameter_at(curve, table, arc)
        still = np.linalg.norm(in_span(curve, span, u)[1], axis=-1) <= 1e-9 * length
        inside = u + np.where(still, 1e-6, 0.0) * (curve.knots[span + 1] - u)
        _, first, second = in_span(curve, span, inside)
        square, speed = (first * first).sum(axis=-1), length / (count * dt)
        return Ticks(
            span=span,
            u=u,
            rate=speed / np.sqrt(square),
            acceleration=-(speed**2) * (first * second).sum(axis=-1) / square**2,
            arc=arc,
            lap_time=np.asarray(count * dt),
            feed=np.asarray(speed),
        )

    return timing


def ticks(curve: Nurbs, timing: LapTiming) -> Ticks:
    """The ticks of one lap of a curve."""
    curve = as_double(curve)
    return timing(curve, arc_table(curve))
