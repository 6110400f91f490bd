"""Levenberg-Marquardt with a trust region: for few parameters.

    (H + damping I) p = -g,   |p| = radius     H = 2 sum omega dr/dz dr/dz^T (Gauss-Newton)

The Jacobian comes from forward mode. Steps of several radii are tried in one batch and the best is
taken, so that the radius finds itself without a Jacobian for each trial. In z a unit is about a
factor e of a gain, so radii of 1 to 2 are large steps.
"""

import functools
from typing import NamedTuple

import numpy as np

from tuning.tuner.method import Method, Oracle
from tuning.tuner.problem import Curvatures

#: radii that are tried together, as factors on the radius of the state
FACTORS = (2.0, 1.0, 0.4, 0.1)
#: a step must give this share of what the model promises
ENOUGH = 1e-4
#: below this radius, or promised relative gain, a start is at its end
SMALLEST_RADIUS = 1e-4
SMALLEST_GAIN = 1e-6


class LmState(NamedTuple):
    """z, gradient: (k, n); matrix: (k, n, n); value, gradient_norm, radius, done: (k,)."""

    z: np.ndarray
    value: np.ndarray
    gradient: np.ndarray
    matrix: np.ndarray
    radius: np.ndarray
    gradient_norm: np.ndarray
    done: np.ndarray


def damped_step(matrix: np.ndarray, gradient: np.ndarray, radius: float) -> np.ndarray:
    """The p of the equation above with |p| <= radius; the damping is found by bisection.

    matrix: (n, n), not indefinite; gradient: (n,).
    """
    eigen, basis = np.linalg.eigh(matrix)
    eigen = np.maximum(eigen, 0.0)
    g = basis.T @ gradient

    def step(damping: float) -> np.ndarray:
        return -g / (eigen + damping)

    floor = 1e-12 * max(float(eigen[-1]), float(np.linalg.norm(g)), 1e-300)
    low, high = floor, max(float(np.linalg.norm(g)) / radius, 2 * floor)
    if np.linalg.norm(step(low)) <= radius:
        return basis @ step(low)
    for _ in range(100):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if np.linalg.norm(step(middle)) > radius else (low, middle)
    return basis @ step(high)


def promised(matrix: np.ndarray, gradient: np.ndarray, step: np.ndarray) -> float:
    """What the quadratic model gains by a step."""
    return float(-(gradient @ step) - 0.5 * step @ matrix @ step)


def _finite(found: Curvatures) -> np.ndarray:
    """Which starts (k,) have finite derivatives."""
    numbers = np.concatenate([found.gradient[:, None], found.gauss_newton], axis=1).reshape(
        len(found.gradient), -1
    )
    return np.asarray(np.isfinite(numbers).all(axis=1))


def _begin(radius: float, oracle: Oracle, starts: np.ndarray, seed: int) -> LmState:
    rows = np.arange(len(starts))
    found = oracle.curvatures(starts, rows)
    norm = np.linalg.norm(found.gradient, axis=1)
    broken = ~_finite(found)
    return LmState(
        z=starts, value=found.objective, gradient=found.gradient, matrix=found.gauss_newton,
        radius=np.full(len(starts), radius), gradient_norm=norm, done=broken | (norm == 0),
    )  # fmt: skip


def _step(largest: float, oracle: Oracle, state: LmState) -> LmState:
    active = np.flatnonzero(~state.done)
    trials = [
        damped_step(state.matrix[k], state.gradient[k], min(factor * state.radius[k], largest))
        for k in active
        for factor in FACTORS
    ]
    steps = np.array(trials).reshape(len(active), len(FACTORS), -1)
    points = state.z[active][:, None] + steps
    values = oracle.values(
        points.reshape(-1, points.shape[-1]), np.repeat(active, len(FACTORS))
    ).reshape(len(active), len(FACTORS))
    radius, done, moved = state.radius.copy(), state.done.copy(), state.z.copy()
    for i, k in enumerate(active):
        best = int(np.argmin(values[i]))
        p = steps[i, best]
        hoped = promised(state.matrix[k], state.gradient[k], p)
        gained = state.value[k] - values[i, best]
        if gained > ENOUGH * hoped and gained > 0:
            moved[k] = points[i, best]
            length = float(np.linalg.norm(p))
            radius[k] = min(max(FACTORS[best] * radius[k], 0.5 * length), largest)
            done[k] = gained < SMALLEST_GAIN * abs(state.value[k])
        else:
            radius[k] *= FACTORS[-1] ** 1.5
            done[k] = radius[k] < SMALLEST_RADIUS or hoped < SMALLEST_GAIN * abs(state.value[k])
    return _refreshed(oracle, state._replace(radius=radius, done=done), moved)


def _refreshed(oracle: Oracle, state: LmState, moved: np.ndarray) -> LmState:
    """The state with Jacobians at the points that moved. A start whose Jacobian is not finite goes
    back and tries closer."""
    rows = np.flatnonzero(np.any(moved != state.z, axis=1))
    if not len(rows):
        return state
    found = oracle.curvatures(moved[rows], rows)
    sound = _finite(found)
    z, value = state.z.copy(), state.value.copy()
    gradient, matrix = state.gradient.copy(), state.matrix.copy()
    radius, done = state.radius.copy(), state.done.copy()
    for i, k in enumerate(rows):
        if sound[i]:
            z[k], value[k] = moved[k], found.objective[i]
            gradient[k], matrix[k] = found.gradient[i], found.gauss_newton[i]
        else:
            radius[k] *= FACTORS[-1]
            done[k] = radius[k] < SMALLEST_RADIUS
    norm = np.linalg.norm(gradient, axis=1)
    return LmState(z, value, gradient, matrix, radius, norm, done)


@functools.cache
def levenberg_marquardt(radius: float = 1.0, largest: float = 4.0) -> Method:
    """radius: of the first step, in z; largest: of any."""
    return Method(
        name="lm", needs="curvatures", begin=functools.partial(_begin, radius),
        step=functools.partial(_step, largest),
    )  # fmt: skip
