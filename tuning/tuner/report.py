"""A finished tuning as an object for JSON and as files."""

import csv
import io
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxstage import __version__
from jaxstage.metrics.table import split_key
from jaxstage.system.files import write_text
from tuning.store.gains_file import TunedGain, to_text
from tuning.store.work_folder import digest
from tuning.tuner.baselines import ConvergenceCurve, convergence_curve
from tuning.tuner.evidence.validation import HeldOut, ValidationRuns
from tuning.tuner.pareto import Front
from tuning.tuner.problem.search_space import parameters
from tuning.tuner.session import TuningResult
from tuning.uncertainty.statistics import Interval

#: the files of tuned gains: accepted ones, and those that were refused
ACCEPTED, REFUSED = "gains.toml", "refused-gains.toml"


class Extras(NamedTuple):
    """What was asked for beside the tuning.

    Attributes:
        before, after: metrics of the loop as it stands.
        baselines: other methods.
        front: trade-offs.
    """

    before: dict[str, Any]
    after: dict[str, Any]
    baselines: tuple[ConvergenceCurve, ...] = ()
    front: Front | None = None


def as_object(outcome: TuningResult, extras: Extras) -> dict[str, Any]:
    """What ``--json`` prints and tune.json holds. What cannot be said is None."""
    tuned, objective = outcome.tuned, outcome.chosen.validation.exact.objective
    return {
        "loop": outcome.plan.table["loop"],
        "version": __version__,
        "configuration_sha256": digest(outcome.plan.text),
        "method": tuned.method,
        "n": tuned.n,
        "units": rounded(outcome.simulations),
        "seconds": rounded(outcome.seconds),
        "ended": tuned.ended,
        "objective": outcome.plan.table["objective"],
        "scored": outcome.scored,
        "accepted": not outcome.refused,
        "refused": [one.reason for one in outcome.refused],
        "try_next": list(dict.fromkeys(one.advice for one in outcome.refused)),
        "warnings": list(outcome.warnings),
        "before": {"objective": number(objective[0]), "figures": extras.before},
        "after": {
            "objective": number(objective[1]),
            "objective_without_pull": number(outcome.without_pull),
            "figures": extras.after,
        },
        "held_out": held_out_object(outcome.held_out),
        "gains": gains_object(outcome),
        "diagnostics": diagnostics_object(outcome),
        "baselines": [baseline_object(one, outcome) for one in extras.baselines],
        "pareto": front_object(extras.front),
    }


def number(value: float | None) -> float | None:
    """A finite number or None."""
    return None if value is None or not math.isfinite(value) else float(value)


def rounded(value: float) -> float:
    """Simulations and seconds with three digits behind the point."""
    return round(float(value), 3)


def _interval(interval: Interval | None) -> dict[str, float | None] | None:
    return {k: number(v) for k, v in interval._asdict().items()} if interval else None


def held_out_object(verdict: HeldOut) -> dict[str, Any]:
    """The verdict of the held-out runs."""
    return {
        "figure": verdict.metric,
        "runs": verdict.runs,
        "before": _interval(verdict.before),
        "after": _interval(verdict.after),
        "change": _interval(verdict.change),
        "lost_before": verdict.lost_before,
        "lost": verdict.lost,
        "better": {k: number(v) for k, v in verdict.better._asdict().items()},
        "figures": {name: {"before": b, "after": a} for name, (b, a) in verdict.others.items()},
    }


def gains_object(outcome: TuningResult) -> dict[str, Any]:
    """Label -> value, before, range and unit of every number that was tuned."""
    return {
        p.label: {
            "value": p.value,
            "before": p.before,
            "low": number(p.low),
            "high": number(p.high),
            "unit": p.unit,
            "symbol": p.symbol,
            "at_bound": p.at_bound,
        }
        for p in parameters(outcome.problem.space, outcome.chosen.z)
    }


