"""Adversarial sampling: the plants on which gains are worst, to be added to the training set."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from tuning.tuner.evidence.validation import column_of, simulate_metrics, with_light_metric
from tuning.tuner.problem.scenario_set import RunSet

#: plants added to each contour in a round
ADDED = 2


class WorstPlants(NamedTuple):
    """The worst plants of a pool.

    Attributes:
        added: runs to train on.
        worst: the largest metric, inf where a run was lost.
        labels: of the plants.
    """

    added: list[RunSet]
    worst: float
    labels: tuple[str, ...]


def worst_plants(every: Sequence[RunSet], gains: Any, metric: str) -> WorstPlants:
    """The `ADDED` runs of each set with the largest metric under some gains.

    Args:
        every: run sets of a pool.
        gains: as the law takes them.
        metric: a lost run is the worst, the earlier the worse.
    """
    added, largest, labels = [], 0.0, []
    for one in every:
        lighter = one._replace(case=with_light_metric(one.case, metric))
        columns = simulate_metrics([lighter], [gains])
        values = column_of(columns, metric, one.case.loop.plant.axes)[0]
        order = worst_of(values, columns["lost_at_s"][0], ADDED)
        added.append(
            one._replace(
                values={path: value[order] for path, value in one.values.items()},
                seeds=one.seeds[order],
                labels=tuple(one.labels[i] for i in order),
            )
        )
        largest = max(largest, float(np.nan_to_num(values[order[0]], nan=np.inf)))
        labels += added[-1].labels
    return WorstPlants(added, largest, tuple(labels))


def worst_of(values: np.ndarray, lost_at: np.ndarray, count: int) -> np.ndarray:
    """Places of the largest values.

    Args:
        values: (n,), NaN for lost runs, which come first, the earliest first.
        lost_at: when they were lost, s, (n,).
        count: how many.
    """
    ranked = np.nan_to_num(values, nan=np.inf)
    return np.lexsort((np.nan_to_num(lost_at, nan=np.inf), -ranked))[:count]
