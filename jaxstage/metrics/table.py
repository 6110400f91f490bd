"""A report as flat columns with units in their names."""

import math
from typing import Any

import numpy as np

from jaxstage.fields import leaves

#: how a unit is written in a key
_SUFFIX = {
    "1": "", "A/s": "A_per_s", "A2": "A2", "m/s": "m_per_s", "mm/s": "mm_per_s", "%": "percent",
}  # fmt: skip


def key(name: str, unit: str) -> str:
    """The key of a figure: its name and the unit it is shown in."""
    suffix = _SUFFIX.get(unit, unit)
    return f"{name}_{suffix}" if suffix else name


def _number(value: Any, factor: float) -> float | None:
    scaled = float(value) * factor
    return scaled if math.isfinite(scaled) else None


def columns(report: Any, axes: tuple[str, ...]) -> dict[str, Any]:
    """Figures of one run in display units: {key: number}, per-axis ones {key: {axis: number}}.

    What is not finite (a lost run, a window without samples) becomes None. Raises ValueError
    if two fields share a name.
    """
    table: dict[str, Any] = {}
    for path, quantity, value in leaves(report):
        name = key(path.rsplit(".", 1)[-1], quantity.shown)
        if name in table:
            raise ValueError(f"two figures are called {name}")
        array = np.asarray(value)
        if array.ndim:
            table[name] = {a: _number(v, quantity.factor) for a, v in zip(axes, array, strict=True)}
        else:
            table[name] = _number(array, quantity.factor)
    return table


def split_key(name: str) -> tuple[str, str]:
    """Name and unit of a key, for people: ``contour_rms_um`` -> (``contour rms``, ``um``)."""
    for unit in ("um", "J", "A", "A2", "A_per_s", "m"):
        if name.endswith("_" + unit):
            return name.removesuffix("_" + unit).replace("_", " "), unit.replace("_per_", "/")
    return name.replace("_", " "), ""
