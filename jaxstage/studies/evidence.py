"""Metrics picked out of the evidence of a study, and their arithmetic.

A pick takes the evidence and gives one number, or None where a run that it needs was lost.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

#: name of a simulated case -> its metrics, as `columns` gives them
Evidence = Mapping[str, Mapping[str, Any]]

#: one number of the evidence, None where a run it needs was lost
Pick = Callable[[Evidence], float | None]


def ratio(top: float | None, bottom: float | None) -> float | None:
    """top / bottom, None where one is missing or the bottom is 0."""
    return None if top is None or not bottom else top / bottom


def largest(values: Iterable[float | None]) -> float | None:
    """The largest value, None where one is missing."""
    every = list(values)
    known = [value for value in every if value is not None]
    return max(known) if len(known) == len(every) else None


def of(case: str, metric: str, axis: str | None = None) -> Pick:
    """A metric of a case; axis: of one that has several."""

    def pick(evidence: Evidence) -> float | None:
        value = evidence[case][metric]
        return value if axis is None else value[axis]

    return pick


def always(value: float) -> Pick:
    """A number that needs no evidence."""
    return lambda evidence: value


def over(top: Pick, bottom: Pick) -> Pick:
    """top / bottom."""
    return lambda evidence: ratio(top(evidence), bottom(evidence))


def applied(change: Callable[[float], float], pick: Pick) -> Pick:
    """A picked number, changed."""

    def changed(evidence: Evidence) -> float | None:
        value = pick(evidence)
        return None if value is None else change(value)

    return changed


def saved(better: Pick, worse: Pick) -> Pick:
    """The share saved, 1 - better / worse."""
    return applied(lambda share: 1 - share, over(better, worse))


def added(more: Pick, less: Pick) -> Pick:
    """The share added, more / less - 1."""
    return applied(lambda share: share - 1, over(more, less))


def largest_of(picks: Sequence[Pick]) -> Pick:
    """The largest of several picks."""
    return lambda evidence: largest(pick(evidence) for pick in picks)
