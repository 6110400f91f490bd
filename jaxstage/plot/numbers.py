"""Round numbers, and thinning that loses no spike."""

import math

import numpy as np


def plain(value: float) -> str:
    """Four significant digits, as people write them: 80,000 and not 8e+04.

    Powers of ten only from ten millions on and below a ten-thousandth.
    """
    rounded = float(f"{value:.4g}")
    if rounded and not 1e-4 <= abs(rounded) < 1e7:
        return f"{value:.4g}"
    return f"{rounded:,.10g}"


def round_down(value: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above ``value`` > 0."""
    power = 10.0 ** math.floor(math.log10(value))
    # 1e-9: a value such as 0.2/0.1 must not fall below the number it stands for
    step = max(s for s in (1.0, 2.0, 5.0, 10.0) if s <= value / power * (1 + 1e-9))
    return step * power


def envelope(x: np.ndarray, y: np.ndarray, count: int = 1500) -> np.ndarray:
    """Indices of the points to draw: first, last, lowest and highest of each of ``count`` columns.

    x: ascending, (n,). y: finite, (n,). A line through the kept points covers the same pixels as
    one through all, with every extreme kept.
    """
    if len(x) <= 4 * count:
        return np.arange(len(x))
    span = (x[-1] - x[0]) or 1.0
    column = np.minimum((x - x[0]) / span * count, count - 1).astype(int)
    first = np.flatnonzero(np.diff(column, prepend=-1))
    last = np.append(first[1:], len(x)) - 1
    by_value = np.lexsort((y, column))
    return np.unique(np.concatenate([first, last, by_value[first], by_value[last]]))


def pixels(points: np.ndarray, count: int = 2000) -> np.ndarray:
    """Indices to draw of a path in the plane: where it enters and leaves each pixel.

    points: finite, (n, 2). A pixel is the larger extent of the path over ``count``, so that no
    point of the path is farther than one pixel from a kept one.
    """
    if len(points) <= count:
        return np.arange(len(points))
    size = float(np.max(np.ptp(points, axis=0))) / count or 1.0
    cell = np.floor((points - points.min(axis=0)) / size).astype(int)
    moved = np.append(True, np.any(np.diff(cell, axis=0) != 0, axis=1))
    leaves = np.append(moved[1:], True)
    return np.flatnonzero(moved | leaves)
