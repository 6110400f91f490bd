"""One call of the command line in this process, and what is wrong with how it ended."""

import contextlib
import io
import json
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType

from tuning.app import main

#: longest time that a call may take, s
LIMIT = 60
#: what a call may end with: done, interrupted by itself, refused
STATUSES = (0, 1, 2)
#: parts of names of files that must not be left behind
HALF_WRITTEN = (".partial", ".tmp")


class HangError(BaseException):
    """The call took longer than `LIMIT`; no handler of the program may catch it."""


@contextlib.contextmanager
def limited(seconds: int = LIMIT) -> Iterator[None]:
    """Raise `HangError` after so many seconds."""

    def late(number: int, frame: FrameType | None) -> None:
        raise HangError(f"longer than {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def call(words: Sequence[str]) -> tuple[int, str, str]:
    """Status, standard output and standard error of ``jaxstage WORDS``. Lets everything through."""
    out, err = io.StringIO(), io.StringIO()
    argv, show = sys.argv, warnings.showwarning
    sys.argv = ["jaxstage", *words]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), limited():
            try:
                status = main.call()
            except SystemExit as stopped:
                status = stopped.code if isinstance(stopped.code, int) else 1
    finally:
        sys.argv, warnings.showwarning = argv, show
    return status, out.getvalue(), err.getvalue()


def faults(words: Sequence[str], folder: Path) -> tuple[str, list[str]]:
    """How a call ended (``done``, ``refused``), and what is wrong with it.

    Wrong are: an exception, a status that no command has, a refusal that is not one line, output of
    ``--json`` that is no JSON or has a number that is none, a file left half-written, a hang.
    """
    before = os.getcwd()
    os.chdir(folder)
    wrong = []
    try:
        status, out, err = call(words)
    except HangError as error:
        return "hang", [f"hang: {error}"]
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        text = traceback.format_exc().strip().splitlines()
        place = next((x.strip() for x in reversed(text) if x.strip().startswith("File")), "")
        return "traceback", [f"traceback: {type(error).__name__}: {str(error)[:200]} {place}"]
    finally:
        os.chdir(before)
    if status not in STATUSES:
        wrong.append(f"status {status}: {err.strip()[-200:]}")
    if "Traceback" in err:
        wrong.append(f"traceback printed: {err.strip()[-200:]}")
    if status == 2:
        last = err.strip().splitlines()[-1:]
        if not last or not last[0].strip():
            wrong.append("a refusal without a line")
        if out.strip().startswith("{"):
            wrong.append("a refusal with an object on standard output")
    if status == 0 and "--json" in words:
        wrong += not_numbers(out)
    wrong += [f"left half-written: {f.name}" for f in folder.rglob("*") if _half(f)]
    return ("done" if status == 0 else "refused"), wrong


def _half(file: Path) -> bool:
    return any(part in file.name for part in HALF_WRITTEN)


def not_numbers(text: str) -> list[str]:
    """What is wrong with an object that ``--json`` printed."""

    def refuse(word: str) -> float:
        raise ValueError(f"silent {word}")

    try:
        json.loads(text, parse_constant=refuse)
    except ValueError as error:
        return [f"json: {error}"]
    return []
