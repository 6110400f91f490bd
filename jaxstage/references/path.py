"""A lap stored in memory: the setpoint of every tick, and the curve for the contour error.

The curve is kept as cubic Hermite segments, uniform in arc length within each knot span, so
accurate that the distance to them is the distance to the curve. The lap is cut into smooth pieces
at its corners (tangent jump > 1e-6 rad at a knot, closure included). Each tick knows its seat: the
segment it lies in, and the range of the window on its piece; near a corner also on the others.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import DTypeLike

from jaxstage.blocks import Reference
from jaxstage.fields import part, pytree, signal
from jaxstage.numerics.geometry import norm, projection_step
from jaxstage.references.arc import (
    ArcTable,
    arc_at,
    arc_table,
    as_double,
    host_frame,
    parameter_at,
    spans,
)
from jaxstage.references.nurbs import Nurbs, in_span, is_closed
from jaxstage.references.timing import Ticks, Timing
from jaxstage.signals import Nearest, Setpoint

CORNER = 1e-6  # rad
TABLE_ERROR = 1e-10  # m
MOST_SEGMENTS = 2**15
STEPS = 3  # Newton steps of the nearest point: exact for errors below 1 mm on these contours
WINDOW = 0.01  # of the lap, either side


@pytree
class Segments:
    """r(f) = c0 + f (c1 + f (c2 + f c3)), 0 <= f <= 1, for each segment."""

    cubic: Array = signal("m", "c", "c0 (its start), c1, c2, c3", shape="(segments, 4, axes)")
    arc: Array = signal("m", "s", "arc length where it starts", shape="(segments,)")
    length: Array = signal("m", "h", "its length", shape="(segments,)")


@pytree
class Seats:
    """Where each tick sits. Coordinates count segments from `base`; first the tick's own piece."""

    base: Array = signal("1", "", "segment, int32", shape="(ticks, pieces)")
    start: Array = signal("1", "", "where the search starts", shape="(ticks, pieces)")
    low: Array = signal("1", "", "start of the window", shape="(ticks, pieces)")
    high: Array = signal("1", "", "end of the window", shape="(ticks, pieces)")
    corner: Array = signal("1", "", "true where the window holds a corner", shape="(ticks,)")


@pytree
class Path:
    """One lap, sampled. ``length / lap_time`` is the mean feed."""

    setpoint: Setpoint = part("commanded motion, leading axis ticks")
    segments: Segments = part("the curve")
    seats: Seats = part("where each tick sits on it")
    lap_time: Array = signal("s", "T", "duration of a lap")
    length: Array = signal("m", "L", "length of a lap", shown="mm")
    window: Array = signal("m", "", "arc length searched either side", shown="mm")
    closed: Array = signal("1", "", "true when the lap ends where it starts")
    table_error: Array = signal("m", "", "largest distance of the segments from the curve")


def make_path(
    curve: Nurbs, timing: Timing, dtype: DTypeLike | None = None, window: float = WINDOW
) -> Path:
    """Sample one lap, in double precision on the host, then cast.

    timing: from `uniform_parameter` or `constant_feed`. dtype: of the floats, JAX's default when
    left out. window: share of the lap, in arc length, searched for the nearest point on either
    side of the commanded point; in (0, 0.25], else ValueError.
    """
    if not 0 < window <= 0.25:
        raise ValueError(f"window must be in (0, 0.25] of a lap; got {window!r}")
    curve = as_double(curve)
    table = arc_table(curve)
    moments = timing(curve, table)
    bounds = arc_at(curve, table, curve.knots[np.append(spans(curve), len(curve.weights))])
    pieces, endless = _pieces(curve)
    segments, unrolled, rows, error = _segments(curve, table, bounds, pieces)
    shifts = (-1, 0, 1) if is_closed(curve) and not endless else (0,)
    seats = _seats(segments, unrolled, rows, moments.arc, table.arc[-1], window, shifts)
    path = Path(
        setpoint=_setpoints(curve, moments), segments=segments,
        seats=seats, lap_time=moments.lap_time,
        length=table.arc[-1], window=np.asarray(window * table.arc[-1]),
        closed=np.asarray(is_closed(curve)), table_error=error,
    )  # fmt: skip
    real = jnp.zeros(()).dtype if dtype is None else np.dtype(dtype)
    return jax.tree.map(
        lambda x: jnp.asarray(x, real if np.issubdtype(x.dtype, np.floating) else x.dtype), path
    )


