"""Arc-length parametrisation of a NURBS, to double precision (host only, numpy).

s(u) = integral of |C'|, by Gauss quadrature over cells that never cross a knot; the number of
cells is doubled until the length stands still. A cusp (C' = 0 with a reversal) belongs on a knot.
"""

import jax
import numpy as np

from jaxstage.model.fields import pytree, signal
from jaxstage.references.nurbs import Nurbs, degree, in_span

ORDER = 10
SNAP = 1e-13  # of the lap: a distance below this from a knot means the knot


@pytree
class ArcTable:
    """Arc-length table: s at the edges of the quadrature cells, along one lap."""

    u: np.ndarray = signal("1", "u", "parameter at the edges", shape="(cells + 1,)")
    arc: np.ndarray = signal("m", "s", "arc length at the edges", shape="(cells + 1,)")
    span: np.ndarray = signal("1", "i", "knot span of each cell", shape="(cells,)")


def as_double(curve: Nurbs) -> Nurbs:
    """The same curve with float64 numpy leaves."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), curve)


def spans(curve: Nurbs) -> np.ndarray:
    """Indices of the non-empty knot spans, (spans,) int32, in order."""
    index = np.arange(degree(curve), len(curve.weights), dtype=np.int32)
    return index[np.diff(curve.knots)[index] > 0]


def moving_spans(curve: Nurbs) -> np.ndarray:
    """Indices of the spans that have a length, (spans,) int32, in order.

    One whose control points are all equal, to 1e-12 of the extent of the curve, has none: two
    equal points in a row of a polyline.
    """
    used, points = spans(curve), curve.control_points
    active = points[used[:, None] + np.arange(-degree(curve), 1)]
    size = np.ptp(active, axis=1).max(axis=-1)
    return used[size > 1e-12 * np.ptp(points, axis=0).max()]


def _integral(curve: Nurbs, span: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Arc length (m,) between a and b (m,), each pair inside its span (m,)."""
    x, w = np.polynomial.legendre.leggauss(ORDER)
    u = a[:, None] + (b - a)[:, None] * (x + 1) / 2
    speed = np.linalg.norm(in_span(curve, np.broadcast_to(span[:, None], u.shape), u)[1], axis=-1)
    return speed @ w * (b - a) / 2


def arc_table(curve: Nurbs) -> ArcTable:
    """Arc-length table of a float64 curve.

    Raises:
        ValueError: when the curve has no length.
    """
    used, total = spans(curve), -1.0
    for cells in (4, 8, 16, 32, 64, 128, 256, 512, 1024):
        span = np.repeat(used, cells)
        share = np.tile(np.arange(cells) / cells, len(used))
        u = curve.knots[span] + share * (curve.knots[span + 1] - curve.knots[span])
        u = np.append(u, curve.knots[-1])
        upper = np.where(share == (cells - 1) / cells, curve.knots[span + 1], u[1:])
        arc = np.concatenate([[0.0], np.cumsum(_integral(curve, span, u[:-1], upper))])
        if abs(arc[-1] - total) <= 1e-14 * arc[-1]:
            break
        total = arc[-1]
    if not arc[-1] > 0:
        raise ValueError("the curve must have a length > 0 m; all its control points coincide")
    return ArcTable(u=u, arc=arc, span=span)


def arc_at(curve: Nurbs, table: ArcTable, u: np.ndarray) -> np.ndarray:
    """Arc length s(u).

    Args:
        curve: in float64.
        table: its `arc_table`.
        u: (m,) within the knots.

    Returns:
        (m,) m since the start of the lap.
    """
    cell = np.clip(np.searchsorted(table.u, u, side="right") - 1, 0, len(table.span) - 1)
    return table.arc[cell] + _integral(curve, table.span[cell], table.u[cell], u)


def parameter_at(curve: Nurbs, table: ArcTable, arc: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse of the arc length by safeguarded Newton; right limit at a knot.

    Args:
        curve: in float64.
        table: its `arc_table`.
        arc: (m,) m, within [0, length].

    Returns:
        Knot span and u with s(u) = arc, both (m,).
    """
    cell = np.searchsorted(table.arc, arc + SNAP * table.arc[-1], side="right") - 1
    cell = np.clip(cell, 0, len(table.span) - 1)
    span, start = table.span[cell], table.u[cell]
    low, high = start.copy(), table.u[cell + 1].copy()
    target = np.maximum(arc - table.arc[cell], 0.0)
    whole = table.arc[cell + 1] - table.arc[cell]
    u = low + np.clip(target / np.where(whole > 0, whole, 1), 0, 1) * (high - low)
    for _ in range(60):
        excess = _integral(curve, span, start, u) - target
        low, high = np.where(excess <= 0, u, low), np.where(excess >= 0, u, high)
        speed = np.linalg.norm(in_span(curve, span, u)[1], axis=-1)
        new = u - excess / np.where(speed > 0, speed, np.inf)
        new = np.where((new >= low) & (new <= high) & (speed > 0), new, (low + high) / 2)
        done = np.abs(new - u).max(initial=0.0) <= 4e-16 * np.ptp(curve.knots)
        u = new
        if done:
            break
    return span, u
