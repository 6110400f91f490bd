"""Sliding variable and phase plane."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstage.metrics.words import length_unit
from jaxstage.plot.numbers import pixels
from jaxstage.plot.style import (
    REFERENCE,
    axis_colours,
    dress,
    figure,
    legend,
    limit,
    line,
    time_axis,
)
from jaxstage.plot.view import View


def surface(view: View) -> Figure:
    """Per axis: the sliding variable in time; error and its rate with the sliding line.

    Raises ValueError for a law without sliding variable.
    """
    if view.surface is None:
        raise ValueError("this law has no sliding variable")
    count = len(view.axes)
    drawn = figure(view, "sliding variable and phase plane", (16.0, 1.7 + 4.2 * count))
    panels = drawn.subplots(count, 2, squeeze=False, width_ratios=[1.2, 1.0])
    part = view.scored_ticks()
    for axis, colour in enumerate(axis_colours(view)):
        in_time, plane = panels[axis]
        values = view.surface[:, axis]
        line(in_time, view.time, values * 1e3, colour, width=1.0)
        limit(in_time, values[part], values, 1e3, "mm/s")
        time_axis(in_time, view, labelled=axis == 0)
        legend(in_time)
        dress(in_time, "time in s", f"{view.axes[axis]} sliding variable s in mm/s")
        _plane(plane, view, axis, colour)
    return drawn


def _plane(ax: Axes, view: View, axis: int, colour: str) -> None:
    """The path of (e, e') in the judged part, and the line s = 0."""
    part = view.scored_ticks()
    error, rate = view.error[part, axis], view.rate[part, axis]
    # a pixel of the panel in each direction, whatever the two scales
    kept = pixels(np.stack([_unit_range(error), _unit_range(rate)], axis=1))
    factor, unit = length_unit(float(np.max(np.abs(error), initial=0.0)))
    shown = view.scored_text if view.lost is None else "until lost"
    ax.plot(error[kept] * factor, rate[kept] * 1e3, color=colour, linewidth=0.9, label=shown)
    slope = _constant_slope(view, axis)
    if slope is not None:
        ends = np.array([error.min(), error.max()])
        ax.plot(
            ends * factor,
            -slope * ends * 1e3,
            color=REFERENCE,
            linestyle="--",
            linewidth=1.8,
            label=f"s = 0: e' = -c1 e, c1 = {slope:g} 1/s",
        )
    legend(ax)
    name = view.axes[axis]
    dress(ax, f"{name} following error e in {unit}", f"{name} rate e' in mm/s")


def _constant_slope(view: View, axis: int) -> float | None:
    """c1 where the recorded surface is +-(c1 e + e') of the error shown, else None: a slope that
    varies, or a law that acts on another side of the machine, has no line in this plane."""
    if view.slope is None or view.surface is None:
        return None
    slope = float(np.broadcast_to(view.slope, (len(view.axes),))[axis])
    made = np.abs(slope * view.error[:, axis] + view.rate[:, axis])
    off = np.max(np.abs(made - np.abs(view.surface[:, axis])), initial=0.0)
    return slope if off <= 1e-3 * np.max(made, initial=0.0) else None


def _unit_range(values: np.ndarray) -> np.ndarray:
    """Scaled to 0..1."""
    return (values - values.min()) / (np.ptp(values) or 1.0)
