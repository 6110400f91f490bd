"""The command line: ``jaxstage demo``, ``list``, ``run``, ``compare``, ``tune``, ``sweep``, ..."""

import json
import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from tuning.app import completion
from tuning.app import sweep_command as sweep_cli
from tuning.app import tune_command as tune_cli

#: exit status of a command that was stopped from the keyboard
INTERRUPTED = 130
#: what ``--help`` of each command ends with
EXAMPLES = {
    "demo": "jaxstage demo --out shown",
    "list": "jaxstage list",
    "run": "jaxstage run dfcmac-circle --set lap_time=1 --set laps=1 --out out",
    "compare": "jaxstage compare fuzzy-cmac --out compared",
    "precision": "jaxstage precision pi-circle",
    "sweep": "jaxstage sweep pi-circle cascade-circle -n 64 --set lap_time=1 --set laps=1 "
    '--spec "contour_max_um < 60 and finite" --target 0.5 --out swept',
    "replay": "jaxstage replay swept --worst 1",
    "tune": "jaxstage tune pi-circle --budget 60 --out tuned",
    "export": "jaxstage export pi-circle --precision single --out c",
    "report": "jaxstage report swept",
    "doctor": "jaxstage doctor",
}


def _example(command: str) -> str:
    return f"Example: {EXAMPLES[command]}"


app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Differentiable, batched simulation of CNC feed drives.",
)


def main() -> None:
    """Entry point: `call`, and the end of this process."""
    status = call()
    if status == INTERRUPTED:
        with suppress(OSError):
            sys.stdout.flush()
        os._exit(status)  # a simulation still runs in a thread of XLA: an ordinary end crashes
    sys.exit(status)


def call() -> int:
    """Run the command that this process was called with; returns the exit status.

    A wrong use prints one line on standard error, and its status is 2.
    """
    # XLA logs an error for every cached program, over tuning flags that no machine lists
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    warnings.showwarning = _warn
    words = sys.argv[1:] or ["--help"]
    try:
        _refuse_unknown(words[0])
        status = app(words, standalone_mode=False, prog_name="jaxstage") or 0
    except TyperException as error:
        return _refused(error.format_message() if hasattr(error, "format_message") else str(error))
    except InterruptedError as error:  # the command says how to go on
        return _interrupted(str(error))
    except (KeyboardInterrupt, typer.Abort):
        status = INTERRUPTED
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _refused(f"{place}{error.strerror or error}")
    except ValueError as error:
        return _refused(str(error))
    except RuntimeError as error:
        if not is_of_jax(error):
            raise
        return _refused(str(error))
    return _interrupted("every file is whole or absent") if status == INTERRUPTED else status


def _refuse_unknown(command: str) -> None:
    if command not in EXAMPLES and not command.startswith("-"):
        from jaxstage.model.settings import nearest_name

        hint = nearest_name(command, EXAMPLES)
        raise ValueError(f"unknown command '{command}'{hint} (`jaxstage --help` shows all)")


def is_of_jax(error: RuntimeError) -> bool:
    """Whether the backend of JAX did not start, or ran out of memory."""
    from jax.errors import JaxRuntimeError

    return isinstance(error, JaxRuntimeError) or "Unable to initialize backend" in str(error)


def _refused(message: str) -> int:
    print(f"jaxstage: {' '.join(message.split())}", file=sys.stderr)
    return 2


def _interrupted(message: str) -> int:
    print(f"jaxstage: interrupted; {message}", file=sys.stderr)
    return INTERRUPTED


def _warn(message: Warning | str, *place: Any) -> None:
    """A warning of a library, in one line and without its source."""
    print(f"jaxstage: {' '.join(str(message).split())}", file=sys.stderr)


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False):
    if version:
        from jaxstage import __version__

        print(__version__)
        raise typer.Exit()


