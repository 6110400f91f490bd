"""All pictures of a run as files."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from jaxstage.model.signals import Sample
from jaxstage.plot.axes import axes
from jaxstage.plot.command import command
from jaxstage.plot.contour import contour
from jaxstage.plot.error import error
from jaxstage.plot.schedule import schedule
from jaxstage.plot.space import space
from jaxstage.plot.surface import surface
from jaxstage.plot.view import View, view
from jaxstage.plot.weights import weights
from jaxstage.studies import Case
from jaxstage.studies.verdict import lost_because
from jaxstage.system.files import write_whole

#: the pictures of one run by name
VIEWS = {
    "contour": contour,
    "axes": axes,
    "error": error,
    "command": command,
    "weights": weights,
    "surface": surface,
    "space": space,
    "schedule": schedule,
}


def pictures(
    case: Case, report: Any, rows: Sample, result: Mapping[str, Any], folder: Path
) -> tuple[Path, ...]:
    """Draw what applies to the run into ``folder``, which must exist; returns the files.

    report: the metrics of the scored part. rows: what the metric `record` stored. result: the
    summary of the run; its ``left_path_at`` says why a run was lost, its ``verdict`` stands above.
    A picture of an earlier run that does not apply to this one is removed.
    """
    shown = view(case, report, rows, lost_because(case, result["left_path_at"]))
    shown = shown._replace(verdict=result.get("verdict", shown.verdict))
    files = []
    for name, draw in VIEWS.items():
        file = folder / f"{name}.png"
        if _applies(name, shown):
            save(draw(shown), file)
            files.append(file)
        else:
            file.unlink(missing_ok=True)
    return tuple(files)


def save(drawn: Figure, file: Path) -> None:
    """Write a PNG whole or not at all."""
    drawing = io.BytesIO()
    drawn.savefig(drawing, format="png")
    write_whole(file, drawing.getvalue())


def _applies(name: str, shown: View) -> bool:
    """Whether a picture says something about this run."""
    needed = {
        "contour": len(shown.axes) > 1,
        "error": len(shown.axes) > 1,
        "weights": shown.weights is not None,
        "surface": shown.surface is not None,
        "space": len(shown.axes) == 3,
        "schedule": shown.schedule is not None,
    }
    return len(shown.time) > 0 and needed.get(name, True)
