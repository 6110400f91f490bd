"""The plants on which gains are worst, found among fresh ones and added to the training set."""

from typing import Any, NamedTuple

import numpy as np

from tuning.tuner.evidence.validation import column_of, simulate_metrics, with_light_metric
from tuning.tuner.problem.scenario_set import RunSet

#: plants added to each contour in a round
ADDED = 2


class WorstPlants(NamedTuple):
    """The worst plants of a pool. added: runs to train on. worst: the largest figure, inf where a
    run was lost. labels: of the plants."""

    added: list[RunSet]
    worst: float
    labels: tuple[str, ...]


def worst_plants(every: list[RunSet], gains: Any, metric: str) -> WorstPlants:
    """The `ADDED` runs of each series with the largest figure under some gains; a lost run is the
    worst, the earlier the worse."""
    added, largest, labels = [], 0.0, []
    for one in every:
        columns = simulate_metrics(
            [one._replace(case=with_light_metric(one.case, metric))], [gains]
        )
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
    """Places of the largest values (n,). NaN: lost runs, which come first, the earliest first."""
    ranked = np.nan_to_num(values, nan=np.inf)
    return np.lexsort((np.nan_to_num(lost_at, nan=np.inf), -ranked))[:count]