@app.command(epilog=_example("demo"))
def demo(
    out: Annotated[
        Path, typer.Option(help="Folder of the demo; the same again goes on with it.")
    ] = Path("demo"),
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Two laws tuned and tested on other plants, one report."""
    from tuning.app.demo.cli import demo as run_demo

    def call(words: Sequence[str]) -> None:
        if app(list(words), standalone_mode=False) == INTERRUPTED:
            raise KeyboardInterrupt

    run_demo(out, as_json, call)


@app.command("list", epilog=_example("list"))
def list_loops() -> None:
    """Loops, references and verdicts of all systems, yours too."""
    from rich.console import Console
    from rich.table import Table

    from jaxstage.studies import known_studies, stored_verdicts
    from jaxstage.studies.claim import count

    console = Console(highlight=False)
    for study in known_studies():
        console.print(f"[bold]{study.name}[/bold]  {study.title}")
        console.print(f"  {study.source}")
        if study.references:
            console.print(f"  references: {', '.join(study.references)}")
        if study.claims:
            verdicts = ", ".join(f"{n} {v}" for v, n in count(stored_verdicts(study)).items())
            console.print(f"  claims: {verdicts}  (jaxstage compare {study.name})")
        table = Table(box=None, show_header=False, padding=(0, 2))
        for entry in study.loops:
            table.add_row(entry.name, entry.summary)
        console.print(table)


@app.command(epilog=_example("run"))
def run(
    loop: Annotated[
        str,
        typer.Argument(
            help="A loop of `jaxstage list`, e.g. dfcmac-circle.", autocompletion=completion.loops
        ),
    ],
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="A gain, plant value, size of the motion or timing, in SI: gains.c1=2, "
            "plant.mass=0.0035,0.003, nominal.mass=0.003, reference.radius=0.01, lap_time=1, "
            "laps=1, scored=1, dt=2e-5, substeps=2, feed=1800 (mm/min). One value, or one per "
            "axis. Repeatable.",
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
    from jaxstage.model.fields import replace
    from jaxstage.system.runtime import configure
    from tuning.store import prepare as runs
    from tuning.store.gains_file import read_gains
    from tuning.uncertainty.scenario_file import read_scenario

    configure(precision=precision, cache="default")
    if precision == "single" and not force:
        runs.refuse_rough(loop)
    prepared = runs.prepare(
        loop,
        set_ or [],
        read_gains(gains),
        read_scenario(scenario),
        lambda timing: timing if duration is None else replace(timing, duration=duration),
    )
    if out is not None:
        runs.check_folder(out)
    result = runs.execute(prepared, out)
    _print_result(prepared.entry.summary, result, as_json, out)


@app.command(epilog=_example("compare"))
def compare(
    study: Annotated[
        str,
        typer.Argument(
            help="A study of `jaxstage list`, e.g. fuzzy-cmac.", autocompletion=completion.studies
        ),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for claims.png, the figures, compare.json.")
    ] = None,
    verdicts: Annotated[
        bool, typer.Option("--verdicts", help="Print claim = verdict as TOML, nothing else.")
    ] = False,
    gains: Annotated[
        list[str] | None,
        typer.Option(metavar="LOOP=FILE", help="A loop with these gains, too. Repeatable."),
    ] = None,
) -> None:
    """A paper's claims, each with a computed verdict."""
    from jaxstage.system.runtime import configure, cpu_cores

    configure(precision="double", cores=cpu_cores(), cache="default")
    from jaxstage.studies import compare as compare_study
    from tuning.app import compare_command as comparisons
    from tuning.store import prepare as runs

    chosen = comparisons.find_study(study)
    given = comparisons.gains_files(chosen, gains or [])
    if out is not None:
        runs.check_folder(out)
    others = comparisons.other_gains(given)
    quiet = as_json or verdicts
    compared = compare_study(chosen, lambda text: print(f"simulating {text}", file=sys.stderr))
    if verdicts:
        import tomli_w

        print(tomli_w.dumps({j.id: j.verdict for j in compared.claims}), end="")
    if as_json:
        print(json.dumps(comparisons.as_object(compared, others), indent=2, allow_nan=False))
    if not quiet:
        comparisons.show(compared, None if sys.stdout.isatty() else 200)
        comparisons.show_gains(others)
    if out is not None:
        files = comparisons.draw(compared, out, others)
        if not quiet:
            print(f"{', '.join(file.name for file in files)}, compare.json: {out}/")


@app.command(epilog=_example("report"))
def report(
    folder: Annotated[
        Path, typer.Argument(help="Folder of a run, comparison, sweep, tuning or demo.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="File to write; report.html in the folder if left out.")
    ] = None,
) -> None:
    """One self-contained HTML file of a folder of results."""
    from tuning.app.reports import kinds

    file = out or folder / "report.html"
    if file.exists() and not file.is_file():
        raise ValueError(f"--out {file}: must be a file")
    kinds.write(folder, file)
    print(file)


@app.command(epilog=_example("doctor"))
def doctor(
    loop: Annotated[
        str | None, typer.Argument(help="A loop: is it compiled for this processor, and why not?")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    precision: Annotated[str, typer.Option(help="double or single.")] = "double",
) -> None:
    """What this machine gives, and a one-second speed test.

    With a loop: the kernels that the engine builds of it, or the reason why it does not.
    """
    from jaxstage.system.runtime import configure, cpu_cores

    configure(precision=precision, cores=cpu_cores(), cache="default")
    from tuning.app.doctor import examine, explained

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


@app.command(epilog=_example("precision"))
def precision(
    loops: Annotated[
        list[str] | None,
        typer.Argument(help="Loops to compare; all if left out.", autocompletion=completion.loops),
    ] = None,
) -> None:
    """How far single precision moves the figures, as TOML."""
    import tomli_w

    from jaxstage.studies import build, find, loop_names
    from jaxstage.studies.precision import compare_precision
    from jaxstage.system.runtime import configure

    configure(precision="double", cache="default")
    for name in loops or []:
        find(name)
    for name in loops or loop_names():
        table = {k: float(f"{v:.2e}") for k, v in compare_precision(build(name)).items()}
        print(tomli_w.dumps({name: table}), flush=True)


@app.command(epilog=_example("export"))
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
    """The controller as C99, with recorded ticks to check it."""
    from jaxstage.system.runtime import configure
    from tuning.store import prepare as runs

    if lang != "c":
        raise ValueError(f"--lang {lang}: must be c")
    if precision not in ("single", "double"):
        raise ValueError(f"--precision {precision}: must be single or double")
    if out is None:
        raise ValueError("--out DIR is needed: it gets the C files")
    configure(precision="double", cache="default")
    from tuning.app import export_command as exports
    from tuning.store.gains_file import read_gains
    from tuning.uncertainty.scenario_file import read_scenario

    runs.check_folder(out)
    exports.check_folder(out)
    prepared = runs.prepare(loop, set_ or [], read_gains(gains), read_scenario(scenario))
    made = exports.export(prepared.case, out, precision == "single", axis, prefix)
    for note in prepared.notes:
        print(f"jaxstage: {note}", file=sys.stderr)
    print(f"{made['law']}, axes {', '.join(made['axes'])}, {precision} precision")
    print(f"{', '.join(made['files'])}: {out}/  (make check there replays {made['ticks']} ticks)")


app.command(epilog=_example("tune"))(tune_cli.tune)
app.command(epilog=_example("sweep"))(sweep_cli.sweep)
app.command(epilog=_example("replay"))(sweep_cli.replay)


def _print_result(title: str, result: dict[str, Any], as_json: bool, out: Path | None) -> None:
    for note in result["notes"]:
        print(f"jaxstage: {note}", file=sys.stderr)
    if as_json:
        print(json.dumps(result, indent=2, allow_nan=False))
        return
    from tuning.app.display import show

    show(title, result)
    if out is not None:
        print(f"pictures, run.json, gains.toml, scenario.toml: {out}/")