def mean_feed(path: Path) -> Array:
    """Length over lap time in m/s: the actual feed of `constant_feed`."""
    return path.length / path.lap_time


def _setpoints(curve: Nurbs, moments: Ticks) -> Setpoint:
    """r' = C' u', r'' = C'' u'^2 + C' u''."""
    _, first, second = in_span(curve, moments.span, moments.u)
    position, tangent, curvature = host_frame(curve, moments.span, moments.u)
    rate = moments.rate[:, None]
    return Setpoint(
        position=position, velocity=first * rate, tangent=tangent, curvature=curvature,
        acceleration=second * rate**2 + first * moments.acceleration[:, None],
    )  # fmt: skip


def _pieces(curve: Nurbs) -> tuple[list[np.ndarray], bool]:
    """The smooth pieces, each a run of span numbers, and whether the lap has no corner at all.

    Span i + spans is span i of the next lap: the last piece may run over the closure.
    """
    used = spans(curve)
    _, out, _ = host_frame(curve, used, curve.knots[used])
    _, into, _ = host_frame(curve, used, curve.knots[used + 1], side=-1)
    into = np.roll(into, 1, axis=0)
    apart, along = (np.linalg.norm(out + sign * into, axis=-1) for sign in (-1, 1))
    corner = 2 * np.arctan2(apart, along) > CORNER
    corner[0] |= not is_closed(curve)
    if not corner.any():
        return [np.arange(-len(used), 2 * len(used))], True
    starts = np.flatnonzero(corner)
    ends = np.append(starts[1:], starts[0] + len(used))
    return [np.arange(a, b) for a, b in zip(starts, ends, strict=True)], False


def _hermite(
    curve: Nurbs, table: ArcTable, i: int, bounds: np.ndarray, step: float
) -> tuple[Segments, float]:
    """Equal segments of at most ``step`` m over span number i, and their largest error."""
    span, (start, end) = spans(curve)[i], bounds[i : i + 2]
    count = int(np.ceil((end - start) / step * (1 - 1e-12)))
    h = (end - start) / count
    u = parameter_at(curve, table, start + h * np.arange(1, count))[1]
    u = np.concatenate([curve.knots[[span]], u, curve.knots[[span + 1]]])
    where = np.full(count + 1, span)
    p, t, _ = host_frame(curve, where, u)
    t[-1] = host_frame(curve, where[-1:], u[-1:], side=-1)[1][0]
    d, a, b = np.diff(p, axis=0), h * t[:-1], h * t[1:]
    cubic = np.stack([p[:-1], a, 3 * d - 2 * a - b, a + b - 2 * d], axis=1)
    arc = start + h * np.arange(count)
    f = np.array([0.25, 0.5, 0.75])
    true = in_span(curve, *parameter_at(curve, table, (arc[:, None] + h * f).ravel()))[0]
    made = np.einsum("fk,skd->sfd", f[:, None] ** np.arange(4), cubic)
    error = np.linalg.norm(made.reshape(true.shape) - true, axis=-1).max()
    made = Segments(cubic=cubic, arc=arc, length=np.full(count, h))  # type: ignore[arg-type]
    return made, float(error)


