"""The answers about a sweep as an object for JSON. What cannot be said is None."""

import math
from pathlib import Path
from typing import Any

from jaxstage.studies import Case
from jaxstage.studies.verdict import scored_columns, scored_text
from tuning.store.work_folder import digest
from tuning.sweeps.analysis import WORST, Analysis, LoopResult, worst_runs
from tuning.sweeps.sensitivity import Indices
from tuning.uncertainty.statistics import Interval, Share


def as_object(analysis: Analysis, folder: Path) -> dict[str, Any]:
    """What ``--json`` prints and summary.json holds. What cannot be said is None."""
    table = analysis.plan.table
    return {
        "sweep": str(folder),
        "version": table["jaxstage"],
        "configuration_sha256": digest(analysis.plan.text),
        "design": table["design"],
        "seed": table["seed"],
        "precision": table["precision"],
        "runs": table["runs"],
        "metric": analysis.metric,
        "specification": analysis.spec.text if analysis.spec else None,
        "loops": [*map(_loop_object, analysis.loops, analysis.plan.cases)],
        "comparisons": [
            {
                "first": c.first,
                "second": c.second,
                "plants": c.plants,
                "survived": c.survived,
                "difference": _interval(c.difference),
                "better": _share(c.better),
            }
            for c in analysis.comparisons
        ],
        "worst": worst_runs(folder, analysis.plan, analysis.metric, WORST),
        "notes": list(analysis.notes),
    }


def scored_words(analysis: Analysis) -> str:
    """What of every run is scored; said of each loop where they differ."""
    told = {case.name: scored_text(case) for case in analysis.plan.cases}
    if len(set(told.values())) == 1:
        return next(iter(told.values()))
    return "; ".join(f"{name} {text}" for name, text in told.items())


def _loop_object(loop: LoopResult, case: Case) -> dict[str, Any]:
    stated = loop.statistics
    names = ("mean", "p50", "p95", "cvar95")
    return {
        "loop": loop.name,
        "runs": len(loop.sampled),
        **scored_columns(case),
        "lost": loop.lost,
        "passed": None if loop.passed is None else int(loop.passed.sum()),
        "yield": _share(loop.met),
        "claim": loop.claim._asdict() if loop.claim else None,
        "statistics": {n: _interval(getattr(stated, n)) for n in names} if stated else None,
        "reasons": stated.reasons if stated else {},
        "rank_correlation": loop.correlations,
        "sobol_indices": _indices(loop.indices),
        "tornado": _tornado_object(loop),
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _interval(interval: Interval | None) -> dict[str, float | None] | None:
    return {k: _number(v) for k, v in interval._asdict().items()} if interval else None


def _share(share: Share | None) -> dict[str, float | None] | None:
    if share is None:
        return None
    interval = {name: _number(getattr(share, name)) for name in ("value", "low", "high")}
    return {"count": share.count, "of": share.of, **interval}


def _indices(indices: Indices | None) -> dict[str, Any] | None:
    if indices is None:
        return None
    keys = ("s1", "s1_error", "st", "st_error")
    return {
        name: dict(zip(keys, map(_number, numbers), strict=True))
        for name, *numbers in indices.rows()
    }


def _tornado_object(loop: LoopResult) -> dict[str, Any] | None:
    if loop.tornado is None:
        return None
    bars = {}
    for bar in loop.tornado.bars:
        low, high = loop.ends[bar.column] or (None, None)
        bars[bar.name] = {"low": bar.low, "high": bar.high, "sweep_low": low, "sweep_high": high}
    return {"nominal": loop.tornado.nominal, "bars": bars}
