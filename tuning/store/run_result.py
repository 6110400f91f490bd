"""Result of a single run: as an object for JSON, as text, and as files."""

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxstage import __version__
from jaxstage.metrics import columns
from jaxstage.metrics.table import key as column
from jaxstage.model.settings import MOTION, SCENARIO_PARTS, known_leaves, to_toml
from jaxstage.model.signals import Run
from jaxstage.studies import Case
from jaxstage.studies.verdict import lost_because, scored_columns, verdict
from jaxstage.system.files import write_text
from tuning.store import gains_file


def _tick(value: Any) -> int | None:
    return int(value) if int(value) >= 0 else None


def summary(case: Case, run: Run, notes: tuple[str, ...] = ()) -> dict[str, Any]:
    """The object that ``--json`` prints. Metrics of a lost run are None."""
    left, broken = _tick(run.final.left_path_at), _tick(run.final.non_finite_at)
    double = case.scenario.start.offset.dtype == "float64"
    scored = columns(run.report["scored"], case.loop.plant)
    lost = broken if left is None else left
    beyond = scored.get("contour_beyond_share")
    if beyond:
        notes += (
            f"in {beyond:.1%} of the ticks the following error exceeds the part of the curve that "
            "is searched for the nearest point; there the contour error is an upper bound",
        )
    return {
        "loop": case.name,
        "version": __version__,
        "jax": jax.__version__,
        "precision": "double" if double else "single",
        "dt_s": case.loop.dt,
        "duration_s": case.window.ticks * case.loop.dt,
        "lap_time_s": case.window.lap * case.loop.dt,
        "laps": case.window.laps,
        "scored": case.window.scored,
        **scored_columns(case),
        "motion": _sizes(case),
        "verdict": verdict(case, scored, lost, lost_because(case, left)),
        "finite": left is None and broken is None,
        "left_path_at": left,
        "non_finite_at": broken,
        "metrics": scored,
        "metrics_whole_run": columns(run.report["whole"], case.loop.plant),
        "notes": list(notes),
    }


def _sizes(case: Case) -> dict[str, Any]:
    """Sizes of a motion that is computed in the loop, by column."""
    every = known_leaves((), case.scenario, case.path)
    return {
        column(path.removeprefix(f"{MOTION}."), quantity.unit): np.asarray(value, float).tolist()
        for path, (quantity, value) in every.items()
        if path.startswith(f"{MOTION}.")
    }


def write_settings(
    folder: Path, case: Case, result: dict[str, Any], refused: tuple[str, ...] = ()
) -> None:
    """run.json, gains.toml and scenario.toml: what happened, and what ``--gains`` and
    ``--scenario`` take back."""
    scenario = {name: getattr(case.scenario, name) for name in SCENARIO_PARTS}
    seed = {"seed": int(jax.random.key_data(case.scenario.key)[-1])}
    write_text(folder / "run.json", json.dumps(result, indent=2, allow_nan=False) + "\n")
    write_text(folder / "gains.toml", gains_file.to_text(case, case.gains, refused=refused))
    write_text(folder / "scenario.toml", to_toml(scenario, seed))
