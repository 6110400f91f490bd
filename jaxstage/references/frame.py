"""Frenet frame of a NURBS, to double precision (host only, numpy), also where C' = 0.

C' = N/Q^2 with N = P'Q - PQ', for C = P/Q on a span. Near a zero of C' of order q, w from it,
N = w^q M with M(0) != 0, and the powers of w are cancelled in the coefficients:

    t = sign(w)^q M/|M|,   kappa n = Q^2 (M' M^T - M M'^T) M / (w^q |M|^4).

Where N starts with coefficients along one line, as for a doubled end point of a straight line, so
does M' M^T - M M'^T start with zeros, and kappa has a limit. If not, kappa grows without limit
towards the zero, and is 0 on it.
"""

import math
from typing import NamedTuple

import numpy as np

from jaxstage.references.arc import SNAP
from jaxstage.references.nurbs import Nurbs, degree, in_span, taylor

NEAR = 1e-2  # |C'|, of the extent of a span over its width: below, zeros of C' are looked for
ZERO = 1e-10  # of the largest coefficient: below, a coefficient is a rounding of 0
NEWTON = 8  # steps to the zero


class Frame(NamedTuple):
    """Frame of a curve at m places.

    Attributes:
        point: C, (m, axes) m.
        tangent: t, unit, in the direction of travel, (m, axes).
        bend: kappa n = d2C/ds2, (m, axes) 1/m.
        near_zero: true near a zero of C', (m,).
    """

    point: np.ndarray
    tangent: np.ndarray
    bend: np.ndarray
    near_zero: np.ndarray

    @property
    def curvature(self) -> np.ndarray:
        """kappa, (m,) 1/m >= 0."""
        return np.linalg.norm(self.bend, axis=-1)


def host_frame(curve: Nurbs, span: np.ndarray, u: np.ndarray, side: int = 1) -> Frame:
    """Frame of a float64 curve.

    Args:
        curve: in float64.
        span: (m,), spans that have a length.
        u: (m,), each in its span.
        side: the limit on a zero of C': 1 right, -1 left.
    """
    point, first, second = in_span(curve, span, u)
    active = curve.control_points[span[:, None] + np.arange(-degree(curve), 1)]
    width = curve.knots[span + 1] - curve.knots[span]
    slow = np.linalg.norm(first, axis=-1) * width < NEAR * np.ptp(active, axis=1).max(axis=-1)
    v = np.where((first == 0).all(axis=-1, keepdims=True), 1.0, first)
    square = (v * v).sum(axis=-1, keepdims=True)
    bend = (second - (second * v).sum(axis=-1, keepdims=True) / square * v) / square
    tangent = v / np.linalg.norm(v, axis=-1, keepdims=True)
    near_zero = np.zeros(len(u), bool)
    if slow.any():
        share = (u[slow] - curve.knots[span[slow]]) / width[slow]
        which, *limits = _near_zeros(curve, span[slow], share, side)
        near_zero[slow] = which
        tangent[near_zero], bend[near_zero] = limits
    return Frame(point, tangent, bend, near_zero)


