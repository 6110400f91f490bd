"""What the drive was asked for, from afar, around a reversal, and tick by tick."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstage.metrics.words import time_text
from jaxstage.plot.style import (
    LOST,
    OTHER,
    REFERENCE,
    axis_colours,
    dress,
    figure,
    legend,
    line,
    note,
    reversals,
    time_axis,
)
from jaxstage.plot.view import View

#: ticks shown one by one
CLOSE = 120


def command(view: View) -> Figure:
    """Per axis: the command in the whole run, around the first reversal, and tick by tick.

    The last panel stands where the command changes its course most abruptly within the panel
    before it: there chattering and ringing show.
    """
    count = len(view.axes)
    drawn = figure(view, "command", (16.0, 1.7 + 4.0 * count))
    panels = drawn.subplots(count, 3, squeeze=False, width_ratios=[1.3, 1.0, 1.0])
    for axis, colour in enumerate(axis_colours(view)):
        whole, near, close = panels[axis]
        line(whole, view.time, view.command[:, axis], colour, width=1.0)
        if not np.array_equal(view.demand[:, axis], view.command[:, axis]):
            line(whole, view.time, view.demand[:, axis], OTHER, "demand before limits", 0.8)
        time_axis(whole, view, labelled=True)
        dress(whole, "time in s", f"{view.axes[axis]} command in {view.command_unit}")
        legend(whole)
        centre, why = _centre(view, axis)
        part = _around(view, centre, 0.02, 0.12)
        _steps(near, view, axis, part, centre, colour)
        note(near, f"{why} at {time_text(centre * view.dt)}", "center")
        inner = _busiest(view, axis, part)
        near.axvspan(*(_ms(view, k, centre) for k in inner), color="#F3E3B3", zorder=0)
        _steps(close, view, axis, inner, centre, colour)
        note(close, f"the shaded {time_text(len(range(*inner)) * view.dt)}, every tick", "center")
    return drawn


def _centre(view: View, axis: int) -> tuple[int, str]:
    """The tick to look at, and why."""
    name = view.axes[axis]
    if view.lost is not None:
        return view.lost, "lost"
    turns = reversals(view, axis)
    if len(turns):
        return int(turns[0]), f"{name} reverses"
    part = range(len(view.command))[view.scored_ticks()]
    jumps = np.abs(np.diff(view.command[part.start : part.stop, axis]))
    return part.start + int(np.argmax(jumps)) if len(jumps) else 0, f"largest step of {name}"


def _around(view: View, centre: int, before: float, after: float) -> tuple[int, int]:
    """Ticks from ``before`` to ``after`` seconds around the centre, but some ticks at least."""
    left, right = (max(round(t / view.dt), CLOSE // 2) for t in (before, after))
    return max(centre - left, 0), min(centre + right, len(view.command))


def _busiest(view: View, axis: int, part: tuple[int, int]) -> tuple[int, int]:
    """The stretch of `CLOSE` ticks with the largest bend of the command in its middle."""
    bend = np.abs(np.diff(view.command[slice(*part), axis], 2))
    middle = part[0] + (int(np.argmax(bend)) if len(bend) else 0)
    start = max(min(middle - CLOSE // 2, part[1] - CLOSE), part[0])
    return start, min(start + CLOSE, part[1])


def _ms(view: View, tick: int, centre: int) -> float:
    return (tick - centre) * view.dt * 1e3


def _steps(
    ax: Axes, view: View, axis: int, part: tuple[int, int], centre: int, colour: str
) -> None:
    """The steps that the drive holds; time counts from the centre."""
    ticks = np.arange(*part)
    ax.plot(
        (ticks - centre) * view.dt * 1e3,
        view.command[ticks, axis],
        drawstyle="steps-post",
        color=colour,
        linewidth=1.2,
        marker="." if len(ticks) <= CLOSE else "",
        markersize=4,
    )
    if part[0] <= centre <= part[1]:
        colour = REFERENCE if view.lost is None else LOST
        ax.axvline(0, color=colour, linestyle=":", linewidth=1.4)
    ax.margins(x=0.02)
    # a flat command must look flat
    least = 0.05 * float(np.ptp(view.command[:, axis]))
    low, high = ax.get_ylim()
    wider = max(least - (high - low), 0.0) / 2
    ax.set_ylim(low - wider, high + wider)
    dress(ax, "time from there in ms", "")
