"""A report as flat columns with units in their names."""

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxstage.model.blocks import Plant
from jaxstage.model.fields import in_units_of, leaves

#: the end of a key that is a unit
_UNIT = re.compile(
    r"_((?:1(?=_per)|um|mm|m|s|A|V|W|J|N|Nm|N2m2|Hz|rad|mWh|percent)\d?(?:_per_(?:s|m)\d?)?)$"
)


def key(name: str, unit: str) -> str:
    """The key of a metric: its name and the unit it is shown in, e.g. ``_A_per_s`` or ``_Nm``."""
    suffix = {"1": "", "%": "percent"}.get(unit, unit)
    suffix = re.sub("[ ()]", "", suffix.replace("/", "_per_"))
    return f"{name}_{suffix}" if suffix else name


class ReportedMetric(NamedTuple):
    """One metric of a report.

    Args:
        name: of its field.
        unit: that it is shown in.
        values: in that unit, (batch...,) or (batch..., axes).
        axes: names of its last axis; empty where it is one number a run.
    """

    name: str
    unit: str
    values: Any
    axes: tuple[str, ...]

    @property
    def key(self) -> str:
        """Its column: name and unit."""
        return key(self.name, self.unit)

    def by_axis(self) -> dict[str, Any]:
        """Axis -> (batch...,)."""
        return {axis: self.values[..., i] for i, axis in enumerate(self.axes)}

    def columns(self) -> dict[str, Any]:
        """Column -> (batch...,), one an axis, e.g. ``following_rms_x_um``."""
        if not self.axes:
            return {self.key: self.values}
        return {key(f"{self.name}_{axis}", self.unit): v for axis, v in self.by_axis().items()}


def reported_metrics(report: Any, plant: Plant, batch: int = 0) -> Iterator[ReportedMetric]:
    """Every metric of a report in its display unit; the report may be traced.

    Args:
        report: leaves (batch...,) or (batch..., axes), SI.
        plant: names the axes and the unit of the command.
        batch: leading axes of every leaf.
    """
    for path, general, value in leaves(report):
        quantity = in_units_of(general, plant.command_unit)
        values = value * quantity.factor
        axes = plant.axes if values.ndim > batch else ()
        yield ReportedMetric(path.rsplit(".", 1)[-1], quantity.shown, values, axes)


def columns(report: Any, plant: Plant) -> dict[str, Any]:
    """Metrics of one run in display units: {key: number}, per-axis ones {key: {axis: number}}.

    What is not finite (a lost run, a window without samples) becomes None.

    Args:
        report: leaves () or (axes,), SI.
        plant: names the axes and the unit of the command.

    Raises:
        ValueError: if two fields share a name.
    """
    table: dict[str, Any] = {}
    for metric in reported_metrics(jax.tree.map(lambda x: np.asarray(x, float), report), plant):
        if metric.key in table:
            raise ValueError(f"two metrics are called {metric.key}")
        by_axis = {axis: _finite(value) for axis, value in metric.by_axis().items()}
        table[metric.key] = by_axis if metric.axes else _finite(metric.values)
    return table


def _finite(value: np.ndarray) -> float | None:
    return float(value) if np.isfinite(value) else None


def split_key(name: str) -> tuple[str, str]:
    """Name and unit of a key, for people: ``contour_rms_um`` -> (``contour rms``, ``um``)."""
    suffix = _UNIT.search(name)
    if not suffix:
        return name.replace("_", " "), ""
    unit = suffix[1].replace("_per_", "/").replace("percent", "%")
    unit = re.sub(r"^(N\d?)m", r"\1 m", unit)
    return name[: suffix.start()].replace("_", " "), unit
