"""Cubic Hermite table of a stored lap, and the search window of each tick on it (host only).

The segments are uniform in arc length within each knot span, and so accurate that the distance to
them is the distance to the curve. The lap is cut into smooth pieces at its corners (tangent jump
> 1e-6 rad at a knot, closure included). A tick searches the segments of its window on its own
piece; near a corner also those on the other pieces in the window.
"""

# pyright: reportArgumentType=false
# (numpy leaves on the host, JAX arrays once cast)

from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from jaxstage.model.fields import pytree, signal
from jaxstage.references.arc import ArcTable, arc_at, moving_spans, parameter_at
from jaxstage.references.frame import host_frame
from jaxstage.references.nurbs import Nurbs, in_span, is_closed

CORNER = 1e-6  # rad
TABLE_ERROR = 1e-11  # m
MOST_SEGMENTS = 2**15


@pytree
class Segments:
    """Cubic segments r(f) = c0 + f (c1 + f (c2 + f c3)), 0 <= f <= 1."""

    cubic: Array = signal("m", "c", "c0 (its start), c1, c2, c3", shape="(segments, 4, axes)")
    arc: Array = signal("m", "s", "arc length where it starts", shape="(segments,)")
    length: Array = signal("m", "h", "its length", shape="(segments,)")


@pytree
class SearchWindows:
    """Search window of each tick on the pieces it touches, the tick's own piece first.

    Coordinates count segments from `base`.
    """

    base: Array = signal("1", "", "segment, int32", shape="(ticks, pieces)")
    start: Array = signal("1", "", "where the search starts", shape="(ticks, pieces)")
    low: Array = signal("1", "", "start of the window", shape="(ticks, pieces)")
    high: Array = signal("1", "", "end of the window", shape="(ticks, pieces)")
    corner: Array = signal("1", "", "true where the window holds a corner", shape="(ticks,)")


class LapTable(NamedTuple):
    """The segments of a lap and what they mean along it.

    Attributes:
        segments: in the order of the pieces. A lap without corners stands there three times, so
            that the search never wraps around.
        unrolled: arc length at the start of each segment, (segments,) m, rising over the closure.
        rows: first segment of each piece, and the end, (pieces + 1,).
        error: largest distance from the curve, () m.
        length: of the lap, m.
        endless: true when the lap has no corner at all.
    """

    segments: Segments
    unrolled: np.ndarray
    rows: np.ndarray
    error: np.ndarray
    length: float
    endless: bool


def _smooth_pieces(curve: Nurbs) -> tuple[list[np.ndarray], bool]:
    """The smooth pieces, each a run of span numbers, and whether the lap has no corner at all.

    Span i + spans is span i of the next lap: the last piece may run over the closure.
    """
    used = moving_spans(curve)
    out = host_frame(curve, used, curve.knots[used]).tangent
    into = np.roll(host_frame(curve, used, curve.knots[used + 1], side=-1).tangent, 1, axis=0)
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
    """Equal segments of at most ``step`` m over span number i, and their largest error in m."""
    span, (start, end) = moving_spans(curve)[i], bounds[i : i + 2]
    count = int(np.ceil((end - start) / step * (1 - 1e-12)))
    h = (end - start) / count
    u = parameter_at(curve, table, start + h * np.arange(1, count))[1]
    u = np.concatenate([curve.knots[[span]], u, curve.knots[[span + 1]]])
    where = np.full(count + 1, span)
    p, t, *_ = host_frame(curve, where, u)
    t[-1] = host_frame(curve, where[-1:], u[-1:], side=-1).tangent[0]
    d, a, b = np.diff(p, axis=0), h * t[:-1], h * t[1:]
    cubic = np.stack([p[:-1], a, 3 * d - 2 * a - b, a + b - 2 * d], axis=1)
    arc = start + h * np.arange(count)
    f = np.array([0.25, 0.5, 0.75])
    true = in_span(curve, *parameter_at(curve, table, (arc[:, None] + h * f).ravel()))[0]
    fitted = np.einsum("fk,skd->sfd", f[:, None] ** np.arange(4), cubic)
    error = np.linalg.norm(fitted.reshape(true.shape) - true, axis=-1).max()
    return Segments(cubic=cubic, arc=arc, length=np.full(count, h)), float(error)


def lap_table(curve: Nurbs, table: ArcTable) -> LapTable:
    """Hermite table of a float64 curve; the segments are halved until it is within 1e-11 m.

    Args:
        curve: in float64.
        table: its `arc_table`.
    """
    bounds = arc_at(curve, table, curve.knots[np.append(moving_spans(curve), len(curve.weights))])
    pieces, endless = _smooth_pieces(curve)
    count, length = len(bounds) - 1, bounds[-1]
    least = 4 * length / MOST_SEGMENTS
    step = max(min(length / 64, np.diff(bounds).min()), least)
    while True:
        fits = [_hermite(curve, table, i, bounds, step) for i in range(count)]
        error = max(e for _, e in fits)
        if error <= TABLE_ERROR or step <= least:
            break
        shrink = 0.9 * (TABLE_ERROR / error) ** 0.25  # the error goes with step^4
        step = max(step * min(max(shrink, 0.1), 0.7), least)
    order = np.concatenate(pieces)
    parts = [fits[i % count][0] for i in order]
    unrolled = [s.arc + length * (i // count) for i, s in zip(order, parts, strict=True)]
    rows = np.cumsum([0, *(sum(len(fits[i % count][0].arc) for i in p) for p in pieces)])
    segments = jax.tree.map(lambda *x: np.concatenate(x), *parts)
    whole = table.arc[-1]
    return LapTable(segments, np.concatenate(unrolled), rows, np.asarray(error), whole, endless)


def search_windows(lap: LapTable, arc: np.ndarray, window: float, closed: bool) -> SearchWindows:
    """Search windows of the ticks of a lap.

    Args:
        lap: its table.
        arc: arc length of each tick, (ticks,) m.
        window: arc length on either side, share of the lap.
        closed: true when the lap ends where it starts.
    """
    unrolled, rows, length = lap.unrolled, lap.rows, lap.length
    reach, snap = window * length, 1e-12 * length
    shifts = (-1, 0, 1) if closed and not lap.endless else (0,)
    piece = np.tile(np.arange(len(rows) - 1), len(shifts))
    shift = np.repeat(shifts, len(rows) - 1) * length
    begin = unrolled[rows[piece]] + shift
    own, first, last = (
        np.maximum(np.searchsorted(begin, x, side="right") - 1, 0)
        for x in (arc + snap, arc - reach + snap, arc + reach - snap)
    )
    others = first[:, None] + np.arange((last - first).max())
    others = others + (others >= own[:, None])
    others = np.where(others > last[:, None], own[:, None], others)
    seat = np.concatenate([own[:, None], others], axis=1)

    def coordinate(x: np.ndarray) -> np.ndarray:
        x = x[:, None] - shift[seat]
        row = np.searchsorted(unrolled, x + snap, side="right") - 1
        row = np.clip(row, rows[piece[seat]], rows[piece[seat] + 1] - 1)
        return row + np.clip((x - unrolled[row]) / lap.segments.length[row], 0, 1)

    start = coordinate(arc)
    base = np.minimum(np.floor(start), rows[piece[seat] + 1] - 1)
    return SearchWindows(
        base=base.astype(np.int32),
        start=start - base,
        low=coordinate(arc - reach) - base,
        high=coordinate(arc + reach) - base,
        corner=last > first,
    )
