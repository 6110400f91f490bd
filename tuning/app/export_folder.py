"""A loop's controller as a folder of C files: recorded, written, never over what is not ours."""

import hashlib
import json
from pathlib import Path
from typing import Any, NamedTuple

import jax

from jaxstage import __version__
from jaxstage.c_export.export import c_files, check_names
from jaxstage.metrics import record
from jaxstage.model.signals import Sample
from jaxstage.simulate.rollout import simulate
from jaxstage.studies import Case, with_metric
from jaxstage.system.files import write_text

#: ticks of the closed loop that the C text is checked with
TICKS = 1000

#: what was exported, and the checksums of its files: the sign of a folder of ours
MANIFEST = "export.json"


def recorded(case: Case, ticks: int = TICKS) -> Sample:
    """The first ticks of a case, up to where it is lost. Raises ValueError if that is at once."""
    loop = with_metric(case, record).loop
    run = simulate(loop, case.gains, case.scenario, case.path, min(ticks, case.window.ticks))
    ends = [int(at) for at in (run.final.left_path_at, run.final.non_finite_at) if int(at) >= 0]
    if 0 in ends:
        raise ValueError(f"{case.name} is lost at its first tick: nothing to check the C text with")
    return jax.tree.map(lambda row: row[: min(ends)], run.rows) if ends else run.rows


class CForm(NamedTuple):
    """How the C text is written. single: in float; axis: only this one; prefix: of every name."""

    single: bool
    axis: str | None
    prefix: str


def export(case: Case, out: Path, form: CForm) -> dict[str, Any]:
    """Write the controller of a case as C99 into a folder.

    Returns:
        What the manifest says.

    Raises:
        ValueError: for what `c_files` refuses and for a folder that is not ours.
    """
    check_names(case.loop, form.axis, form.prefix)
    rows = recorded(case)
    files = c_files(
        case.name,
        case.loop,
        case.gains,
        case.scenario,
        rows,
        __version__,
        **form._asdict(),
    )
    manifest = {
        "loop": case.name,
        "law": case.loop.controller.name,
        "version": __version__,
        "language": "C99",
        "precision": "single" if form.single else "double",
        "axes": [form.axis] if form.axis else list(case.loop.plant.axes),
        "period_s": case.loop.dt,
        "prefix": form.prefix,
        "ticks": len(rows.demand),
        "files": {name: _checksum(text.encode()) for name, text in files.items()},
    }
    write(out, files, manifest)
    return manifest


def check_folder(out: Path, names: list[str] | None = None) -> dict[str, str]:
    """The checksums of an earlier export in a folder; empty where there is nothing.

    names: of the files that are going to be written. Raises ValueError where a folder that is not
    empty was not made by an export, and where a file would be lost.
    """
    if not out.is_dir() or not any(out.iterdir()):
        return {}
    try:
        sums = json.loads((out / MANIFEST).read_text(encoding="utf-8"))["files"]
        known = {str(name): str(value) for name, value in sums.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise ValueError(
            f"--out {out}: the folder is not empty and holds no export; choose another one"
        ) from None
    for name in {*(names or ()), *known}:
        file = out / name
        if file.exists() and _checksum(file.read_bytes()) != known.get(name):
            raise ValueError(
                f"--out {out}: {name} is not as it was exported; move it away, or choose another "
                "folder"
            )
    return known


def write(out: Path, files: dict[str, str], manifest: dict[str, Any]) -> None:
    """Write the files of an export in place of those of an earlier one."""
    known = check_folder(out, list(files))
    out.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        write_text(out / name, text)
    write_text(out / MANIFEST, json.dumps(manifest, indent=2) + "\n")
    for name in known.keys() - files.keys():
        (out / name).unlink(missing_ok=True)


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
