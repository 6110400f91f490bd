"""Pareto front: dominance, hypervolume, knee, and weights on a simplex lattice.

All objectives are to be small. A point with an objective that is not finite, such as a lost run, is
dominated by every other one.
"""

import math

import numpy as np


def non_dominated(points: np.ndarray) -> np.ndarray:
    """Pareto-optimal points.

    A point dominates another if it is nowhere larger and somewhere smaller. Of equal points the
    first stays.

    Args:
        points: (n, m).

    Returns:
        Which points no other one dominates, (n,) bool.
    """
    kept = np.asarray(np.isfinite(points).all(axis=1))
    for i in np.flatnonzero(kept):
        others = points[kept]
        beaten = np.all(others <= points[i], axis=1) & np.any(others < points[i], axis=1)
        twin = kept[:i] & np.all(points[:i] == points[i], axis=1)
        kept[i] = not (beaten.any() or twin.any())
    return kept


def hypervolume(points: np.ndarray, reference: np.ndarray) -> float:
    """Hypervolume indicator: the volume that points dominate below a reference point.

    By slices along the last objective: exact, and meant for few objectives and some hundred points.
    What lies beyond the reference counts nothing.

    Args:
        points: (n, m).
        reference: a point that is worse than all, (m,).
    """
    inside = points[np.isfinite(points).all(axis=1) & np.all(points < reference, axis=1)]
    if not len(inside):
        return 0.0
    if inside.shape[1] == 1:
        return float(reference[0] - inside.min())
    order = np.argsort(inside[:, -1], kind="stable")
    inside = inside[order]
    heights = np.append(inside[1:, -1], reference[-1]) - inside[:, -1]
    slices = (
        height * hypervolume(inside[: i + 1, :-1], reference[:-1])
        for i, height in enumerate(heights)
        if height > 0
    )
    return math.fsum(slices)


def normalised(points: np.ndarray) -> np.ndarray:
    """Points (n, m) with the least of each objective at 0 and the largest at 1.

    An objective that does not vary is 0.
    """
    low, span = points.min(axis=0), np.ptp(points, axis=0)
    return (points - low) / np.where(span > 0, span, 1.0)


def knee(points: np.ndarray) -> int:
    """Knee of a front: the point nearest to the ideal one, each objective in its own range.

    Args:
        points: of the front, (n, m).

    Returns:
        Its row.

    Raises:
        ValueError: there are no points.
    """
    if not len(points):
        raise ValueError("no point is left to suggest: all were lost")
    return int(np.argmin(np.linalg.norm(normalised(points), axis=1)))


def weights(objectives: int, steps: int) -> np.ndarray:
    """Simplex lattice (Das and Dennis): weights that sum to 1, the corners included.

    Args:
        objectives: how many weights a row has.
        steps: parts that an edge is divided into.

    Returns:
        (n, objectives).
    """
    if objectives == 1:
        return np.ones((1, 1))

    def compositions(total: int, parts: int) -> list[tuple[int, ...]]:
        if parts == 1:
            return [(total,)]
        return [
            (first, *rest)
            for first in range(total + 1)
            for rest in compositions(total - first, parts - 1)
        ]

    return np.asarray(compositions(steps, objectives), float) / steps
