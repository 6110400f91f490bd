"""Levenberg-Marquardt in trust-region form, with the residual curvature of NL2SOL.

    (H + damping I) p = -g,   |p| <= radius     H = 2 sum omega dr/dz dr/dz^T (Gauss-Newton)

For few parameters: the Jacobian comes from forward mode. Where the residuals stay large, as an
error that no gain can remove, their own curvature S is missing in H. It is learned from the
gradients along the way, so that (H + S) moved = change of g. Steps of both models, of several
radii each, are tried in one batch: radius and model find themselves without a Jacobian for each
trial step. In z a unit is about a factor e of a gain, so radii of 1 to 2 are large steps.
Source: Dennis, Gay, Welsch, ACM Trans. Math. Softw. 7 (1981), 348-368, for S.
"""

import copy
import functools
from typing import NamedTuple

import numpy as np

from tuning.tuner.problem.problem import GaussNewtonModel
from tuning.tuner.search.cost_model import CostModel
from tuning.tuner.search.method import Method, Oracle

#: radii that are tried together, as factors on the radius of the state
FACTORS = (2.0, 1.0, 0.3)
#: what is left of the radius when no trial step helps
SHRINK = 0.05
#: a step must give this share of what the model promises
ENOUGH = 1e-4
#: below this radius, or promised relative gain, a start is at its end
SMALLEST_RADIUS = 1e-4
SMALLEST_GAIN = 1e-6


class LmState(NamedTuple):
    """Trust-region iterates.

    Attributes:
        z: points reached, (k, n).
        value: J there, (k,).
        gradient: g, (k, n).
        matrix: H, (k, n, n).
        residual: S, (k, n, n).
        radius: of the trust region, in z, (k,).
        gradient_norm: (k,).
        done: (k,).
    """

    z: np.ndarray
    value: np.ndarray
    gradient: np.ndarray
    matrix: np.ndarray
    residual: np.ndarray
    radius: np.ndarray
    gradient_norm: np.ndarray
    done: np.ndarray


def damped_step(matrix: np.ndarray, gradient: np.ndarray, radius: float) -> np.ndarray:
    """Trust-region step: the p of the equation above with |p| <= radius.

    The damping is found by bisection on its logarithm, in the eigenbasis of the matrix.

    Args:
        matrix: (n, n) symmetric; where it is indefinite the damping makes up for it.
        gradient: (n,).
        radius: longest step.

    Returns:
        The step, (n,).
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
    """Secant update of the residual curvature: (matrix + S) moved = change.

    Otherwise S stays as near to the sized S before as can be.

    Args:
        residual: S before, (n, n).
        matrix: H after the step, (n, n).
        moved: the step, (n,).
        change: of the gradient, (n,).

    Returns:
        S after the step, (n, n); S before where the curvature along the step is not positive.
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
    """Predicted reduction of the quadratic model: -g^T p - p^T H p / 2."""
    return float(-(gradient @ step) - 0.5 * step @ matrix @ step)


def _finite(model: GaussNewtonModel) -> np.ndarray:
    """Which starts (k,) have finite derivatives."""
    numbers = np.concatenate([model.gradient[:, None], model.gauss_newton], axis=1)
    return np.asarray(np.isfinite(numbers.reshape(len(numbers), -1)).all(axis=1))


def _begin(radius: float, oracle: Oracle, starts: np.ndarray, seed: int) -> LmState:
    here = oracle.gauss_newton_model(starts, np.arange(len(starts)))
    norm = np.linalg.norm(here.gradient, axis=1)
    return LmState(
        z=starts,
        value=here.objective,
        gradient=here.gradient,
        matrix=here.gauss_newton,
        residual=np.zeros_like(here.gauss_newton),
        radius=np.full(len(starts), radius),
        gradient_norm=norm,
        done=~_finite(here) | (norm == 0),
    )


class _TrialStep(NamedTuple):
    """A step that is tried. factor: on the radius. promised: what its model promises."""

    start: int
    step: np.ndarray
    factor: float
    promised: float


def _trial_steps(state: LmState, k: int, largest: float) -> list[_TrialStep]:
    """Steps of both models, H and H + S, of all radii."""
    models = [state.matrix[k]]
    if np.any(state.residual[k]):
        models.append(state.matrix[k] + state.residual[k])
    steps = []
    for model in models:
        for factor in FACTORS:
            step = damped_step(model, state.gradient[k], min(factor * state.radius[k], largest))
            steps.append(_TrialStep(k, step, factor, promised(model, state.gradient[k], step)))
    return steps


def _step(largest: float, oracle: Oracle, state: LmState) -> LmState:
    trials = [t for k in np.flatnonzero(~state.done) for t in _trial_steps(state, int(k), largest)]
    rows = np.array([t.start for t in trials])
    values = oracle.values(state.z[rows] + np.stack([t.step for t in trials]), rows)
    radius, done, moved = state.radius.copy(), state.done.copy(), state.z.copy()
    for k in np.unique(rows):
        best = min(np.flatnonzero(rows == k), key=lambda i: values[i])
        trial, gained = trials[best], state.value[k] - values[best]
        if gained > max(ENOUGH * trial.promised, 0.0):
            moved[k] = state.z[k] + trial.step
            length = float(np.linalg.norm(trial.step))
            radius[k] = min(max(trial.factor * radius[k], 0.5 * length), largest)
            done[k] = gained < SMALLEST_GAIN * abs(state.value[k])
        else:
            radius[k] *= SHRINK
            small = max(t.promised for t in trials if t.start == k)
            done[k] = radius[k] < SMALLEST_RADIUS or small < SMALLEST_GAIN * abs(state.value[k])
    return _refreshed(oracle, state._replace(radius=radius, done=done), moved)


def _refreshed(oracle: Oracle, state: LmState, moved: np.ndarray) -> LmState:
    """The state with Jacobians at the points that moved.

    A start whose Jacobian is not finite goes back and tries closer.
    """
    rows = np.flatnonzero(np.any(moved != state.z, axis=1))
    if not len(rows):
        return state
    there = oracle.gauss_newton_model(moved[rows], rows)
    new = copy.deepcopy(state)
    for i, (k, finite) in enumerate(zip(rows, _finite(there), strict=True)):
        if finite:
            matrix, change = there.gauss_newton[i], there.gradient[i] - state.gradient[k]
            new.residual[k] = learned(state.residual[k], matrix, moved[k] - state.z[k], change)
            new.z[k], new.value[k] = moved[k], there.objective[i]
            new.gradient[k], new.matrix[k] = there.gradient[i], matrix
        else:
            new.radius[k] *= SHRINK
            new.done[k] = new.radius[k] < SMALLEST_RADIUS
    return new._replace(gradient_norm=np.linalg.norm(new.gradient, axis=1))


def _first(cost_model: CostModel, n: int) -> float:
    return cost_model.gauss_newton + len(FACTORS)


@functools.cache
def levenberg_marquardt(radius: float = 1.0, largest: float = 4.0) -> Method:
    """Levenberg-Marquardt from every start.

    Args:
        radius: of the first trust region, in z.
        largest: radius of any.
    """
    begin, step = functools.partial(_begin, radius), functools.partial(_step, largest)
    return Method(name="lm", needs="gauss_newton", first=_first, begin=begin, step=step)
