"""What all plots of a sweep or of a tuning share."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from jaxstage.plot.page import page

#: a metric that spans more than this ratio is drawn on a log axis
WIDE = 8.0


class Sheet(NamedTuple):
    """What all plots of a sweep share. label: of the metric, with unit. limit: of the
    specification, or None. footer: settings, seed, version."""

    label: str
    limit: float | None
    footer: str


def sheet_page(title: str, text: str, footer: str, width: float, height: float) -> Figure:
    """An empty figure with title, explanation and footer."""
    return page(title, text, footer, (width, height))


def log_where_wide(setters: Iterable[Callable[[str], object]], *values: np.ndarray) -> bool:
    """Set log scales where the values span a wide range; returns whether it did."""
    finite = np.concatenate([v[np.isfinite(v)] for v in values])
    wide = len(finite) > 0 and finite.min() > 0 and finite.max() > WIDE * finite.min()
    for set_scale in setters if wide else ():
        set_scale("log")
    return bool(wide)
