"""``jaxstage replay``: single plants of a sweep again."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from tuning.app.shared_options import AsJson


@dataclass(frozen=True)
class ReplayOptions:
    """What ``jaxstage replay`` takes."""

    folder: Annotated[Path, typer.Argument(help="Folder of a sweep.")]
    run: Annotated[int | None, typer.Option(help="Number of the run.")] = None
    worst: Annotated[int | None, typer.Option(help="The so many worst runs.")] = None
    loop: Annotated[str | None, typer.Option(help="Only this loop of the sweep.")] = None
    metric: Annotated[str | None, typer.Option(help="What --worst goes by.")] = None
    out: Annotated[
        Path | None, typer.Option(help="Folder for pictures, gains.toml, scenario.toml a run.")
    ] = None
    as_json: AsJson = False


def replay(options: ReplayOptions) -> None:
    """Plants of a sweep again, held against their rows."""
    from jaxstage.system.runtime import configure
    from tuning.app.messages import print_json
    from tuning.store.prepare import check_folder
    from tuning.sweeps import configuration, replays, store

    folder, out = options.folder, options.out
    text = store.read_configuration(folder)
    if (options.run is None) == (options.worst is None):
        raise ValueError("give --run ID or --worst K")
    if out is not None:
        check_folder(out)
    precision = configuration.precision_of(text)
    configure(precision=precision, cores=replays.stored_devices(folder), cache="default")
    plan = configuration.build(text)
    chosen = replays.RunSelection(options.run, options.worst, options.loop, options.metric)
    selected = replays.select_runs(folder, plan, chosen)
    rows = [row for number, ids in selected for row in replays.replay(folder, plan, number, ids)]
    if out is not None:
        for number, run in ((number, run) for number, ids in selected for run in ids):
            name = plan.table["loop"][number]["name"]
            replays.draw_run(plan, number, run, out / f"{name}-run-{run}")
    if options.as_json:
        print_json({"sweep": str(folder), "runs": rows})
        return
    from tuning.app.sweep_display import show_replayed

    show_replayed(rows, out)
