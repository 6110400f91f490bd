"""Stability margins, bandwidth and dynamic stiffness from frequency responses.

    gain margin    factors on L at which the loop stops being stable: 1/|L| where L is real and < 0
    phase margin   180 deg + arg L where |L| = 1, signed
    delay margin   smallest additional dead time that makes it unstable: phase margin / omega_c
    Ms, Mt         largest |S| and |T|; 1/Ms is the smallest distance of L from -1
    bandwidth      lowest frequency at which |G| has fallen to 1/sqrt 2 (-3 dB)

A margin that does not exist (no crossing) is None. Crossings and peaks are found on a grid of
frequencies and refined on the response itself, never from polynomials.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from jaxstage.frequency.linear import LinearModel

#: a response at angular frequencies: (w,) -> (w,), complex
Response = Callable[[np.ndarray], np.ndarray]

#: frequencies of the grid, beside those of the eigenvalues
POINTS = 2000
#: of half the sampling rate, the highest frequency that is looked at
NYQUIST_SHARE = 0.999
#: an eigenvalue of an integrator or of an adapted gain is 1 within rounding
ROUNDING = 1e-9
#: |L| below this everywhere: the axis does not answer
SILENT = 1e-9


class Peak(NamedTuple):
    """A value and the angular frequency in rad/s at which it stands."""

    value: float
    omega: float


class LoopMargins(NamedTuple):
    """Margins of one loop gain; None where there is no crossing.

    Attributes:
        gain_up: smallest factor > 1 on L that makes the loop unstable.
        gain_down: largest factor < 1 that does (conditionally stable loops).
        phase: smallest phase margin by magnitude, deg.
        delay: delay margin in s.
        ms: largest |S|.
        mt: largest |T|.
    """

    gain_up: Peak | None
    gain_down: Peak | None
    phase: Peak | None
    delay: float | None
    ms: Peak
    mt: Peak


def grid(model: LinearModel, low: float | None = None, high: float | None = None) -> np.ndarray:
    """Angular frequencies (w,) in rad/s that show a model: logarithmic, and dense at its poles.

    Args:
        model: the model; its poles get points within a few of their half-widths.
        low: lowest frequency in Hz; None: 1/2000 of the highest, at most 0.5 Hz.
        high: highest in Hz; None: `NYQUIST_SHARE` of half the sampling rate.

    Raises:
        ValueError: for frequencies outside 0 < low < high < half the sampling rate.
    """
    nyquist = 0.5 / float(model.dt)
    top = NYQUIST_SHARE * nyquist if high is None else high
    bottom = min(0.5, top / 2000) if low is None else low
    if not 0 < bottom < top < nyquist:
        raise ValueError(
            f"frequencies {bottom:g}..{top:g} Hz: must be 0 < from < to < {nyquist:g} Hz, half the "
            "sampling rate"
        )
    first, last = 2 * math.pi * bottom, 2 * math.pi * top
    poles = np.linalg.eigvals(np.asarray(model.a)) + 0j
    poles = np.log(poles[np.abs(poles) > 1e-12]) / float(model.dt)
    widths = np.linspace(-4, 4, 17)
    near = np.abs(poles.imag)[:, None] + np.abs(poles.real)[:, None] * widths
    points = np.concatenate([np.geomspace(first, last, POINTS), near.ravel()])
    return np.unique(points[(points >= first) & (points <= last)])


def peak(response: Response, omega: np.ndarray) -> Peak:
    """Largest |response|: on the grid, then between its neighbours."""
    size = np.abs(response(omega))
    k = int(np.argmax(size))
    low, high = omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]
    best = minimize_scalar(
        lambda w: -abs(response(np.array([w]))[0]),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-9 * high},
    )
    return max(Peak(float(size[k]), float(omega[k])), Peak(-float(best.fun), float(best.x)))


def crossings(f: Callable[[np.ndarray], np.ndarray], omega: np.ndarray) -> list[float]:
    """Where a real function of frequency changes its sign: on the grid, then by bisection."""
    values = f(omega)
    at = np.flatnonzero((values[:-1] * values[1:] < 0) | (values[:-1] == 0))

    def root(k: int) -> float:
        if values[k] == 0:
            return float(omega[k])
        found: Any = brentq(lambda w: f(np.array([w]))[0], omega[k], omega[k + 1], xtol=1e-12)
        return float(found)

    return [root(int(k)) for k in at]


def loop_margins(sensitivity: Response, omega: np.ndarray) -> LoopMargins:
    """Margins of a stable closed loop.

    Args:
        sensitivity: S; the loop gain is L = 1/S - 1.
        omega: (w,) rad/s, ascending, see `grid`.

    Returns:
        The margins.
    """

    def loop_gain(w: np.ndarray) -> np.ndarray:
        return 1 / sensitivity(w) - 1

    def at(w: float) -> complex:
        return complex(loop_gain(np.array([w]))[0])

    factors = [
        Peak(-1 / at(w).real, w)
        for w in crossings(lambda w: np.imag(loop_gain(w)), omega)
        if at(w).real < -SILENT
    ]
    up = min((p for p in factors if p.value > 1), default=None)
    down = max((p for p in factors if p.value < 1), default=None)
    unity = crossings(lambda w: np.log(np.abs(loop_gain(w)) + 1e-300), omega)
    turns = [(w, (math.degrees(np.angle(at(w))) + 180) % 360) for w in unity]
    signed = [Peak((m + 180) % 360 - 180, w) for w, m in turns]
    return LoopMargins(
        gain_up=up,
        gain_down=down,
        phase=min(signed, key=lambda p: abs(p.value), default=None),
        delay=min((math.radians(m) / w for w, m in turns), default=None),
        ms=peak(sensitivity, omega),
        mt=peak(lambda w: 1 - sensitivity(w), omega),
    )


def bandwidth(tracking: Response, omega: np.ndarray) -> float | None:
    """Lowest angular frequency in rad/s at which |G| falls to 1/sqrt 2; None: never, or always.

    A response that is below it on the whole grid is looked at down to a millionth of its lowest
    frequency.
    """

    def over(w: np.ndarray) -> np.ndarray:
        return np.abs(tracking(w)) - math.sqrt(0.5)

    below = np.geomspace(1e-6 * omega[0], omega[0], 400)
    return min(crossings(over, np.concatenate([below[:-1], omega])), default=None)


def largest_singular_value(matrix: Response, omega: np.ndarray) -> Peak:
    """Peak over frequency of the largest singular value of a matrix response (w, axes, axes)."""

    def size(w: np.ndarray) -> np.ndarray:
        return np.linalg.svd(matrix(w), compute_uv=False)[..., 0]

    return peak(size, omega)


def decibels(factor: float) -> float:
    """20 log10 of a factor."""
    return 20 * math.log10(factor)
