"""The command line: ``jaxstage demo``, ``list``, ``run``, ``compare``, ``tune``, ``sweep``, ..."""

import io
import os
import sys
from typing import Annotated

import typer
from typer.exceptions import TyperException

from tuning.app.commands.compare import compare
from tuning.app.commands.demo import demo
from tuning.app.commands.doctor import doctor
from tuning.app.commands.export import export
from tuning.app.commands.frequency import frequency
from tuning.app.commands.list import list_loops
from tuning.app.commands.precision import precision
from tuning.app.commands.replay import replay
from tuning.app.commands.report import report
from tuning.app.commands.run import run
from tuning.app.commands.sweep import sweep
from tuning.app.commands.tune import tune
from tuning.app.failures import (
    INTERRUPTED,
    NO_READER,
    failed,
    file_failed,
    interrupted,
    refused,
    show_warnings_in_one_line,
)
from tuning.app.shared_options import add_command

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
    "frequency": "jaxstage frequency cascade-circle --at 0.05",
    "export": "jaxstage export pi-circle --precision single --out c",
    "report": "jaxstage report swept",
    "doctor": "jaxstage doctor",
}
BODIES = (
    demo,
    list_loops,
    run,
    compare,
    precision,
    sweep,
    replay,
    tune,
    frequency,
    export,
    report,
    doctor,
)

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Differentiable, batched simulation of CNC feed drives.",
)
for (name, example), body in zip(EXAMPLES.items(), BODIES, strict=True):
    add_command(app, name, body, example)


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False):
    if version:
        from jaxstage import __version__

        print(__version__)
        raise typer.Exit()


def main() -> None:
    """Entry point: `call`, and the end of this process."""
    for stream in (sys.stdout, sys.stderr):  # a terminal without a letter gets its number
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    status = call()
    try:
        sys.stdout.flush()
    except OSError as error:
        status = NO_READER if isinstance(error, BrokenPipeError) else file_failed(error)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the flush at the end
    if status == INTERRUPTED:
        os._exit(status)  # a simulation still runs in a thread of XLA: an ordinary end crashes
    sys.exit(status)


def call() -> int:
    """Run the command that this process was called with.

    Returns:
        The exit status. A wrong use prints one line on standard error, and its status is 2; so does
        a fault of ours, with status 70.
    """
    # XLA logs an error for every cached program, over tuning flags that no machine lists
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    os.environ.setdefault("JAX_TRACEBACK_FILTERING", "off")  # which line raised an error
    show_warnings_in_one_line()
    words = sys.argv[1:] or ["--help"]
    try:
        _refuse_unknown(words[0])
        status = app(words, standalone_mode=False, prog_name="jaxstage") or 0
    except TyperException as error:
        return refused(error.format_message() if hasattr(error, "format_message") else error)
    except InterruptedError as error:  # the command says how to go on
        return interrupted(str(error))
    except (KeyboardInterrupt, typer.Abort):
        status = INTERRUPTED
    except SystemExit as stopped:  # so Typer ends where nobody reads on
        if not isinstance(stopped.__context__, BrokenPipeError):
            raise
        return NO_READER
    except OSError as error:
        return file_failed(error)
    except Exception as error:
        return failed(error)
    return interrupted("every file is whole or absent") if status == INTERRUPTED else status


def _refuse_unknown(command: str) -> None:
    if command not in EXAMPLES and not command.startswith("-"):
        from jaxstage.model.settings import nearest_name

        hint = nearest_name(command, EXAMPLES)
        raise ValueError(f"unknown command '{command}'{hint} (`jaxstage --help` shows all)")
