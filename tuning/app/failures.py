"""What a command that cannot go on says: one line on standard error, and an exit status."""

import warnings
from typing import Any

from tuning.app.messages import warn

#: exit status of a wrong use, and of a command that was stopped from the keyboard
REFUSED, INTERRUPTED = 2, 130


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


def is_of_jax(error: RuntimeError) -> bool:
    """Whether the backend of JAX did not start, or ran out of memory."""
    from jax.errors import JaxRuntimeError

    return isinstance(error, JaxRuntimeError) or "Unable to initialize backend" in str(error)


def show_warnings_in_one_line() -> None:
    """Warnings of libraries are told as ours are, without their source."""

    def show(message: Warning | str, *place: Any) -> None:
        warn(message)

    warnings.showwarning = show
