"""The command line: ``jaxstage list``, ``run``, ``compare``, ``sweep``, ``replay``, ..."""

import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from tuning.sweeps import cli as sweep_cli

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Differentiable, batched simulation of CNC feed drives.",
)


def main() -> None:
    """Entry point. A wrong use prints one line on standard error and exits with status 2."""
    # XLA logs an error for every cached program, over tuning flags that no machine lists
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    try:
        sys.exit(app(standalone_mode=False))
    except TyperException as error:
        message = error.format_message() if hasattr(error, "format_message") else str(error)
        _fail(message)
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(130)
    except (ValueError, OSError) as error:
        _fail(str(error))


def _fail(message: str) -> None:
    print(f"jaxstage: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False):
    if version:
        from jaxstage import __version__

        print(__version__)
        raise typer.Exit()


@app.command("list")
def list_loops() -> None:
    """The published systems: loops, references, claims with their verdicts."""
    from rich.console import Console
    from rich.table import Table

    from jaxstage.studies import all_studies
    from jaxstage.studies.claim import count
    from jaxstage.studies.comparison import stored_verdicts

    console = Console(highlight=False)
    for study in all_studies:
        verdicts = ", ".join(f"{n} {v}" for v, n in count(stored_verdicts(study)).items())
        console.print(f"[bold]{study.name}[/bold]  {study.title}")
        console.print(f"  {study.source}")
        console.print(f"  references: {', '.join(study.references)}")
        console.print(f"  claims: {verdicts}  (jaxstage compare {study.name})")
        table = Table(box=None, show_header=False, padding=(0, 2))
        for entry in study.loops:
            table.add_row(entry.name, entry.summary)
        console.print(table)


@app.command()
def run(
    loop: Annotated[str, typer.Argument(help="A loop of `jaxstage list`, e.g. dfcmac-circle.")],
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="A gain, plant value or timing, in SI: gains.c1=2, plant.mass=0.0035,0.003, "
            "nominal.mass=0.003, lap_time=1, laps=1, scored=1, dt=2e-5, substeps=2, feed=1800 "
            "(mm/min). One value, or one per axis. Repeatable.",
        ),
    ] = None,
    gains: Annotated[Path | None, typer.Option(help="TOML file of gains.")] = None,
    scenario: Annotated[Path | None, typer.Option(help="TOML file of a scenario.")] = None,
    duration: Annotated[
        float | None, typer.Option(help="Length of the run in s, in place of laps.")
    ] = None,
    precision: Annotated[str, typer.Option(help="double or single.")] = "double",
    force: Annotated[
        bool, typer.Option("--force", help="Single precision also where it is off by over 1 %.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for pictures, run.json, gains.toml, scenario.toml.")
    ] = None,
) -> None:
    """Simulate one loop: verdict, metrics, pictures."""
    from jaxstage.runtime import configure
    from tuning import runs

    configure(precision=precision, cache="default")
    if precision == "single" and not force:
        runs.refuse_rough(loop)
    prepared = runs.prepare(loop, set_ or [], gains, scenario, duration)
    if out is not None:
        runs.check_folder(out)
    result = runs.execute(prepared, out)
    _print_result(prepared.entry.summary, result, as_json, out)


@app.command()
def compare(
    study: Annotated[str, typer.Argument(help="A study of `jaxstage list`, e.g. fuzzy-cmac.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for claims.png, the figures, compare.json.")
    ] = None,
    verdicts: Annotated[
        bool, typer.Option("--verdicts", help="Print claim = verdict as TOML, nothing else.")
    ] = False,
) -> None:
    """What a paper claims, what this simulation gives, and a computed verdict on each claim."""
    from jaxstage.runtime import configure, cpu_cores

    configure(precision="double", cores=cpu_cores(), cache="default")
    from jaxstage.studies import compare as compare_study
    from tuning import comparisons, runs

    chosen = comparisons.find_study(study)
    if out is not None:
        runs.check_folder(out)
    quiet = as_json or verdicts
    compared = compare_study(chosen, lambda text: print(f"simulating {text}", file=sys.stderr))
    if verdicts:
        import tomli_w

        print(tomli_w.dumps({j.id: j.verdict for j in compared.claims}), end="")
    if as_json:
        print(json.dumps(comparisons.as_object(compared), indent=2, allow_nan=False))
    if not quiet:
        comparisons.show(compared, None if sys.stdout.isatty() else 200)
    if out is not None:
        files = comparisons.draw(compared, out)
        if not quiet:
            print(f"{', '.join(file.name for file in files)}, compare.json: {out}/")


