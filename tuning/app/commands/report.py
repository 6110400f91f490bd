"""``jaxstage report``: one HTML file of a folder of results."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer


@dataclass(frozen=True)
class ReportOptions:
    """What ``jaxstage report`` takes."""

    folder: Annotated[
        Path, typer.Argument(help="Folder of a run, comparison, sweep, tuning or demo.")
    ]
    out: Annotated[
        Path | None, typer.Option(help="File to write; report.html in the folder if left out.")
    ] = None


def report(options: ReportOptions) -> None:
    """One self-contained HTML file of a folder of results."""
    from tuning.app.reports.kinds import write

    file = options.out or options.folder / "report.html"
    if file.exists() and not file.is_file():
        raise ValueError(f"--out {file}: must be a file")
    write(options.folder, file)
    print(file)
