"""Arithmetic of figures that may be missing, because a run was lost."""

from collections.abc import Sequence


def ratio(top: float | None, bottom: float | None) -> float | None:
    """top / bottom, None where one is missing or the bottom is 0."""
    return None if top is None or not bottom else top / bottom


def saving(better: float | None, worse: float | None) -> float | None:
    """1 - better / worse."""
    left = ratio(better, worse)
    return None if left is None else 1 - left


def largest(figures: Sequence[float | None]) -> float | None:
    """The largest, None where one is missing."""
    known = [figure for figure in figures if figure is not None]
    return max(known) if len(known) == len(figures) else None
