"""What became of a run, in one sentence."""

from collections.abc import Mapping
from typing import Any

from jaxstage.metrics.words import length_text, time_text
from jaxstage.studies.case import Case


def scored_columns(case: Case) -> dict[str, float]:
    """The part of a run that its metrics cover, as columns."""
    window, dt = case.window, case.loop.dt
    return {
        "scored_from_s": window.start * dt,
        "scored_to_s": window.stop * dt,
        "scored_laps": window.scored_laps,
    }


def scored_text(case: Case) -> str:
    """What the metrics cover: the lap, or how many; from when to when."""
    window = case.window
    whole = window.stop - window.start == window.ticks and not window.scored
    lap = f"lap {window.scored} of {window.laps:g}" if window.scored else ""
    return span_text(scored_columns(case), "whole run" if whole else lap)


def span_text(columns: Mapping[str, Any], part: str = "") -> str:
    """The words for `scored_columns`. part: what they cover, if it has a name; else the laps."""
    laps = columns["scored_laps"]
    part = part or f"{laps:.3g} lap{'' if laps <= 1 else 's'}"
    return f"{part}, {columns['scored_from_s']:.4g} to {columns['scored_to_s']:.4g} s"


def lost_because(case: Case, left_path_at: int | None) -> str:
    """Why a lost run was lost; ``left_path_at`` is None where it stopped being finite."""
    if left_path_at is not None:
        return f"following error above {case.loop.path_limit * 1e3:g} mm"
    return "a value is not finite"


def verdict(case: Case, metrics: Mapping[str, Any], lost: int | None, because: str) -> str:
    """One sentence: complete with its contour error, or LOST, when and why.

    metrics: the columns of the scored report. lost: the tick at which the run was lost, or None.
    """
    if lost is not None:
        at = time_text(lost * case.loop.dt)
        return f"LOST at t = {at} (tick {lost} of {case.window.ticks}): {because}; no metrics"
    kind = "contour" if "contour_rms_um" in metrics else "following"
    rms, top = (_largest(metrics.get(f"{kind}_{name}_um")) for name in ("rms", "max"))
    if rms is None or top is None:
        return f"complete ({scored_text(case)})"
    return (
        f"complete; {kind} error {length_text(rms * 1e-6)} RMS, {length_text(top * 1e-6)} max "
        f"({scored_text(case)})"
    )


def _largest(metric: Any) -> float | None:
    """A metric, or the largest of its axes; None where there is none."""
    values = list(metric.values()) if isinstance(metric, Mapping) else [metric]
    return None if None in values else max(values)
