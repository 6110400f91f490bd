"""What a command that cannot go on says: one line on standard error, and an exit status."""

import os
import sysconfig
import traceback
import warnings
from pathlib import Path
from typing import Any

from tuning.app.messages import warn

#: exit status of a wrong use; of a fault of ours; of a command that was stopped from the keyboard;
#: of one whose reader went away (``| head``)
REFUSED, FAULT, INTERRUPTED, NO_READER = 2, 70, 130, 141
#: the environment variable that shows where a fault of ours is
TRACEBACK = "JAXSTAGE_TRACEBACK"


def refused(message: object) -> int:
    """A wrong use: what is wrong and where. Returns its exit status."""
    warn(message)
    return REFUSED


def interrupted(message: str) -> int:
    """Stopped from the keyboard: how the work goes on. Returns its exit status."""
    warn(f"interrupted; {message}")
    return INTERRUPTED


def file_failed(error: OSError) -> int:
    """A file that cannot be read or written. Returns its exit status."""
    place = f"{error.filename}: " if error.filename else ""
    return refused(f"{place}{error.strerror or error}")


def failed(error: Exception) -> int:
    """Any other error: a wrong use where it was raised to say so, else a fault of ours.

    A ValueError is a refusal where our code or that of a user's study raised it. What a library
    raises should have been refused before, with a better message. Returns the exit status.
    """
    if isinstance(error, MemoryError):
        return refused(f"out of memory: {str(error) or 'simulate less at once'}")
    if isinstance(error, ValueError) and not _raised_by_library(error):
        return refused(error)
    if isinstance(error, RuntimeError) and _is_of_jax(error):
        return refused(error)
    if os.environ.get(TRACEBACK):
        traceback.print_exception(error)
    warn(
        f"{type(error).__name__}: {error}; this is a fault of jaxstage, please report it "
        f"({TRACEBACK}=1 in the environment shows where it is)"
    )
    return FAULT


def _raised_by_library(error: Exception) -> bool:
    """Whether the line that raised an error belongs to a library, the one of Python included."""
    frames = traceback.extract_tb(error.__traceback__)
    if not frames:
        return False
    file = Path(frames[-1].filename)
    ours = [Path(__file__).parents[2] / name for name in ("jaxstage", "tuning")]
    if any(file.is_relative_to(folder) for folder in ours):
        return False
    paths = sysconfig.get_paths()
    return any(file.is_relative_to(paths[name]) for name in ("stdlib", "purelib", "platlib"))


def _is_of_jax(error: RuntimeError) -> bool:
    """Whether the backend of JAX did not start, or ran out of memory."""
    from jax.errors import JaxRuntimeError

    return isinstance(error, JaxRuntimeError) or "Unable to initialize backend" in str(error)


def show_warnings_in_one_line() -> None:
    """Warnings of libraries are told as ours are, without their source."""

    def show(message: Warning | str, *place: Any) -> None:
        warn(message)

    warnings.showwarning = show