def _validation_runs(runs: ValidationRuns) -> dict[str, Any]:
    return {
        "before": number(runs.metric[0]),
        "after": number(runs.metric[1]),
        "objective_before": number(runs.objective[0]),
        "objective_after": number(runs.objective[1]),
        "lost": runs.lost,
    }


def diagnostics_object(outcome: TuningResult) -> dict[str, Any]:
    """What the result rests on."""
    known, validation = outcome.diagnostics, outcome.chosen.validation
    effects = known.effects
    return {
        "gradient_ok": known.gradient_ok,
        "gradient_error": {k: number(v) for k, v in (known.gradient_error or {}).items()},
        "non_finite": known.non_finite,
        "at_bounds": list(known.at_bounds),
        "insensitive": list(effects.insensitive) if effects else None,
        "redundant": [list(group) for group in effects.redundant] if effects else None,
        "eigenvalues": [float(v) for v in effects.eigenvalues] if effects else None,
        "starts": [number(v) for v in known.starts],
        "starts_agree": known.starts_agree,
        "spectral_radius": dict(zip(("before", "after"), known.radius, strict=True))
        if known.radius
        else None,
        "surrogate": dict(zip(("before", "after"), outcome.surrogate, strict=True))
        if outcome.surrogate
        else None,
        "share": outcome.chosen.share,
        "exact": _validation_runs(validation.exact),
        "half_step": _validation_runs(validation.half_step),
        "longer": _validation_runs(validation.longer),
        "rounds": [
            {
                "added": list(one.added),
                "units": rounded(one.tuned.simulations),
                "before": number(one.tuned.before),
                "after": number(one.tuned.after),
            }
            for one in outcome.rounds
        ],
        "notes": list(known.notes),
    }


def baseline_object(curve: ConvergenceCurve, outcome: TuningResult) -> dict[str, Any]:
    """A method beside the one that tuned: where it ended, and when it was where that one ended."""
    best = convergence_curve(outcome.rounds[0].tuned).best[-1]
    return {
        "method": curve.method,
        "units": rounded(curve.simulations[-1]),
        "objective": number(curve.best[-1]),
        "units_to_same": curve.reached(float(best)),
    }


def front_object(front: Front | None) -> dict[str, Any] | None:
    """The trade-offs."""
    if front is None:
        return None

    def row(values: np.ndarray) -> dict[str, float | None]:
        return {name: number(v) for name, v in zip(front.columns, values, strict=True)}

    return {
        "columns": list(front.columns),
        "points": [
            {
                "figures": row(point),
                "weights": row(share),
                "on_front": bool(kept),
                "suggested": index == front.suggested,
            }
            for index, (point, share, kept) in enumerate(
                zip(front.points, front.weights, front.kept, strict=True)
            )
        ],
        "before": row(front.before),
        "hypervolume": number(front.volume),
        "reference": row(front.reference),
        "units": rounded(front.simulations),
        "note": front.note or None,
    }


# --- files -------------------------------------------------------------------------------------


def write_files(
    folder: Path, outcome: TuningResult, extras: Extras, answer: dict[str, Any]
) -> None:
    """tune.json, the gains, history.csv and, where asked for, baseline.csv and pareto/."""
    write_text(folder / "tune.json", json.dumps(answer, indent=2, allow_nan=False) + "\n")
    name, other = (REFUSED, ACCEPTED) if outcome.refused else (ACCEPTED, REFUSED)
    write_text(folder / name, gains_text(outcome))
    (folder / other).unlink(missing_ok=True)
    write_text(folder / "history.csv", history_text(outcome))
    if extras.baselines:
        write_text(folder / "baseline.csv", courses_text(_courses(outcome, extras)))
    if extras.front is not None:
        write_front(folder / "pareto", outcome, extras.front)


def _courses(outcome: TuningResult, extras: Extras) -> tuple[ConvergenceCurve, ...]:
    return (convergence_curve(outcome.rounds[0].tuned), *extras.baselines)


