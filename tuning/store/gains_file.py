"""A file of gains: the law, every gain in SI, and of tuned ones unit, range and value before.

law = "pi"                  # another law refuses the file; without this line any takes it

refused = ["a reason"]      # of gains that their tuning did not accept; each output says so

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

from jaxstage.model.settings import TomlFile, nested, plain_toml, read_toml
from jaxstage.studies import Case

#: what such a file holds beside gains
LAW, REFUSED, NOTES = "law", "refused", ("law", "refused", "tuned")


class TunedGain(NamedTuple):
    """A gain that was tuned. low, high: its range; before: its value then; arrays of its shape, in
    ``unit``."""

    gain: str
    symbol: str
    unit: str
    low: np.ndarray
    high: np.ndarray
    before: np.ndarray


def to_text(
    case: Case,
    gains: Any,
    tuned: Sequence[TunedGain] = (),
    remarks: Sequence[str] = (),
    refused: Sequence[str] = (),
) -> str:
    """The text of a file of gains.

    Args:
        case: Of the law.
        gains: All gains of the law.
        tuned: What is said of those that were tuned.
        remarks: One comment line each.
        refused: Why a tuning did not accept the gains; empty: it did, or there was none.
    """
    tables = [
        one._asdict()
        | {"low": _plain(one.low), "high": _plain(one.high)}
        | {"before": np.asarray(one.before, float).tolist()}
        for one in tuned
    ]
    head = "".join(f"# {' '.join(remark.split())}\n" for remark in remarks)
    content: dict[str, Any] = {LAW: case.loop.controller.name}
    content |= {REFUSED: list(refused)} if refused else {}
    content |= {"gains": nested(gains)}
    return head + plain_toml(content | ({"tuned": tables} if tables else {}))


class GainsFile(NamedTuple):
    """A file of gains, read once; without a file, what changes nothing.

    Attributes:
        toml: The file, for the places of errors; None where there is none.
        law: The law that the gains are of; None where the file does not say.
        values: Gains by dotted name, SI: numbers or nested lists.
        refused: Why the tuning that gave them did not accept them.
    """

    toml: TomlFile | None = None
    law: str | None = None
    values: Mapping[str, Any] = {}
    refused: tuple[str, ...] = ()

    def notes(self) -> tuple[str, ...]:
        """What a user of refused gains should know, one line."""
        if not self.toml or not self.refused:
            return ()
        return (f"{self.toml.file}: {refused_text(self.refused)}",)

    def refuse_other_law(self, case: Case) -> None:
        """Raise ValueError where the file names another law than that of the case."""
        own = case.loop.controller.name
        if self.toml and self.law not in (None, own):
            raise ValueError(
                f"{self.toml.place(LAW)}: these are gains of {self.law}, the law of {case.name} is "
                f"{own}; a file without this line is taken for any law"
            )


def refused_text(reasons: Sequence[str]) -> str:
    """That gains were refused, and why."""
    return f"these gains were REFUSED by their tuning: {'; '.join(reasons)}"


#: nothing is said
NO_GAINS = GainsFile()


def read_gains(file: Path | None) -> GainsFile:
    """Read a file of gains, or none. Raises ValueError in one line, with its place."""
    if file is None:
        return NO_GAINS
    toml = read_toml(file)
    values = {k: v for k, v in toml.values.items() if k.partition(".")[0] not in NOTES}
    refused = toml.values.get(REFUSED, [])
    if not isinstance(refused, list) or not all(isinstance(reason, str) for reason in refused):
        raise ValueError(f"{toml.place(REFUSED)}: {REFUSED} must be a list of reasons")
    return GainsFile(toml, toml.values.get(LAW), values, tuple(refused))


def _plain(values: np.ndarray) -> Any:
    """One number where all elements agree, else the array as lists."""
    array = np.asarray(values, float)
    same = array.size > 0 and np.all(array == array.reshape(-1)[0])
    return float(array.reshape(-1)[0]) if same else array.tolist()


def read_tuned(file: Path) -> list[TunedGain]:
    """What a file says of the gains that were tuned. Raises ValueError for one without."""
    tables = read_toml(file).values.get("tuned", [])
    if not isinstance(tables, list) or not tables:
        raise ValueError(f"{file} holds no [[tuned]] gains")
    return [_tuned(table) for table in tables]


def _tuned(table: Mapping[str, Any]) -> TunedGain:
    before = np.asarray(table["before"], float)
    low, high = (
        np.broadcast_to(np.asarray(table[k], float), before.shape) for k in ("low", "high")
    )
    return TunedGain(table["gain"], table["symbol"], table["unit"], low, high, before)
