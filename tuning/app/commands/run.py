"""``jaxstage run``: one closed-loop simulation."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import typer

from tuning.app.shared_options import AsJson, Force, GainsFile, Loop, Precision, ScenarioFile


@dataclass(frozen=True)
class RunOptions:
    """What ``jaxstage run`` takes."""

    loop: Loop
    words: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="A gain, plant value, size of the motion or timing, in SI: gains.c1=2, "
            "plant.mass=0.0035,0.003, nominal.mass=0.003, reference.radius=0.01, lap_time=1, "
            "laps=1, scored=1, dt=2e-5, substeps=2, feed=1800 (mm/min). One value, or one per "
            "axis. Repeatable.",
        ),
    ] = field(default_factory=list)
    gains: GainsFile = None
    scenario: ScenarioFile = None
    duration: Annotated[
        float | None, typer.Option(help="Length of the run in s, in place of laps.")
    ] = None
    precision: Precision = "double"
    force: Force = False
    as_json: AsJson = False
    out: Annotated[
        Path | None, typer.Option(help="Folder for pictures, run.json, gains.toml, scenario.toml.")
    ] = None


def run(options: RunOptions) -> None:
    """Simulate one loop: verdict, metrics, pictures."""
    from jaxstage.model.fields import replace
    from jaxstage.system.runtime import configure
    from tuning.app.messages import print_json, warn
    from tuning.store.gains_file import read_gains
    from tuning.store.prepare import check_folder, execute, prepare, refuse_rough
    from tuning.store.work_folder import locked
    from tuning.uncertainty.scenario_file import read_scenario

    duration = options.duration
    configure(precision=options.precision, cache="default")
    asked = (
        options.loop,
        options.words,
        read_gains(options.gains),
        read_scenario(options.scenario),
        lambda timing: timing if duration is None else replace(timing, duration=duration),
    )
    if options.precision == "single" and not options.force:
        refuse_rough(*asked)
    prepared = prepare(*asked)
    if options.out is not None:
        check_folder(options.out)
    with locked(options.out, "running"):
        result = execute(prepared, options.out)
    for note in result["notes"]:
        warn(note)
    if options.as_json:
        print_json(result)
        return
    _show(prepared.entry.summary, result)
    if options.out is not None:
        print(f"pictures, run.json, gains.toml, scenario.toml: {options.out}/")


def _show(title: str, result: dict[str, Any]) -> None:
    """Print verdict and metrics: per axis where they exist, scored window and whole run."""
    from tuning.app.reports.run import metrics
    from tuning.app.result_table import say, show

    say(f"{result['loop']}  {title}", "bold")
    say(result["verdict"])
    laps = f"{result['laps']:.4g} lap{'' if result['laps'] == 1 else 's'}"
    say(
        f"{result['duration_s']:g} s, {laps} of {result['lap_time_s']:.4g} s, "
        f"control period {result['dt_s'] * 1e6:g} us, {result['precision']} precision"
    )
    if result["finite"]:
        show(metrics(result))
