"""Pictures of a tuning: progress, gains in their ranges, the run before and after, trade-offs.

They draw plain arrays and `View`s. An objective is to be small.
"""

from collections.abc import Sequence
from itertools import cycle
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstage.metrics.words import length_text, length_unit
from jaxstage.plot.numbers import plain
from jaxstage.plot.sheet import sheet_page
from jaxstage.plot.style import (
    AXIS_COLOURS,
    LOST,
    NORMAL,
    OTHER,
    REFERENCE,
    SCORED,
    SMALL,
    dress,
    legend,
    line,
    note,
    time_axis,
)
from jaxstage.plot.view import View

#: best objectives below this share of the first are drawn on a log axis
WIDE = 0.2
#: gains of one picture
MOST_GAINS = 60


class Trace(NamedTuple):
    """Progress of one method.

    Attributes:
        units: Spent, (k,).
        best: Objective of the best gains so far, (k,): of those that miss the goals least.
        gradient: Its norm there, (k,), NaN where unknown.
        violation: Largest miss of a goal there, (k,); above 0 a goal is missed, NaN where unknown.
    """

    name: str
    units: np.ndarray
    best: np.ndarray
    gradient: np.ndarray
    violation: np.ndarray


class Moved(NamedTuple):
    """A number that was tuned. label: with its unit. logarithmic: ratios count in its range.
    at_bound: it ended on the border of the range."""

    label: str
    before: float
    after: float
    low: float
    high: float
    logarithmic: bool
    at_bound: bool


def history(traces: Sequence[Trace], footer: str) -> Figure:
    """Best objective against units spent, a line a method; below, the norm of the gradient."""
    text = (
        "Left is the beginning: 1 are the gains before. One unit is one simulation of the whole "
        "training set; gradients and Jacobians cost what was measured here. Lower is better."
    )
    if any((trace.violation > 0).any() for trace in traces):
        text += (
            " Crosses miss a goal: meeting the goals comes first, so the line may rise until all "
            "are met."
        )
    slopes = [trace for trace in traces if np.isfinite(trace.gradient).any()]
    drawn = sheet_page("objective against cost", text, footer, 12, 8.5 if slopes else 6.5)
    panels = drawn.subplots(
        1 + bool(slopes), 1, sharex=True, squeeze=False, height_ratios=[2, 1][: 1 + bool(slopes)]
    )[:, 0]
    best = panels[0]
    for trace, colour in zip(traces, cycle(AXIS_COLOURS)):
        best.step(
            trace.units,
            trace.best,
            where="post",
            color=colour,
            linewidth=1.8,
            label=f"{trace.name}: {trace.best[-1]:.4g} after {trace.units[-1]:.0f} units",
        )
        best.plot(trace.units[-1:], trace.best[-1:], "o", color=colour, markersize=5)
        missed = trace.violation > 0
        best.plot(
            trace.units[missed], trace.best[missed], "X", color=LOST, markersize=8, linestyle=""
        )
        if slopes and np.isfinite(trace.gradient).any():
            panels[1].plot(trace.units, trace.gradient, ".-", color=colour, linewidth=1.4)
    if min(trace.best.min() for trace in traces) < WIDE * max(t.best[0] for t in traces):
        best.set_yscale("log")
    dress(best, "" if slopes else "units", "objective")
    best.legend(loc="lower right", bbox_to_anchor=(1, 0.99), fontsize=SMALL, frameon=False, ncols=2)
    if slopes:
        panels[1].set_yscale("log")
        dress(panels[1], "units", "norm of the gradient")
    return drawn


def parameters(moved: Sequence[Moved], footer: str) -> Figure:
    """Every tuned number in its range, before and after, the farthest moved first."""
    order = sorted(moved, key=lambda m: -abs(_place(m, m.after) - _place(m, m.before)))
    shown = order[:MOST_GAINS]
    left_out = len(order) - len(shown)
    text = (
        "Each line is the range of one number: grey ring before, dot after, with both values. "
        "Red ended on the border of its range: the optimum may lie beyond."
    )
    text += f" The {left_out} that moved least are not drawn." if left_out else ""
    drawn = sheet_page("gains before and after", text, footer, 13, 1.9 + 0.36 * len(shown))
    ax = drawn.subplots()
    for row, one in enumerate(shown):
        _range(ax, row, one)
    ax.set_ylim(len(shown) - 0.4, -0.6)
    ax.set_xlim(-0.02, 1.02)
    ax.set_yticks(range(len(shown)), [one.label for one in shown])
    dress(ax, "place in the range (ratios where it is logarithmic)", "")
    ax.grid(False, axis="y")
    return drawn


def _place(one: Moved, value: float) -> float:
    """Where a value stands in its range, 0..1."""
    low, high, x = one.low, one.high, value
    if one.logarithmic:
        low, high, x = (float(np.log(v)) for v in (low, high, x))
    return (x - low) / (high - low) if high > low else 0.5


