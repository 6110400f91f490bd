"""The report of one run: the folder that ``jaxstage run --out`` leaves."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxstage.studies.verdict import span_text
from tuning.app.reports.page import Page, pictures, read_json
from tuning.app.result_table import DASH, ResultTable, decimal, metric_table

#: picture -> how to read it
TEXTS = {
    "contour": "The commanded curve, and the tool's path with its contour error magnified: where "
    "the line stands off, the tool left the curve; spikes are axes that reverse.",
    "space": "The path in space, with the contour error magnified.",
    "axes": "Commanded and actual position of each axis; below each, its following error, which "
    "jumps where static friction holds the axis.",
    "error": "Contour error over time and along the curve: what repeats from lap to lap belongs to "
    "the curve, what fades to the start.",
    "command": "What the drive was asked for, from afar, around a reversal, and tick by tick: a "
    "comb in the last panel is chattering.",
    "surface": "The sliding variable, and error against its rate: on the dashed line the error "
    "decays with the slope of the surface.",
    "weights": "The weights that the law learned while it ran: lines that settle have learned "
    "what repeats.",
    "schedule": "The gains that the cross-coupled law used: what moves here is the scheduling.",
}


def read(folder: Path) -> Page:
    """The page of a folder with ``run.json``."""
    result = read_json(folder / "run.json")
    texts = {
        name: (folder / name).read_text(encoding="utf-8")
        for name in ("gains.toml", "scenario.toml", "rules.txt")
        if (folder / name).is_file()
    }
    lap = f"lap {result['scored']} of {result['laps']:.4g}" if result["scored"] else ""
    return Page(
        title=result["loop"],
        subtitle="One run: the machine, the law and the path that the settings below name.",
        good=result["finite"],
        verdict=(result["verdict"],),
        facts={
            "length": f"{result['duration_s']:g} s, {result['laps']:.4g} laps of "
            f"{result['lap_time_s']:.4g} s",
            "metrics of": span_text(result, lap),
        },
        notes=tuple(result["notes"]),
        tables=(),
        details=(metrics(result),) if result["finite"] else (),
        pictures=pictures(folder, TEXTS),
        files=texts,
        settings=_settings(result, texts),
    )


def _settings(result: Mapping[str, Any], texts: Mapping[str, str]) -> dict[str, str]:
    scenario = tomllib.loads(texts.get("scenario.toml", ""))
    return {
        "loop": result["loop"],
        "control period": f"{result['dt_s'] * 1e6:g} µs",
        "precision": result["precision"],
        "seed": str(scenario.get("seed", DASH)),
        "versions": f"jaxstage {result['version']}, jax {result['jax']}",
    }


def metrics(result: Mapping[str, Any]) -> ResultTable:
    """All metrics of a ``run.json``, of the scored window and of the whole run."""
    return metric_table(
        {"scored": result["metrics"], "whole run": result["metrics_whole_run"]},
        decimal,
        title="Figures",
        note="The whole run includes the start transient. A dash: no such metric.",
    )
