"""Which report a folder gets: that of the file by which its kind is known."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from jaxstage.system.files import write_text
from tuning.app.reports import comparison, demo, run, sweep, tuning
from tuning.app.reports.page import Page, html


class ReportKind(NamedTuple):
    """What a folder may hold. marker: the file by which it is known."""

    name: str
    marker: str
    read: Callable[[Path], Page]


#: what reading a file of another version, or a spoilt one, may raise
_SPOILT = (
    KeyError,
    TypeError,
    AttributeError,
    UnicodeDecodeError,
    json.JSONDecodeError,
    tomllib.TOMLDecodeError,
)

KINDS = (
    ReportKind("run", "run.json", run.read),
    ReportKind("comparison", "compare.json", comparison.read),
    ReportKind("sweep", "sweep.toml", sweep.read),
    ReportKind("tuning", "tune.toml", tuning.read),
    ReportKind("demo", "demo.toml", demo.read),
)


def page_of(folder: Path) -> Page:
    """What a folder says. Raises ValueError where it holds none of `KINDS`, or cannot be read."""
    if not folder.is_dir():
        told = "is not a folder" if folder.exists() else "no such folder"
        raise ValueError(f"{folder}: {told}")
    for kind in KINDS:
        if (folder / kind.marker).is_file():
            try:
                return kind.read(folder)
            except _SPOILT as error:
                raise ValueError(
                    f"{folder / kind.marker} is not what this version writes ({error!r}): run the "
                    f"{kind.name} again"
                ) from None
    known = ", ".join(f"a {kind.name} ({kind.marker})" for kind in KINDS)
    raise ValueError(f"{folder} holds nothing to report: none of {known}")


def write(folder: Path, file: Path) -> None:
    """Write the report of a folder, whole or not at all."""
    write_text(file, html(page_of(folder)))