def gains_text(outcome: TuningResult, gains: Any = None, remark: str = "") -> str:
    """The file of gains: all values, and of the tuned ones unit, range and value before."""
    verdict = [f"NOT accepted: {one.reason}" for one in outcome.refused]
    verdict = verdict or [f"held out: {verdict_text(outcome.held_out)}"]
    entries = outcome.problem.space.entries
    return to_text(
        outcome.plan.case,
        outcome.chosen.gains if gains is None else gains,
        [TunedGain(e.path, e.symbol, e.unit, e.low, e.high, e.before) for e in entries],
        [
            f"tuned for {outcome.plan.table['loop']} by jaxstage {__version__}, "
            f"configuration {digest(outcome.plan.text)}; SI units",
            *([remark] if remark else (*verdict, *(f"WARNING: {w}" for w in outcome.warnings))),
        ],
        [] if remark else [one.reason for one in outcome.refused],
    )


def verdict_text(verdict: HeldOut) -> str:
    """The verdict of the held-out runs in words."""
    name, unit = split_key(verdict.metric)
    after, change = verdict.after, verdict.change
    if after is None or (verdict.lost > verdict.lost_before and change is None):
        return f"{verdict.lost} of {verdict.runs} runs are lost, too few are left to compare"
    if verdict.before is None or change is None:
        return (
            f"{name} {after.value:.4g} {unit} ({after.low:.4g}..{after.high:.4g}) on "
            f"{verdict.runs} runs; {verdict.lost} lost, {verdict.lost_before} before, so that "
            "there is no change to state"
        )
    return (
        f"{name} {verdict.before.value:.4g} -> {after.value:.4g} {unit}, "
        f"{change.value:+.1%} ({change.low:+.1%}..{change.high:+.1%}), on {verdict.runs} runs; "
        f"{verdict.lost} lost, {verdict.lost_before} before"
    )


def history_text(outcome: TuningResult) -> str:
    """One row a step of every round."""
    rows = [
        (number_, p.step, p.simulations, p.seconds, p.best, p.gradient_norm, p.violation)
        for number_, one in enumerate(outcome.rounds)
        for p in one.tuned.history
    ]
    head = ("round", "step", "units", "seconds_s", "objective", "gradient_norm", "violation")
    return _csv(head, rows)


def courses_text(courses: Sequence[ConvergenceCurve]) -> str:
    """Convergence curves of every method."""
    rows = [
        (one.method, simulations, best)
        for one in courses
        for simulations, best in zip(*one[1:3], strict=True)
    ]
    return _csv(("method", "units", "objective"), rows)


def write_front(folder: Path, outcome: TuningResult, front: Front) -> None:
    """pareto.csv, and the gains of every point as TOML."""
    folder.mkdir(exist_ok=True)
    head = (
        "point",
        *front.columns,
        *(f"weight_{c}" for c in front.columns),
        "on_front",
        "suggested",
    )
    rows = [
        (i, *point, *share, kept, i == front.suggested)
        for i, (point, share, kept) in enumerate(
            zip(front.points, front.weights, front.kept, strict=True)
        )
    ]
    write_text(folder / "pareto.csv", _csv(head, rows))
    for i, gains in enumerate(front.gains):
        metrics = ", ".join(
            f"{c} {v:.4g}" for c, v in zip(front.columns, front.points[i], strict=True)
        )
        remark = f"trade-off {i}: {metrics}; tested on the training runs only"
        write_text(folder / f"gains-{i}.toml", gains_text(outcome, gains, remark))


def _csv(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Rows as CSV; what is not finite is left blank."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    for row in rows:
        writer.writerow([_cell(value) for value in row])
    return text.getvalue()


def _cell(value: Any) -> Any:
    plain = value.item() if isinstance(value, np.generic) else value
    return "" if isinstance(plain, float) and not math.isfinite(plain) else plain
