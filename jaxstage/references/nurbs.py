"""Rational B-splines (NURBS): C(u) = sum N_i(u) w_i V_i / sum N_i(u) w_i.

The degree follows from the shapes, so a `Nurbs` holds arrays only. Basis functions of degree 0
are half open [u_i, u_i+1), the last non-empty span is closed: at a knot the right limit.

Source: Piegl and Tiller, The NURBS Book, 2nd ed., algorithm A2.2 and eqs (3.8), (4.1).
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike

from jaxstage.model.fields import param, pytree


@pytree
class Nurbs:
    """A clamped rational B-spline curve of degree len(knots) - len(weights) - 1."""

    control_points: Array = param("m", "V", "control points", shape="(points, axes)")
    weights: Array = param("1", "w", "weights", shape="(points,)", above=0.0)
    knots: Array = param("1", "U", "knots, not decreasing", shape="(points + degree + 1,)")


def nurbs(
    control_points: ArrayLike, knots: ArrayLike, weights: ArrayLike | None = None, degree: int = 2
) -> Nurbs:
    """A checked curve with float64 numpy leaves (host only).

    Args:
        control_points: V, (points, axes) m.
        knots: U, (points + degree + 1,), clamped.
        weights: w, (points,), > 0; all 1 when left out.
        degree: >= 1.

    Raises:
        ValueError: on wrong counts, decreasing knots, unclamped ends, an interior multiplicity
            above the degree, a weight <= 0, NaN or infinity.
    """
    points = np.asarray(control_points, dtype=np.float64)
    if points.ndim != 2 or points.size == 0:
        raise ValueError(
            f"control_points must have shape (points, axes), both >= 1; got {points.shape}"
        )
    if isinstance(degree, bool) or not isinstance(degree, int | np.integer) or degree < 1:
        raise ValueError(f"degree must be an integer >= 1; got {degree!r}")
    count = len(points)
    if count < degree + 1:
        raise ValueError(f"degree {degree} needs at least {degree + 1} control points; got {count}")
    if not np.isfinite(points).all():
        raise ValueError("control_points must be finite (m)")
    weight = np.ones(count) if weights is None else np.asarray(weights, dtype=np.float64)
    _check_weights(weight, count)
    knot = np.asarray(knots, dtype=np.float64)
    _check_knots(knot, count, int(degree))
    return Nurbs(control_points=points, weights=weight, knots=knot)  # type: ignore[arg-type]


def _check_weights(weights: np.ndarray, count: int) -> None:
    if weights.shape != (count,):
        raise ValueError(
            f"{count} control points need {count} weights, shape ({count},); "
            f"got shape {weights.shape}"
        )
    if not np.isfinite(weights).all():
        raise ValueError("weights must be finite and > 0")
    if (weights <= 0).any():
        index = int(np.argmax(weights <= 0))
        raise ValueError(f"weights must be > 0; weight {index} is {weights[index]:g}")


def _check_knots(knots: np.ndarray, count: int, degree: int) -> None:
    expected = count + degree + 1
    if knots.shape != (expected,):
        raise ValueError(
            f"{count} control points of degree {degree} need {expected} knots, shape "
            f"({expected},); got shape {knots.shape}"
        )
    if not np.isfinite(knots).all():
        raise ValueError("knots must be finite")
    if (np.diff(knots) < 0).any():
        index = int(np.argmax(np.diff(knots) < 0))
        raise ValueError(
            f"knots must not decrease; knot {index + 1} ({knots[index + 1]:g}) is below "
            f"knot {index} ({knots[index]:g})"
        )
    if np.ptp(knots[: degree + 1]) > 0 or np.ptp(knots[count:]) > 0:
        raise ValueError(
            f"knots must be clamped: the first {degree + 1} equal and the last {degree + 1} equal"
        )
    values, times = np.unique(knots, return_counts=True)
    if len(values) < 2:
        raise ValueError("knots must span an interval: last knot > first knot")
    if times[0] > degree + 1 or times[-1] > degree + 1:
        raise ValueError(f"an end knot must appear exactly degree + 1 = {degree + 1} times")
    if (times[1:-1] > degree).any():
        worst = 1 + int(np.argmax(times[1:-1]))
        raise ValueError(
            f"an interior knot may appear at most degree = {degree} times; knot "
            f"{values[worst]:g} appears {times[worst]} times"
        )


def degree(curve: Nurbs) -> int:
    """The degree, from the shapes: len(knots) - len(weights) - 1."""
    return curve.knots.shape[-1] - curve.weights.shape[-1] - 1


def is_closed(curve: Nurbs) -> bool:
    """True when C(0) = C(1) to 1e-9 of the curve's extent (host only)."""
    points = np.asarray(curve.control_points)
    return bool(np.abs(points[-1] - points[0]).max() <= 1e-9 * np.ptp(points, axis=0).max())


def evaluate(curve: Nurbs, u: Array | float) -> Array:
    """Point C(u), (axes,) m. u: () within [u_0, u_end]; beyond it the end span goes on."""
    return derivatives(curve, u)[0]


