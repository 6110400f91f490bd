"""Gradient check: forward-mode slopes against central differences, run by run."""

from typing import NamedTuple

import numpy as np

from tuning.tuner.problem.problem import GaussNewtonModel, Problem, directional, evaluate

#: steps of the differences, in z: with the exact model a larger one averages over small jumps
STEPS = (1e-3, 1e-2)
#: a run's slopes pass when they are off by less, relative to the largest of them
TOLERANCE = 0.2
#: the check passes when so many of the runs do
MOST_RUNS = 0.75


class GradientCheck(NamedTuple):
    """Slopes of the cost of each run against differences.

    Attributes:
        runs: their names.
        slopes: derivatives along d directions, (runs, d).
        differences: of the better step, (runs, d).
        error: largest difference of both, relative to the largest slope of the run, (runs,).
        non_finite: runs whose slope is not finite.
        ok: whether a search by gradients can be trusted.
    """

    runs: tuple[str, ...]
    slopes: np.ndarray
    differences: np.ndarray
    error: np.ndarray
    non_finite: int
    ok: bool


def directions_of(size: int, count: int, seed: int) -> np.ndarray:
    """Random unit vectors, (count, size)."""
    drawn = np.random.default_rng(seed).standard_normal((count, size))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def gradient_check(
    problem: Problem,
    z: np.ndarray,
    directions: int = 3,
    seed: int = 0,
    known: GaussNewtonModel | None = None,
) -> GradientCheck:
    """Check the derivatives of every run's cost along random directions.

    Args:
        problem: training runs and objective.
        z: where, (n,).
        directions: how many.
        seed: of the directions.
        known: the model at z, which holds the slopes already.
    """
    along = directions_of(len(z), directions, seed)
    slopes = directional(problem, z, along) if known is None else along @ known.of_runs[0].T
    differences = [_differences(problem, z, along, step).T for step in STEPS]
    return compare_slopes(problem.run_names, slopes.T, differences)


def _differences(problem: Problem, z: np.ndarray, along: np.ndarray, step: float) -> np.ndarray:
    ends = np.concatenate([z + step * along, z - step * along])
    costs = evaluate(problem, ends).costs
    return (costs[: len(along)] - costs[len(along) :]) / (2 * step)


def compare_slopes(
    runs: tuple[str, ...], slopes: np.ndarray, differences: list[np.ndarray]
) -> GradientCheck:
    """The check of slopes against differences.

    Args:
        runs: their names.
        slopes: (runs, d).
        differences: (runs, d) of each step.
    """
    scale = np.max(np.abs(np.stack([slopes, *differences])), axis=(0, 2))
    safe = np.where(scale > 0, scale, 1.0)
    errors = np.stack([np.max(np.abs(slopes - d), axis=1) / safe for d in differences])
    errors = np.where(np.isfinite(errors), errors, np.inf)
    best = np.argmin(errors, axis=0)
    error = np.min(errors, axis=0)
    better = np.stack(differences)[best, np.arange(len(runs))]
    non_finite = int(np.sum(~np.isfinite(slopes).all(axis=1)))
    ok = non_finite == 0 and bool(np.mean(error <= TOLERANCE) >= MOST_RUNS)
    return GradientCheck(runs, slopes, better, error, non_finite, ok)
