"""Contour error against time and along the lap."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstage.metrics.words import length_unit
from jaxstage.plot.numbers import envelope
from jaxstage.plot.style import (
    OTHER,
    SCORED,
    axis_colours,
    dress,
    figure,
    legend,
    limit,
    line,
    mark,
    other_laps,
    reversals,
    time_axis,
)
from jaxstage.plot.view import View


def error(view: View) -> Figure:
    """Contour error and length of the following error in time; contour error over arc length."""
    drawn = figure(view, "contour error", (15.0, 10.0))
    upper, lower = drawn.subplots(2, 1)
    part = view.scored_ticks()
    following = np.linalg.norm(view.error, axis=1)
    both = np.maximum(view.distance, following)
    factor, unit = length_unit(float(np.max(both[part], initial=0.0)))
    factor, unit = (factor, unit) if view.lost is None else (1e6, "µm")
    line(upper, view.time, following * factor, OTHER, "|following error|", 2.2)
    line(upper, view.time, view.distance * factor, SCORED, "contour error", 1.4)
    limit(upper, np.append(both[part], 0.0), both, factor, unit)
    time_axis(upper, view, labelled=True)
    dress(upper, "time in s", f"error in {unit}")
    legend(upper)
    _along(lower, view, factor, unit)
    for ax in (upper, lower):
        _upwards(ax, view)
    return drawn


def _upwards(ax: Axes, view: View) -> None:
    """From zero; for a lost run logarithmic from 0.01 µm, where divergence is a straight line."""
    if view.lost is None:
        ax.set_ylim(bottom=0)
    else:
        ax.set_yscale("log", nonpositive="clip")
        ax.set_ylim(bottom=1e-2, top=2e6 * max(float(np.max(view.distance, initial=0.0)), 1e-6))


def _along(ax: Axes, view: View, factor: float, unit: str) -> None:
    """The laps over each other, the scored one on top, with the reversals of the axes."""
    part = view.scored_ticks()
    others = [lap for lap in view.laps if not view.is_scored(lap)]
    judged = [lap for lap in view.laps if view.is_scored(lap)]
    named = other_laps(view) if view.lost is None else "until lost"
    for index, lap in enumerate(others):
        _lap(ax, view, slice(*lap), factor, OTHER, "" if index else named)
    for index, lap in enumerate(judged):
        name = "" if index else f"scored: {view.scored_text}"
        _lap(ax, view, slice(*lap), factor, SCORED, name)
    for axis, colour in enumerate(axis_colours(view)):
        turns = reversals(view, axis)
        if len(turns) <= 12:
            mark(ax, view.arc[turns] * 1e3, colour, f"{view.axes[axis]} reverses")
    limit(ax, np.append(view.distance[part], 0.0), view.distance, factor, unit)
    ax.set_xlim(0, _lap_length(view) * 1e3)
    dress(ax, "arc length along the lap in mm", f"contour error in {unit}")
    legend(ax)


def _lap(ax: Axes, view: View, ticks: slice, factor: float, colour: str, label: str) -> None:
    # the nearest point may step back, and across the closure of the lap: order by arc
    order = np.argsort(view.arc[ticks], kind="stable")
    arc, distance = view.arc[ticks][order], view.distance[ticks][order]
    kept = envelope(arc, distance)
    # no line over a stretch that was never near the tool
    gaps = np.flatnonzero(np.diff(arc[kept]) > 0.05 * _lap_length(view)) + 1
    x, y = (np.insert(v[kept], gaps, np.nan) for v in (arc * 1e3, distance * factor))
    ax.plot(x, y, color=colour, label=label or None, linewidth=1.5)


def _lap_length(view: View) -> float:
    steps = np.linalg.norm(np.diff(view.curve, axis=0), axis=1)
    return max(float(np.sum(steps)), float(np.max(view.arc, initial=0.0)))
