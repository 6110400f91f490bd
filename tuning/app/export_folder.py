"""A loop's controller as a folder of C files: recorded, written, never over what is not ours."""

import hashlib
import json
from collections.abc import Iterable, Mapping
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
from tuning.app.messages import json_text
from tuning.store.work_folder import is_leftover, locked

#: ticks of the closed loop that the C text is checked with
TICKS = 1000

#: what was exported, and the checksums of its files: the sign of a folder of ours
MANIFEST = "export.json"
#: its key for the checksums of the files that an unfinished export replaces
REPLACED = "replaced"


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
    with locked(out, "exporting"):
        write(out, files, manifest)
    return manifest


def check_folder(out: Path, names: Iterable[str] = ()) -> dict[str, set[str]]:
    """The files of an earlier export in a folder.

    Args:
        out: the folder.
        names: of the files that are going to be written.

    Returns:
        Name -> checksums it may have: an export that was stopped leaves its own file or that of the
        export before. Empty where there is nothing.

    Raises:
        ValueError: where a folder that is not empty was not made by an export, where its manifest
            names a file elsewhere, and where a file would be lost.
    """
    if not out.is_dir() or all(is_leftover(file) for file in out.iterdir()):
        return {}
    try:
        manifest = json.loads((out / MANIFEST).read_text(encoding="utf-8"))
        known: dict[str, set[str]] = {}
        for sums in (manifest["files"], manifest.get(REPLACED, {})):
            for name, value in sums.items():
                known.setdefault(name, set()).add(value)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        raise ValueError(
            f"--out {out}: the folder is not empty and holds no export; choose another one"
        ) from None
    for name in {*names, *known}:
        if Path(name).name != name or "\\" in name or name in ("", "..", MANIFEST):
            raise ValueError(f"--out {out}: {MANIFEST} names {name!r}, which is no file of it")
        file = out / name
        if (
            file.is_symlink()
            or file.is_dir()
            or (file.exists() and _checksum(file.read_bytes()) not in known.get(name, ()))
        ):
            raise ValueError(
                f"--out {out}: {name} is not as it was exported; move it away, or choose another "
                "folder"
            )
    return known


def write(out: Path, files: Mapping[str, str], manifest: dict[str, Any]) -> None:
    """Write the files of an export in place of those of an earlier one.

    The manifest goes first: an export that is stopped anywhere is taken up by the next one.
    """
    known = check_folder(out, files)
    out.mkdir(parents=True, exist_ok=True)
    for file in filter(is_leftover, list(out.iterdir())):
        file.unlink(missing_ok=True)
    earlier = {
        name: _checksum((out / name).read_bytes()) for name in known if (out / name).exists()
    }
    write_text(out / MANIFEST, json_text(manifest | {REPLACED: earlier}))
    for name, text in files.items():
        write_text(out / name, text)
    for name in known.keys() - files.keys():
        (out / name).unlink(missing_ok=True)
    write_text(out / MANIFEST, json_text(manifest))


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