@app.command()
def doctor(
    loop: Annotated[
        str | None, typer.Argument(help="A loop: is it compiled for this processor, and why not?")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    precision: Annotated[str, typer.Option(help="double or single.")] = "double",
) -> None:
    """What this machine gives: devices, cores, precision, cache, a one-second speed test.

    With a loop: the kernels that the engine builds of it, or the reason why it does not.
    """
    from jaxstage.runtime import configure, cpu_cores

    configure(precision=precision, cores=cpu_cores(), cache="default")
    from tuning.doctor import examine, explained

    if loop is not None:
        found, text = explained(loop)
        print(json.dumps(found, indent=2, allow_nan=False) if as_json else text)
        return
    found = examine()
    if as_json:
        print(json.dumps(found, indent=2, allow_nan=False))
        return
    for name, value in found.items():
        text = f"{value:.3g}" if isinstance(value, float) else value
        print(f"{name:18s}{', '.join(value) if isinstance(value, list) else text}")


@app.command()
def precision(
    loops: Annotated[
        list[str] | None, typer.Argument(help="Loops to compare; all if left out.")
    ] = None,
) -> None:
    """Single against double precision: relative difference of the headline figures, as TOML."""
    import tomli_w

    from jaxstage.runtime import configure
    from jaxstage.studies import build, find, loop_names
    from jaxstage.studies.precision import compare_precision

    configure(precision="double", cache="default")
    for name in loops or []:
        find(name)
    for name in loops or loop_names():
        table = {k: float(f"{v:.2e}") for k, v in compare_precision(build(name)).items()}
        print(tomli_w.dumps({name: table}), flush=True)


@app.command()
def export(
    loop: Annotated[str, typer.Argument(help="A loop of `jaxstage list`, e.g. dfcmac-circle.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the C files; a new one.")] = None,
    lang: Annotated[str, typer.Option(help="c: C99.")] = "c",
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="As for `jaxstage run`. Repeatable."),
    ] = None,
    gains: Annotated[Path | None, typer.Option(help="TOML file of gains.")] = None,
    scenario: Annotated[Path | None, typer.Option(help="TOML file of a scenario.")] = None,
    precision: Annotated[
        str, typer.Option(help="Of the C text: double, or single for float.")
    ] = "double",
    axis: Annotated[
        str | None, typer.Option(help="One axis, e.g. x; the whole controller if left out.")
    ] = None,
    prefix: Annotated[str, typer.Option(help="Begins every name in C.")] = "control",
) -> None:
    """The controller as C99 for a drive, with recorded ticks to check it by."""
    from jaxstage.runtime import configure
    from tuning import runs

    if lang != "c":
        raise ValueError(f"--lang {lang}: must be c")
    if precision not in ("single", "double"):
        raise ValueError(f"--precision {precision}: must be single or double")
    if out is None:
        raise ValueError("--out DIR is needed: it gets the C files")
    configure(precision="double", cache="default")
    from tuning import exports

    runs.check_folder(out)
    exports.check_folder(out)
    prepared = runs.prepare(loop, set_ or [], gains, scenario)
    made = exports.export(prepared.case, out, precision == "single", axis, prefix)
    for note in prepared.notes:
        print(f"jaxstage: {note}", file=sys.stderr)
    print(f"{made['law']}, axes {', '.join(made['axes'])}, {precision} precision")
    print(f"{', '.join(made['files'])}: {out}/  (make check there replays {made['ticks']} ticks)")


app.command()(sweep_cli.sweep)
app.command()(sweep_cli.replay)


def _print_result(title: str, result: dict[str, Any], as_json: bool, out: Path | None) -> None:
    for note in result["notes"]:
        print(f"jaxstage: {note}", file=sys.stderr)
    if as_json:
        print(json.dumps(result, indent=2, allow_nan=False))
        return
    from tuning.display import show

    show(title, result)
    if out is not None:
        print(f"pictures, run.json, gains.toml, scenario.toml: {out}/")
