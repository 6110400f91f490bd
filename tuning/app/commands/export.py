"""``jaxstage export``: a controller as C99."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from tuning.app.shared_options import GainsFile, Loop, ScenarioFile, Settings


@dataclass(frozen=True)
class ExportOptions:
    """What ``jaxstage export`` takes."""

    loop: Loop
    out: Annotated[Path | None, typer.Option(help="Folder for the C files; a new one.")] = None
    lang: Annotated[str, typer.Option(help="c: C99.")] = "c"
    words: Settings = field(default_factory=list)
    gains: GainsFile = None
    scenario: ScenarioFile = None
    precision: Annotated[str, typer.Option(help="Of the C text: double, or single for float.")] = (
        "double"
    )
    axis: Annotated[
        str | None, typer.Option(help="One axis, e.g. x; the whole controller if left out.")
    ] = None
    prefix: Annotated[str, typer.Option(help="Begins every name in C.")] = "control"


def export(options: ExportOptions) -> None:
    """The controller as C99, with recorded ticks to check it."""
    from jaxstage.system.runtime import configure
    from tuning.app.messages import warn
    from tuning.store.gains_file import read_gains
    from tuning.store.prepare import check_folder, prepare
    from tuning.uncertainty.scenario_file import read_scenario

    if options.lang != "c":
        raise ValueError(f"--lang {options.lang}: must be c")
    if options.precision not in ("single", "double"):
        raise ValueError(f"--precision {options.precision}: must be single or double")
    if options.out is None:
        raise ValueError("--out DIR is needed: it gets the C files")
    configure(precision="double", cache="default")
    from tuning.app import export_folder

    check_folder(options.out)
    export_folder.check_folder(options.out)
    gains, scenario = read_gains(options.gains), read_scenario(options.scenario)
    prepared = prepare(options.loop, options.words, gains, scenario)
    form = export_folder.CForm(options.precision == "single", options.axis, options.prefix)
    manifest = export_folder.export(prepared.case, options.out, form)
    for note in prepared.notes:
        warn(note)
    print(f"{manifest['law']}, axes {', '.join(manifest['axes'])}, {options.precision} precision")
    files = ", ".join(manifest["files"])
    print(f"{files}: {options.out}/  (make check there replays {manifest['ticks']} ticks)")