def _segments(
    curve: Nurbs, table: ArcTable, bounds: np.ndarray, pieces: list[np.ndarray]
) -> tuple[Segments, np.ndarray, np.ndarray, np.ndarray]:
    """The table, its arc lengths unrolled, the first row of each piece (and the end), the error.

    A lap without corners stands there three times, so that the search never wraps around.
    """
    spans_, length = len(bounds) - 1, bounds[-1]
    least = 4 * length / MOST_SEGMENTS
    step = max(min(length / 64, np.diff(bounds).min()), least)
    while True:
        made = [_hermite(curve, table, i, bounds, step) for i in range(spans_)]
        error = max(e for _, e in made)
        if error <= TABLE_ERROR or step / 2 < least:
            break
        step /= 2
    order = np.concatenate(pieces)
    parts = [made[i % spans_][0] for i in order]
    unrolled = [s.arc + length * (i // spans_) for i, s in zip(order, parts, strict=True)]
    rows = np.cumsum([0, *(sum(len(made[i % spans_][0].arc) for i in p) for p in pieces)])
    table_of = jax.tree.map(lambda *x: np.concatenate(x), *parts)
    return table_of, np.concatenate(unrolled), rows, np.asarray(error)


def _seats(
    segments: Segments, unrolled: np.ndarray, rows: np.ndarray, arc: np.ndarray, length: float,
    window: float, shifts: tuple[int, ...],
) -> Seats:  # fmt: skip
    """The seats of ticks at arc length ``arc`` (ticks,); ``shifts``: the laps looked at."""
    reach, snap = window * length, 1e-12 * length
    piece = np.tile(np.arange(len(rows) - 1), len(shifts))
    lap = np.repeat(shifts, len(rows) - 1) * length
    begin = unrolled[rows[piece]] + lap
    own, first, last = (
        np.maximum(np.searchsorted(begin, x, side="right") - 1, 0)
        for x in (arc + snap, arc - reach + snap, arc + reach - snap)
    )
    others = first[:, None] + np.arange((last - first).max())
    others = others + (others >= own[:, None])
    others = np.where(others > last[:, None], own[:, None], others)
    seat = np.concatenate([own[:, None], others], axis=1)

    def coordinate(x: np.ndarray) -> np.ndarray:
        x = x[:, None] - lap[seat]
        row = np.searchsorted(unrolled, x + snap, side="right") - 1
        row = np.clip(row, rows[piece[seat]], rows[piece[seat] + 1] - 1)
        return row + np.clip((x - unrolled[row]) / segments.length[row], 0, 1)

    start = coordinate(arc)
    base = np.minimum(np.floor(start), rows[piece[seat] + 1] - 1)
    return Seats(
        base=base.astype(np.int32), start=start - base, low=coordinate(arc - reach) - base,
        high=coordinate(arc + reach) - base, corner=last > first,
    )  # fmt: skip


def sample(path: Path, tick: Array) -> Setpoint:
    """The setpoint of tick mod n. tick: () integer."""
    row = tick % path.seats.corner.shape[0]
    return jax.tree.map(lambda x: _row(x, row), path.setpoint)


def nearest(path: Path, tick: Array, position: Array) -> Nearest:
    """The nearest point of the curve within the window around the commanded point of a tick.

    By `STEPS` Newton steps along the smooth piece of the tick, and of each piece that begins in
    the window. Differentiable in ``position`` (axes,) m, with gradient 0 at distance 0. Valid
    for errors up to about half the smallest radius of curvature. tick: () integer.
    """
    row = tick % path.seats.corner.shape[0]
    base, start, low, high = (
        _row(x, row)
        for x in (path.seats.base, path.seats.start, path.seats.low, path.seats.high)
    )

    def of(i: int) -> Nearest:
        return _on_piece(path.segments, base[i], start[i], low[i], high[i], position)

    def of_all() -> Nearest:
        best = of(0)
        for i in range(1, base.shape[0]):
            best = _closer(best, of(i))
        return best

    if base.shape[0] == 1:
        return of(0)
    return jax.lax.cond(_row(path.seats.corner, row), of_all, lambda: of(0))


def _row(x: Array, row: Array) -> Array:
    return jax.lax.dynamic_index_in_dim(x, row, keepdims=False, allow_negative_indices=False)


def _closer(a: Nearest, b: Nearest) -> Nearest:
    return jax.tree.map(lambda x, y: jnp.where(b.distance < a.distance, y, x), a, b)


def _on_piece(
    segments: Segments, base: Array, start: Array, low: Array, high: Array, position: Array
) -> Nearest:
    """Newton in the coordinate y, clamped to [low, high]; the last step carries the gradient.

    Offsets are taken from the start of the segment, so single precision loses nothing.
    """
    floor, top = jnp.floor(low), jnp.ceil(high) - 1

    def segment(y: Array) -> tuple[Array, Array]:
        whole = jnp.clip(jnp.floor(y), floor, top)
        return base + whole.astype(jnp.int32), whole

    y = start
    for last in [False] * (STEPS - 1) + [True]:
        index, whole = segment(y)
        c = segments.cubic.at[index].get(mode="clip")
        f = y - whole
        offset = (position - c[0]) - f * (c[1] + f * (c[2] + f * c[3]))
        first = c[1] + f * (2 * c[2] + 3 * f * c[3])
        new = y + projection_step(offset, first, 2 * c[2] + 6 * f * c[3])
        y = jnp.clip(new, low, high)
        if not last:
            y = jax.lax.stop_gradient(y)
    f = y - whole
    along = f * (c[1] + f * (c[2] + f * c[3]))
    return Nearest(
        point=c[0] + along,
        distance=norm((position - c[0]) - along),
        arc=segments.arc.at[index].get(mode="clip") + f * segments.length.at[index].get(mode="clip"),
    )


sampled = Reference(name="sampled", sample=sample, nearest=nearest)
