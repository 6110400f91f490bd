"""Studies of the user's own: Python files that the environment variable ``JAXSTAGE_STUDIES`` names.

Each file holds ``study``, a `Study`; several files are separated as in ``PATH``. Their loops are
found by name like the published ones, in every process that has the variable.
"""

import functools
import hashlib
import importlib.util
import os
import sys
import traceback
from pathlib import Path

from jaxstage.studies.study import Study

#: the environment variable
VARIABLE = "JAXSTAGE_STUDIES"


def own_files() -> tuple[Path, ...]:
    """The files that the variable names."""
    names = os.environ.get(VARIABLE, "").split(os.pathsep)
    return tuple(Path(name).expanduser().resolve() for name in names if name.strip())


def own_studies() -> tuple[Study, ...]:
    """Their studies. Raises ValueError in one line for a file that cannot be used.

    A file may build published loops while it is read: its own do not count until then.
    """
    return tuple(_load(file) for file in own_files() if not _begun(file))


def file_digest(loop: str) -> str | None:
    """16 digits of the SHA-256 of the file that holds a loop; None for a published one."""
    for file in own_files():
        if any(entry.name == loop for entry in _load(file).loops):
            return hashlib.sha256(file.read_bytes()).hexdigest()[:16]
    return None


def _name(file: Path) -> str:
    return f"jaxstage_own_{file.stem}"


def _begun(file: Path) -> bool:
    """Whether the file is being read."""
    module = sys.modules.get(_name(file))
    return module is not None and not hasattr(module, "study")


@functools.cache
def _load(file: Path) -> Study:
    name = _name(file)
    spec = importlib.util.spec_from_file_location(name, file)
    if not file.is_file() or spec is None or spec.loader is None:
        raise ValueError(f"{VARIABLE}: {file} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where dataclasses look up what a class refers to
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        raise ValueError(f"{VARIABLE}: {_place(file, error)}: {_said(error)}") from error
    study = getattr(module, "study", None)
    if not isinstance(study, Study):
        del sys.modules[name]
        raise ValueError(f"{VARIABLE}: {file}: must hold study = Study(...)")
    return study


def _place(file: Path, error: Exception) -> str:
    """``file:line`` of an error, as far as it lies in the file."""
    if isinstance(error, SyntaxError):
        return f"{file}:{error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(file)]
    return f"{file}:{lines[-1]}" if lines else str(file)


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {error.msg if isinstance(error, SyntaxError) else error}"
