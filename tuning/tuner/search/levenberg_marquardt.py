"""Levenberg-Marquardt with a trust region: for few parameters.

    (H + damping I) p = -g,   |p| <= radius     H = 2 sum omega dr/dz dr/dz^T (Gauss-Newton)

The Jacobian comes from forward mode. Where the residuals stay large, as an error that no gain can
remove, their own curvature S is missing in H. It is learned from the gradients along the way, as in
NL2SOL, so that (H + S) moved = change of g, and steps of both models, of several radii each, are
tried in one batch: radius and model find themselves without a Jacobian for each trial. In z a unit
is about a factor e of a gain, so radii of 1 to 2 are large steps.
Source: Dennis, Gay, Welsch, ACM Trans. Math. Softw. 7 (1981), 348-368, for S.
"""

import functools
from typing import NamedTuple

import numpy as np

from tuning.tuner.problem.problem import GaussNewtonModel
from tuning.tuner.search.cost_model import CostModel
from tuning.tuner.search.method import Method, Oracle

#: radii that are tried together, as factors on the radius of the state
FACTORS = (2.0, 1.0, 0.3)
#: what is left of the radius when no trial helps
SHRINK = 0.05
#: a step must give this share of what the model promises
ENOUGH = 1e-4
#: below this radius, or promised relative gain, a start is at its end
SMALLEST_RADIUS = 1e-4
SMALLEST_GAIN = 1e-6


class LmState(NamedTuple):
    """z, gradient: (k, n); matrix, residual: H and S (k, n, n); value, gradient_norm, radius, done:
    (k,)."""

    z: np.ndarray
    value: np.ndarray
    gradient: np.ndarray
    matrix: np.ndarray
    residual: np.ndarray
    radius: np.ndarray
    gradient_norm: np.ndarray
    done: np.ndarray


def damped_step(matrix: np.ndarray, gradient: np.ndarray, radius: float) -> np.ndarray:
    """The p of the equation above with |p| <= radius; the damping is found by bisection.

    matrix: (n, n) symmetric; where it is indefinite the damping makes up for it. gradient: (n,).
    """
    eigen, basis = np.linalg.eigh(matrix)
    g = basis.T @ gradient
    size = float(np.linalg.norm(g))
    floor = 1e-12 * max(float(np.max(np.abs(eigen))), size, 1e-300)
    least = max(-float(eigen[0]), 0.0) + floor

    def step(damping: float) -> np.ndarray:
        return -g / (eigen + damping)

    if np.linalg.norm(step(least)) <= radius:
        return basis @ step(least)
    low, high = floor, size / radius + floor
    for _ in range(100):
        middle = np.sqrt(low * high)
        long = np.linalg.norm(step(least + middle)) > radius
        low, high = (middle, high) if long else (low, middle)
    return basis @ step(least + high)


def learned(
    residual: np.ndarray, matrix: np.ndarray, moved: np.ndarray, change: np.ndarray
) -> np.ndarray:
    """S after a step: (matrix + S) moved = change, else as near to the sized S before as can be.

    residual: S before; matrix: H after the step; change: of the gradient.
    """
    along = change - matrix @ moved
    slope = float(change @ moved)
    if slope <= 1e-12 * float(np.linalg.norm(change) * np.linalg.norm(moved)):
        return residual
    before = float(moved @ residual @ moved)
    sized = residual * min(1.0, abs(float(moved @ along) / before)) if before else residual
    gap = along - sized @ moved
    cross = np.outer(gap, change)
    return sized + (cross + cross.T) / slope - (gap @ moved) * np.outer(change, change) / slope**2


def promised(matrix: np.ndarray, gradient: np.ndarray, step: np.ndarray) -> float:
    """What the quadratic model gains by a step."""
    return float(-(gradient @ step) - 0.5 * step @ matrix @ step)


def _finite(found: GaussNewtonModel) -> np.ndarray:
    """Which starts (k,) have finite derivatives."""
    numbers = np.concatenate([found.gradient[:, None], found.gauss_newton], axis=1).reshape(
        len(found.gradient), -1
    )
    return np.asarray(np.isfinite(numbers).all(axis=1))