def derivatives(curve: Nurbs, u: Array | float) -> tuple[Array, Array, Array]:
    """Point and derivatives C(u), C'(u), C''(u): the right limit at a knot.

    Args:
        curve: of any float type.
        u: () within [u_0, u_end]; beyond it the polynomial of the end span goes on (a pure function
            cannot refuse; `points` does).

    Returns:
        C, C', C'', each (axes,) m.
    """
    curve = jax.tree.map(jnp.asarray, curve)
    u = jnp.asarray(u, curve.knots.dtype)
    return in_span(curve, span_of(curve, u), u)


def points(curve: Nurbs, u: ArrayLike) -> np.ndarray:
    """Points C(u) in float64, (..., axes) m (host only).

    Args:
        curve: of any float type.
        u: (...).

    Raises:
        ValueError: for u outside [u_0, u_end].
    """
    curve = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), curve)
    u = np.asarray(u, np.float64)
    first, last = curve.knots[0], curve.knots[-1]
    if not ((u >= first) & (u <= last)).all():
        raise ValueError(f"u must lie in [{first:g}, {last:g}]")
    return in_span(curve, span_of(curve, u), u)[0]


def span_of(curve: Nurbs, u: Any, slack: Any = 0.0) -> Any:
    """Knot span of a parameter: i with u_i <= u + slack < u_i+1.

    Args:
        curve: its leaves numpy or JAX arrays, as u is.
        u: (...).
        slack: in units of u; a few roundings, so that k/n lands on the knot it means.

    Returns:
        i, int32 (...).
    """
    below = curve.knots <= u[..., None] + slack
    return (below.sum(axis=-1, dtype=np.int32) - 1).clip(degree(curve), curve.weights.shape[-1] - 1)


def in_span(curve: Nurbs, span: Any, u: Any) -> tuple[Any, Any, Any]:
    """Point and derivatives of the rational piece of one span, eq (4.8) of order 2.

    Only the degree + 1 active points enter. At the upper end of the span: the left limit.

    Args:
        curve: its leaves numpy or JAX arrays, as u is.
        span: int32 (...), non-empty.
        u: (...).

    Returns:
        C, C', C'', each (..., axes) m.
    """
    order = degree(curve)
    near = span[..., None] + np.arange(1 - order, order + 1, dtype=np.int32)
    active = span[..., None] + np.arange(-order, 1, dtype=np.int32)
    knots, weights = curve.knots[near], curve.weights[active][..., None]
    rows = _basis(knots, u, order)
    top = _polynomial(knots, weights * curve.control_points[active], rows)
    low = _polynomial(knots, weights, rows)
    value = top[0] / low[0]
    first = (top[1] - low[1] * value) / low[0]
    second = (top[2] - 2 * low[1] * first - low[2] * value) / low[0]
    return value, first, second


def taylor(curve: Nurbs, span: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Taylor coefficients of w (C - V) and of w at the start of spans (host only).

    In powers of the share y of the span, 0 <= y <= 1; V is the first active control point.

    Args:
        curve: in float64.
        span: int32 (m,), non-empty.

    Returns:
        Numerator (m, degree + 1, axes) m, denominator (m, degree + 1, 1).
    """
    order = degree(curve)
    knots = curve.knots[span[:, None] + np.arange(1 - order, order + 1)]
    active = span[:, None] + np.arange(-order, 1)
    weights, control = curve.weights[active][..., None], curve.control_points[active]
    rows = _basis(knots, knots[:, order - 1], order)
    width = knots[:, order] - knots[:, order - 1]
    power = np.arange(order + 1)[:, None]
    factorial = np.cumprod(np.maximum(power, 1), axis=0)
    scale = (width[:, None, None] ** power) / factorial

    def scaled(control: Any) -> np.ndarray:
        return np.stack(_polynomial(knots, control, rows, order + 1), axis=1) * scale

    return scaled(weights * (control - control[:, :1])), scaled(weights)


def _basis(knots: Any, u: Any, order: int) -> list[list[Any]]:
    """Non-zero basis functions of degree 0 ... order (A2.2). knots: (..., 2 order)."""
    rows = [[u * 0 + 1]]
    for q in range(1, order + 1):
        row, saved = [], u * 0
        for r in range(q):
            right, left = knots[..., order + r], knots[..., order - q + r]
            share = rows[-1][r] / (right - left)
            row.append(saved + (right - u) * share)
            saved = (u - left) * share
        rows.append([*row, saved])
    return rows


def _polynomial(knots: Any, control: Any, rows: list[list[Any]], count: int = 3) -> list[Any]:
    """Value and derivatives, ``count`` in all. control: (..., order + 1, m); eq (3.8)."""
    order = len(rows) - 1
    out = []
    for k in range(count):
        if k > order:
            out.append(out[0] * 0)
            continue
        left = order - k + 1
        if k > 0:
            wide = knots[..., order : order + left] - knots[..., k - 1 : k - 1 + left]
            control = left * (control[..., 1:, :] - control[..., :-1, :]) / wide[..., None]
        out.append(sum(n[..., None] * control[..., j, :] for j, n in enumerate(rows[order - k])))
    return out
