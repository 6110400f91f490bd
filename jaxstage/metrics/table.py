"""A report as flat columns with units in their names."""

import math
import re
from typing import Any

import numpy as np

from jaxstage.model.blocks import Plant
from jaxstage.model.fields import in_units_of, leaves

#: the end of a key that is a unit
_UNIT = re.compile(
    r"_((?:1(?=_per)|um|mm|m|s|A|V|W|J|N|Nm|N2m2|Hz|rad|mWh|percent)\d?(?:_per_(?:s|m)\d?)?)$"
)


def key(name: str, unit: str) -> str:
    """The key of a figure: its name and the unit it is shown in, e.g. ``_A_per_s`` or ``_Nm``."""
    suffix = {"1": "", "%": "percent"}.get(unit, unit)
    suffix = re.sub("[ ()]", "", suffix.replace("/", "_per_"))
    return f"{name}_{suffix}" if suffix else name


def _number(value: Any, factor: float) -> float | None:
    scaled = float(value) * factor
    return scaled if math.isfinite(scaled) else None


def columns(report: Any, plant: Plant) -> dict[str, Any]:
    """Figures of one run in display units: {key: number}, per-axis ones {key: {axis: number}}.

    plant: names the axes and the unit of the command. What is not finite (a lost run, a window
    without samples) becomes None. Raises ValueError if two fields share a name.
    """
    table: dict[str, Any] = {}
    for path, general, value in leaves(report):
        quantity = in_units_of(general, plant.command_unit)
        name = key(path.rsplit(".", 1)[-1], quantity.shown)
        if name in table:
            raise ValueError(f"two figures are called {name}")
        array = np.asarray(value)
        if array.ndim:
            table[name] = {
                a: _number(v, quantity.factor) for a, v in zip(plant.axes, array, strict=True)
            }
        else:
            table[name] = _number(array, quantity.factor)
    return table


def split_key(name: str) -> tuple[str, str]:
    """Name and unit of a key, for people: ``contour_rms_um`` -> (``contour rms``, ``um``)."""
    found = _UNIT.search(name)
    if not found:
        return name.replace("_", " "), ""
    unit = found[1].replace("_per_", "/").replace("percent", "%")
    unit = re.sub(r"^(N\d?)m", r"\1 m", unit)
    return name[: found.start()].replace("_", " "), unit
