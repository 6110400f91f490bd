"""Which report a folder gets: that of the file by which its kind is known."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from jaxstage.system.files import write_text
from tuning.app.reports import comparison, demo, run, sweep, tuning
from tuning.app.reports.page import Page, html


class ReportKind(NamedTuple):
    """What a folder may hold.

    Args:
        name: what it is called.
        marker: the file by which it is known.
        answers: the JSON file that the work ends with.
        goes_on: the command that finishes stopped work in a ``{folder}``.
        read: the page of a folder whose work has ended.
    """

    name: str
    marker: str
    answers: str
    goes_on: str
    read: Callable[[Path], Page]


#: what reading a file of another version, or a damaged one, may raise
_DAMAGED = (LookupError, TypeError, AttributeError, ValueError, ArithmeticError, RecursionError)

KINDS = (
    ReportKind("run", "run.json", "run.json", "`jaxstage run`", run.read),
    ReportKind("comparison", "compare.json", "compare.json", "`jaxstage compare`", comparison.read),
    ReportKind(
        "sweep",
        "sweep.toml",
        "summary.json",
        "`jaxstage sweep --out {folder} --resume`",
        sweep.read,
    ),
    ReportKind(
        "tuning", "tune.toml", "tune.json", "the same `jaxstage tune` with --resume", tuning.read
    ),
    ReportKind("demo", "demo.toml", "demo.json", "`jaxstage demo --out {folder}`", demo.read),
)


def kind_of(folder: Path) -> ReportKind:
    """What a folder holds. Raises ValueError where that is none of `KINDS`."""
    if not folder.is_dir():
        told = "is not a folder" if folder.exists() else "no such folder"
        raise ValueError(f"{folder}: {told}")
    for kind in KINDS:
        if (folder / kind.marker).is_file():
            return kind
    known = ", ".join(f"a {kind.name} ({kind.marker})" for kind in KINDS)
    raise ValueError(f"{folder} holds nothing to report: none of {known}")


def page_of(folder: Path) -> Page:
    """What a folder says.

    Raises:
        ValueError: where it holds none of `KINDS`, work that was stopped, or a damaged file.
    """
    kind = kind_of(folder)
    if not (folder / kind.answers).is_file():
        goes_on = kind.goes_on.format(folder=folder)
        raise ValueError(f"{folder} holds a {kind.name} without answers: {goes_on} finishes it")
    with _of_this_version(folder):
        return kind.read(folder)


def write(folder: Path, file: Path) -> None:
    """Write the report of a folder, whole or not at all."""
    page = page_of(folder)
    with _of_this_version(folder):
        text = html(page)
    write_text(file, text)


@contextmanager
def _of_this_version(folder: Path) -> Iterator[None]:
    """Name the file where what a folder holds cannot be read."""
    try:
        yield
    except _DAMAGED as error:
        kind = kind_of(folder)
        files = " or ".join(dict.fromkeys((kind.marker, kind.answers)))
        raise ValueError(
            f"{folder}: {files} is not what this version writes ({error!r}): run the {kind.name} "
            "again"
        ) from error
