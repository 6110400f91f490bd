"""Results of a demo: one object, and the picture of all four sweeps."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxstage import __version__
from jaxstage.metrics.table import split_key
from jaxstage.plot import save, sweep
from tuning.app.demo import stages
from tuning.app.reports.tuning import held_out
from tuning.app.result_table import Row
from tuning.store.work_folder import digest
from tuning.sweeps import store
from tuning.sweeps.configuration import build
from tuning.tuner.evidence.validation import PairedRuns, held_out_verdict
from tuning.tuner.report import held_out_object


class Swept(NamedTuple):
    """The figure of every plant under one loop, (plants,), NaN where lost."""

    published: np.ndarray
    tuned: np.ndarray


def swept(folder: Path) -> dict[str, Swept]:
    """What both sweeps hold, by loop."""
    columns = [_column(folder / name) for name in ("published", "tuned")]
    return {loop: Swept(*(column[loop] for column in columns)) for loop in stages.LOOPS}


def _column(folder: Path) -> dict[str, np.ndarray]:
    plan = build(store.read_configuration(folder))
    rows = store.read(folder, plan, ["loop", stages.METRIC])
    names = np.asarray(rows["loop"].to_pylist())
    values = rows[stages.METRIC].to_numpy()
    return {loop: values[names == loop] for loop in stages.LOOPS}


def as_object(folder: Path) -> dict[str, Any]:
    """What ``--json`` prints and demo.json holds. What cannot be said is None."""
    figures = swept(folder)
    loops = [_loop(folder, loop, figures[loop]) for loop in stages.LOOPS]
    pairs = {name: _pair(folder / name) for name in ("published", "tuned")}
    took = stages.ended(folder).values()
    return {
        "version": __version__,
        "jax": jax.__version__,
        "configuration_sha256": digest(stages.configuration()),
        "plants": stages.PLANTS,
        "seed": stages.SEED,
        "metric": stages.METRIC,
        "verdict": [*map(_line, loops), _comparison(pairs)],
        "loops": loops,
        "comparisons": pairs,
        "stages": [one._asdict() for one in took],
        "seconds": sum(one.seconds for one in took),
        "processor_seconds": sum(one.processor_seconds for one in took),
    }


def _read(file: Path) -> Any:
    return json.loads(file.read_text(encoding="utf-8"))


def _loop(folder: Path, loop: str, figures: Swept) -> dict[str, Any]:
    tuning = _read(folder / "tune" / loop / "tune.json")
    pairs = PairedRuns(stages.METRIC, figures.published, figures.tuned, {})
    return {
        "loop": loop,
        "accepted": tuning["accepted"],
        "refused": tuning["refused"],
        "method": tuning["method"],
        "n": tuning["n"],
        "units": tuning["units"],
        "before": tuning["before"]["figures"],
        "after": tuning["after"]["figures"],
        "plants": held_out_object(held_out_verdict(pairs)),
        "gains": str(stages.gains_file(folder, loop).relative_to(folder)),
    }


def _pair(folder: Path) -> Any:
    """One law against the other on the same plants; None where nothing can be said."""
    comparisons = _read(folder / "summary.json")["comparisons"]
    return comparisons[0] if comparisons else None


def _line(loop: Row) -> str:
    reasons = "; ".join(loop["refused"])
    state = f"tuned gains NOT accepted ({reasons})" if reasons else "tuned gains accepted"
    return f"{loop['loop']}: {state}; {held_out(loop['plants'])}"


def _comparison(pairs: Mapping[str, Row | None]) -> str:
    """Which law is the more accurate one, before and after."""
    told = [f"{_winner(pair)} at {name} gains" for name, pair in pairs.items() if pair]
    name = split_key(stages.METRIC)[0]
    return f"Smaller {name} on the same plants: {', '.join(told) or 'cannot be said'}."


def _winner(pair: Row) -> str:
    share = pair["better"]
    first = share["value"] >= 0.5
    value, *ends = (share[key] if first else 1 - share[key] for key in ("value", "low", "high"))
    low, high = sorted(ends)
    name = pair["first"] if first else pair["second"]
    told, *ends = (f"{100 * x:.1f} %" for x in (value, low, high))
    return f"{name} on {told} of them ({ends[0]} to {ends[1]})"


def picture(folder: Path, answer: Row) -> Path:
    """plants.png: how the metric is distributed over the plants, under both laws, before and
    after."""
    name, unit = split_key(stages.METRIC)
    settings = (
        f"{answer['plants']} plants, sobol, seed {answer['seed']}",
        "double precision",
        f"configuration {answer['configuration_sha256']}",
        f"jaxstage {answer['version']}, jax {answer['jax']}",
    )
    footer = "   |   ".join(settings)
    sheet = sweep.Sheet(f"{name} ({unit.replace('um', 'µm')})", None, footer)
    samples = [
        sweep.MetricSample(f"{loop}, {when} gains", values, None)
        for loop, figures in swept(folder).items()
        for when, values in figures._asdict().items()
    ]
    file = folder / "plants.png"
    save(sweep.distribution(samples, sheet), file)
    return file