def _range(ax: Axes, row: int, one: Moved) -> None:
    colour = LOST if one.at_bound else SCORED
    before, after = _place(one, one.before), _place(one, one.after)
    ax.plot([0, 1], [row, row], color="#DDDDDD", linewidth=4, solid_capstyle="round", zorder=1)
    ax.plot([before, after], [row, row], color=colour, linewidth=1.6, zorder=2)
    ax.plot(before, row, "o", color="white", markeredgecolor=OTHER, markersize=8, zorder=3)
    ax.plot(after, row, "o", color=colour, markersize=7, zorder=4)
    told = f"{plain(one.before)} → {plain(one.after)}   in {plain(one.low)} … {plain(one.high)}"
    ax.text(1.02, row, told, fontsize=SMALL, va="center", transform=ax.get_yaxis_transform())


def before_after(before: View, after: View) -> Figure:
    """The error of the same loop before and after in time, and the command of its busiest axis."""
    if len(before.axes) > 1:
        errors, name = [v.distance for v in (before, after)], "contour error"
    else:
        errors, name = [np.abs(v.error[:, 0]) for v in (before, after)], "|following error|"
    part = before.scored_ticks()
    told = [f"RMS {length_text(_rms(e[part]))}" for e in errors]
    text = f"Before: {before.verdict}. After: {after.verdict}."
    title = f"{before.name}: {name} before and after, {told[0]} to {told[1]}"
    drawn = sheet_page(title, text, after.footer, 15, 9.5)
    upper, lower = drawn.subplots(2, 1, sharex=True)
    factor, unit = length_unit(float(np.max(errors[0][part], initial=0.0)))
    for view, error, colour, label in (
        (before, errors[0], OTHER, f"before: {told[0]}"),
        (after, errors[1], SCORED, f"after: {told[1]}"),
    ):
        line(upper, view.time, np.maximum(error * factor, 1e-6), colour, label, 1.4)
    small = min(_rms(e[part]) for e in errors) < WIDE * max(_rms(e[part]) for e in errors)
    if small:
        upper.set_yscale("log")
        peak = max(float(np.max(e, initial=0.0)) for e in errors) * factor
        upper.set_ylim(max(peak * 1e-5, 1e-5), 2 * peak)
    else:
        upper.set_ylim(bottom=0)
    axis = int(np.argmax(np.ptp(before.command[part], axis=0))) if len(before.command[part]) else 0
    for view, colour in ((before, OTHER), (after, SCORED)):
        line(lower, view.time, view.command[:, axis], colour, "", 1.1)
    for panel in (upper, lower):
        time_axis(panel, after, labelled=panel is upper)
    dress(upper, "", f"{name} in {unit}")
    dress(lower, "time in s", f"{before.axes[axis]} command in {before.command_unit}")
    note(lower, "the axis whose command moves most")
    legend(upper)
    return drawn


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def front(
    points: np.ndarray,
    kept: np.ndarray,
    suggested: int,
    before: np.ndarray,
    labels: Sequence[str],
    footer: str,
) -> Figure:
    """Trade-offs: every pair of objectives, points that none beats joined, the suggestion marked.

    points: (n, m). kept: (n,) bool, those on the front. suggested: index among all. before: (m,).
    labels: of the objectives, with units.
    """
    pairs = [(a, b) for a in range(len(labels)) for b in range(a + 1, len(labels))]
    text = (
        "Each dot is one tuning with other weights, averaged over the training runs. Filled: no "
        "other is better in every objective. Star: the suggested compromise, nearest to the best "
        "of all objectives in their own ranges. Cross: the gains before."
    )
    drawn = sheet_page("trade-offs", text, footer, 6.4 * len(pairs) + 0.6, 7.2)
    panels = drawn.subplots(1, len(pairs), squeeze=False)[0]
    for ax, (a, b) in zip(panels, pairs, strict=True):
        ax.plot(*points[~kept][:, [a, b]].T, "o", color=OTHER, fillstyle="none", label="beaten")
        ax.plot(*points[kept][:, [a, b]].T, "o", color=SCORED, label="front")
        if len(labels) == 2:
            order = np.argsort(points[kept][:, a])
            ax.plot(*points[kept][order][:, [a, b]].T, color=SCORED, linewidth=1.0)
        ax.plot(
            *points[suggested, [a, b]], "*", color=AXIS_COLOURS[1], markersize=18, label="suggested"
        )
        ax.plot(*before[[a, b]], "X", color=REFERENCE, markersize=10, label="before")
        for axis, index in ((ax.xaxis, a), (ax.yaxis, b)):
            every = np.append(points[kept][:, index], before[index])
            if every.min() > 0 and every.max() > every.min() / WIDE:
                axis.axes.set_xscale("log") if axis is ax.xaxis else axis.axes.set_yscale("log")
        dress(ax, labels[a], labels[b])
        ax.tick_params(which="minor", labelsize=SMALL - 2)
    panels[0].legend(loc="upper right", fontsize=SMALL, frameon=True, framealpha=0.9)
    panels[0].set_title("", fontsize=NORMAL)
    return drawn
