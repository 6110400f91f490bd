"""The answers about a sweep as an object for JSON. What cannot be said is None."""

import math
from pathlib import Path
from typing import Any

from tuning.store.work_folder import digest
from tuning.sweeps.analysis import WORST, Analysis, LoopResult, worst
from tuning.sweeps.sensitivity import Indices
from tuning.uncertainty.statistics import Interval, Share


def as_object(found: Analysis, folder: Path) -> dict[str, Any]:
    """What ``--json`` prints and summary.json holds. What cannot be said is None."""
    table = found.plan.table
    return {
        "sweep": str(folder),
        "version": table["jaxstage"],
        "configuration_sha256": digest(found.plan.text),
        "design": table["design"],
        "seed": table["seed"],
        "precision": table["precision"],
        "runs": table["runs"],
        "metric": found.metric,
        "specification": found.spec.text if found.spec else None,
        "loops": [_loop_object(loop) for loop in found.loops],
        "comparisons": [
            {
                "first": c.first,
                "second": c.second,
                "plants": c.plants,
                "survived": c.survived,
                "difference": _interval(c.difference),
                "better": _share(c.better),
            }
            for c in found.comparisons
        ],
        "worst": worst(folder, found.plan, found.metric, WORST),
        "notes": list(found.notes),
    }


def _loop_object(loop: LoopResult) -> dict[str, Any]:
    stated = loop.statistics
    names = ("mean", "p50", "p95", "cvar95")
    return {
        "loop": loop.name,
        "runs": len(loop.sampled),
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


def _interval(found: Interval | None) -> dict[str, float | None] | None:
    return {k: _number(v) for k, v in found._asdict().items()} if found else None


def _share(found: Share | None) -> dict[str, float | None] | None:
    if found is None:
        return None
    interval = {name: _number(getattr(found, name)) for name in ("value", "low", "high")}
    return {"count": found.count, "of": found.of, **interval}


def _indices(found: Indices | None) -> dict[str, Any] | None:
    if found is None:
        return None
    rows = zip(found.names, found.first, found.first_error, found.total, found.total_error)  # noqa: B905
    return {
        name: {"s1": _number(s), "s1_error": _number(e), "st": _number(t), "st_error": _number(u)}
        for name, s, e, t, u in rows
    }


def _tornado_object(loop: LoopResult) -> dict[str, Any] | None:
    found = loop.tornado
    if found is None:
        return None
    bars = {}
    for bar in found.bars:
        low, high = loop.ends[bar.column] or (None, None)
        bars[bar.name] = {"low": bar.low, "high": bar.high, "sweep_low": low, "sweep_high": high}
    return {"nominal": found.nominal, "bars": bars}