def _begin(radius: float, oracle: Oracle, starts: np.ndarray, seed: int) -> LmState:
    rows = np.arange(len(starts))
    found = oracle.gauss_newton_model(starts, rows)
    norm = np.linalg.norm(found.gradient, axis=1)
    broken = ~_finite(found)
    return LmState(
        z=starts,
        value=found.objective,
        gradient=found.gradient,
        matrix=found.gauss_newton,
        residual=np.zeros_like(found.gauss_newton),
        radius=np.full(len(starts), radius),
        gradient_norm=norm,
        done=broken | (norm == 0),
    )


class _TrialStep(NamedTuple):
    """A step that is tried. hoped: what its model promises."""

    start: int
    step: np.ndarray
    factor: float
    hoped: float


def _trial_steps(state: LmState, k: int, largest: float) -> list[_TrialStep]:
    """Steps of both models, of all radii."""
    models = [state.matrix[k]]
    if np.any(state.residual[k]):
        models.append(state.matrix[k] + state.residual[k])
    found = []
    for model in models:
        for factor in FACTORS:
            step = damped_step(model, state.gradient[k], min(factor * state.radius[k], largest))
            found.append(_TrialStep(k, step, factor, promised(model, state.gradient[k], step)))
    return found


def _step(largest: float, oracle: Oracle, state: LmState) -> LmState:
    trials = [t for k in np.flatnonzero(~state.done) for t in _trial_steps(state, int(k), largest)]
    rows = np.array([t.start for t in trials])
    values = oracle.values(state.z[rows] + np.stack([t.step for t in trials]), rows)
    radius, done, moved = state.radius.copy(), state.done.copy(), state.z.copy()
    for k in np.unique(rows):
        best = min(np.flatnonzero(rows == k), key=lambda i: values[i])
        trial, gained = trials[best], state.value[k] - values[best]
        if gained > max(ENOUGH * trial.hoped, 0.0):
            moved[k] = state.z[k] + trial.step
            length = float(np.linalg.norm(trial.step))
            radius[k] = min(max(trial.factor * radius[k], 0.5 * length), largest)
            done[k] = gained < SMALLEST_GAIN * abs(state.value[k])
        else:
            radius[k] *= SHRINK
            small = max(t.hoped for t in trials if t.start == k)
            done[k] = radius[k] < SMALLEST_RADIUS or small < SMALLEST_GAIN * abs(state.value[k])
    return _refreshed(oracle, state._replace(radius=radius, done=done), moved)


def _refreshed(oracle: Oracle, state: LmState, moved: np.ndarray) -> LmState:
    """The state with Jacobians at the points that moved. A start whose Jacobian is not finite goes
    back and tries closer."""
    rows = np.flatnonzero(np.any(moved != state.z, axis=1))
    if not len(rows):
        return state
    found = oracle.gauss_newton_model(moved[rows], rows)
    sound = _finite(found)
    z, value = state.z.copy(), state.value.copy()
    gradient, matrix = state.gradient.copy(), state.matrix.copy()
    residual = state.residual.copy()
    radius, done = state.radius.copy(), state.done.copy()
    for i, k in enumerate(rows):
        if sound[i]:
            residual[k] = learned(
                residual[k],
                found.gauss_newton[i],
                moved[k] - z[k],
                found.gradient[i] - gradient[k],
            )
            z[k], value[k] = moved[k], found.objective[i]
            gradient[k], matrix[k] = found.gradient[i], found.gauss_newton[i]
        else:
            radius[k] *= SHRINK
            done[k] = radius[k] < SMALLEST_RADIUS
    norm = np.linalg.norm(gradient, axis=1)
    return LmState(z, value, gradient, matrix, residual, radius, norm, done)


def _first(cost_model: CostModel, n: int) -> float:
    return cost_model.curvature + len(FACTORS)


@functools.cache
def levenberg_marquardt(radius: float = 1.0, largest: float = 4.0) -> Method:
    """radius: of the first step, in z; largest: of any."""
    return Method(
        name="lm",
        needs="curvatures",
        first=_first,
        begin=functools.partial(_begin, radius),
        step=functools.partial(_step, largest),
    )