def _near_zeros(
    curve: Nurbs, span: np.ndarray, share: np.ndarray, side: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which places (m,) lie near a zero of C' of their span; tangent and kappa n of those."""
    (top, low), size = taylor(curve, span), np.ptp(curve.control_points, axis=0).max()
    hodograph = _hodograph(top, low)
    scale = np.abs(hodograph).max(axis=(1, 2))
    near_zero = np.zeros(len(span), bool)
    tangent, bend = np.zeros((2, len(span), top.shape[-1]))
    for order in range(hodograph.shape[1] - 1, 0, -1):
        rest = np.flatnonzero(~near_zero)
        zero = _zero(hodograph[rest], order, share[rest])
        at = _shifted(hodograph[rest], zero)
        large = np.abs(at).max(axis=-1) > ZERO * scale[rest, None]
        true = ~large[:, :order].any(axis=1) & large[:, order] & (np.abs(zero - 0.5) < 0.5 + ZERO)
        chosen, w = rest[true], (share[rest] - zero)[true]
        quotient = _value(low[chosen], share[chosen])
        factor = at[true, order:]
        start = np.linalg.norm(factor[:, 0], axis=-1) / quotient[:, 0] ** 2
        w = np.where(start * np.abs(w) ** (order + 1) < SNAP * size, 0.0, w)  # its arc length
        near_zero[chosen] = True
        tangent[chosen], bend[chosen] = _limit(factor, order, w, quotient, side)
    return near_zero, tangent[near_zero], bend[near_zero]


def _hodograph(top: np.ndarray, low: np.ndarray) -> np.ndarray:
    """Coefficients of N = P'Q - PQ', (m, 2 degree - 1, axes)."""
    n = top.shape[1]
    out = np.zeros((len(top), max(2 * n - 3, 1), top.shape[-1]))
    for i in range(n):
        for j in range(n):
            if i != j:
                out[:, i + j - 1] += (i - j) * top[:, i] * low[:, j]
    return out


def _shifted(coefficients: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Taylor coefficients at y (m,) of polynomials (m, n, axes) given by those at 0."""
    k = range(coefficients.shape[1])
    binomial = np.array([[math.comb(b, a) for b in k] for a in k], float)
    power = np.maximum(np.subtract.outer(k, k).T, 0)
    return binomial * y[:, None, None] ** power @ coefficients


def _value(coefficients: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Polynomials (m, n, axes) at y (m,): (m, axes)."""
    return ((y[:, None] ** np.arange(coefficients.shape[1]))[..., None] * coefficients).sum(axis=1)


def _zero(hodograph: np.ndarray, order: int, y: np.ndarray) -> np.ndarray:
    """Zero of order ``order`` of N near y (m,): the simple one of its derivative before, by Newton
    in least squares over the axes."""
    for _ in range(NEWTON):
        at = _shifted(hodograph, y)
        value, slope = at[:, order - 1], order * at[:, order]
        square = (slope * slope).sum(axis=-1)
        step = (value * slope).sum(axis=-1) / np.where(square > 0, square, np.inf)
        y = np.clip(y - step, -1.0, 2.0)
    return y


def _limit(
    factor: np.ndarray, order: int, w: np.ndarray, quotient: np.ndarray, side: int
) -> tuple[np.ndarray, np.ndarray]:
    """Tangent and kappa n at a distance w (m,) from a zero of order q, from M (m, n, axes)."""
    n, on = factor.shape[1], w == 0
    value = _value(factor, w)
    size = np.linalg.norm(value, axis=-1, keepdims=True)
    sign = np.where(on, side, np.sign(w)) ** order
    wedge = np.zeros((len(w), max(2 * n - 2, order + 1), factor.shape[-1], factor.shape[-1]))
    for i in range(n):
        for j in range(1, n):
            outer = factor[:, j, :, None] * factor[:, i, None, :]
            wedge[:, i + j - 1] += j * (outer - outer.swapaxes(-1, -2))
    least = ZERO * np.abs(factor).max(axis=(1, 2)) ** 2
    falling = np.arange(wedge.shape[1]) < order  # over a positive power of w
    dropped = np.abs(wedge).max(axis=(2, 3)) <= least[:, None]
    power = np.arange(wedge.shape[1]) - order
    y = np.where(on[:, None] & falling, 1.0, w[:, None]) ** power
    y = np.where(falling & dropped, 0.0, y)
    endless = on & (falling & ~dropped).any(axis=1)
    turn = (y[:, :, None, None] * wedge).sum(axis=1) @ value[..., None]
    bend = quotient**2 * turn[..., 0] / size**4
    return sign[:, None] * value / size, np.where(endless[:, None], 0.0, bend)
