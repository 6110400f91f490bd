"""A file of gains: the law, every gain in SI, and of tuned ones unit, range and value before.

law = "pi"                  # another law refuses the file; without this line any takes it

[gains]                     # what `--gains` of run, sweep, compare and tune reads
slope = [3.2, 2.9]

[[tuned]]                   # for people
gain = "gains.slope"
symbol = "c1"
unit = "1/s"
low = 0.1
high = 10.0
before = [1.0, 1.0]
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxstage.model.settings import line_of, nested, plain_toml, read_toml
from jaxstage.studies import Case

#: what such a file holds beside gains
LAW, NOTES = "law", ("law", "tuned")


class TunedGain(NamedTuple):
    """A gain that was tuned. low, high: its range; before: its value then; arrays of its shape."""

    gain: str
    symbol: str
    unit: str
    low: np.ndarray
    high: np.ndarray
    before: np.ndarray


def to_text(
    case: Case, gains: Any, tuned: Sequence[TunedGain] = (), remarks: Sequence[str] = ()
) -> str:
    """The file. gains: all of the law of the case. remarks: one comment line each."""
    tables = [
        {
            "gain": one.gain, "symbol": one.symbol, "unit": one.unit, "low": _plain(one.low),
            "high": _plain(one.high), "before": np.asarray(one.before, float).tolist(),
        }
        for one in tuned
    ]  # fmt: skip
    head = "".join(f"# {' '.join(remark.split())}\n" for remark in remarks)
    content = {LAW: case.loop.controller.name, "gains": nested(gains)}
    return head + plain_toml(content | ({"tuned": tables} if tables else {}))


def refuse_other_law(file: Path, case: Case) -> None:
    """Raise ValueError for a file that names another law than that of the case."""
    law, own = read_toml(file).get(LAW), case.loop.controller.name
    if law not in (None, own):
        raise ValueError(
            f"{file}:{line_of(file, LAW)}: these are gains of {law}, the law of {case.name} is "
            f"{own}; a file without this line is taken for any law"
        )


def _plain(values: np.ndarray) -> Any:
    """One number where all elements agree, else the array as lists."""
    array = np.asarray(values, float)
    same = array.size > 0 and np.all(array == array.reshape(-1)[0])
    return float(array.reshape(-1)[0]) if same else array.tolist()


def read_tuned(file: Path) -> list[TunedGain]:
    """What a file says of the gains that were tuned. Raises ValueError for one without."""
    tables = read_toml(file).get("tuned", [])
    if not isinstance(tables, list) or not tables:
        raise ValueError(f"{file} holds no [[tuned]] gains")
    return [_tuned(table) for table in tables]


def _tuned(table: Mapping[str, Any]) -> TunedGain:
    before = np.asarray(table["before"], float)
    low, high = (
        np.broadcast_to(np.asarray(table[k], float), before.shape) for k in ("low", "high")
    )
    return TunedGain(table["gain"], table["symbol"], table["unit"], low, high, before)
