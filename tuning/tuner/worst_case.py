"""The plants on which gains are worst, found among fresh ones and added to the training set."""

from typing import Any, NamedTuple

import numpy as np

from tuning.tuner.judging import column_of, figures
from tuning.tuner.sets import Series

#: plants added to each contour in a round
ADDED = 2


class Found(NamedTuple):
    """The worst plants of a pool. added: runs to train on. worst: the largest figure, inf where a
    run was lost. labels: of the plants."""

    added: list[Series]
    worst: float
    labels: tuple[str, ...]


def worst_plants(every: list[Series], gains: Any, figure: str) -> Found:
    """The `ADDED` runs of each series with the largest figure under some gains; a lost run is the
    worst, the earlier the worse."""
    added, largest, labels = [], 0.0, []
    for one in every:
        columns = figures([one], [gains])
        values = column_of(columns, figure, one.case.loop.plant.axes)[0]
        ranked = np.where(np.isnan(values), np.inf, values)
        lost = np.nan_to_num(columns["lost_at_s"][0], nan=np.inf)
        order = np.lexsort((lost, -ranked))[:ADDED]
        added.append(
            one._replace(
                values={path: value[order] for path, value in one.values.items()},
                seeds=one.seeds[order],
                labels=tuple(one.labels[i] for i in order),
            )
        )
        largest = max(largest, float(ranked[order[0]]))
        labels += added[-1].labels
    return Found(added, largest, tuple(labels))
