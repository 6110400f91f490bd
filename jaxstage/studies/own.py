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

from jaxstage.model.fields import replace
from jaxstage.studies.case import Case, Timing
from jaxstage.studies.claim import Claim
from jaxstage.studies.experiment import Experiment
from jaxstage.studies.plots import ChartPlot, RunPlot
from jaxstage.studies.study import Box, NamedLoop, Spread, Study

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
        study = _checked(file, getattr(module, "study", None))
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise _refusal(file, error) from error
    loops = tuple(
        replace(entry, build=functools.partial(_build, file, entry)) for entry in study.loops
    )
    return replace(study, loops=loops)


#: field of a study -> what it holds; fields of these that are text
PARTS = {"loops": NamedLoop, "spreads": Spread, "boxes": Box, "references": str}
PARTS |= {"experiments": Experiment, "claims": Claim, "plots": (ChartPlot, RunPlot)}
TEXTS = ("name", "title", "source", "summary", "path", "reason")


def _checked(file: Path, study: object) -> Study:
    """The study of a file. Raises ValueError for a part that is not of its kind."""
    if not isinstance(study, Study):
        raise ValueError("must hold study = Study(...)")
    for field, kind in PARTS.items():
        parts = getattr(study, field)
        if not isinstance(parts, tuple | list) or not all(isinstance(p, kind) for p in parts):
            kinds = kind if isinstance(kind, tuple) else (kind,)
            told = " or ".join(one.__name__ for one in kinds)
            raise ValueError(f"{field} of the study = {parts!r}: must be a tuple of {told}")
    for part in (study, *study.loops, *study.spreads, *study.boxes):
        for field in TEXTS:
            value = getattr(part, field, "")
            if not isinstance(value, str):
                kind = type(part).__name__
                raise ValueError(f"{field} of a {kind} = {value!r}: must be text")
    for entry in study.loops:
        if not callable(entry.build):
            raise ValueError(f"build of {entry.name} = {entry.build!r}: must be a function")
        if not isinstance(entry.timing, Timing):
            raise ValueError(f"timing of {entry.name} = {entry.timing!r}: must be a Timing")
    return replace(study, **{field: tuple(getattr(study, field)) for field in PARTS})


def _build(file: Path, entry: NamedLoop, timing: Timing) -> Case:
    """The case of a loop of a file. Raises ValueError where its ``build`` fails or gives none."""
    try:
        case = entry.build(timing)
    except ValueError:
        raise
    except (Exception, SystemExit) as error:
        raise _refusal(file, error) from error
    if not isinstance(case, Case):
        told = f"build of {entry.name} gives {case!r:.60}: must be a Case"
        raise ValueError(f"{VARIABLE}: {file}: {told}")
    return case


def _refusal(file: Path, error: BaseException) -> ValueError:
    return ValueError(f"{VARIABLE}: {_place(file, error)}: {_said(error)}")


def _place(file: Path, error: BaseException) -> str:
    """``file:line`` of an error, as far as it lies in the file."""
    if isinstance(error, SyntaxError):
        return f"{file}:{error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(file)]
    return f"{file}:{lines[-1]}" if lines else str(file)


def _said(error: BaseException) -> str:
    """What went wrong, in one line; our own words as they are."""
    told = " ".join(str(error.msg if isinstance(error, SyntaxError) else error).split())
    return told if type(error) is ValueError else f"{type(error).__name__}: {told}"
