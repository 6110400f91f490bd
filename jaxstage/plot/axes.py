"""Position and following error of each axis."""

import numpy as np
from matplotlib.figure import Figure

from jaxstage.metrics.words import length_unit
from jaxstage.plot.style import (
    REFERENCE,
    axis_colours,
    dress,
    figure,
    legend,
    limit,
    line,
    mark,
    reversals,
    time_axis,
)
from jaxstage.plot.view import View


def axes(view: View) -> Figure:
    """Per axis: reference and actual position in mm, below it the following error."""
    count = len(view.axes)
    drawn = figure(view, "position and following error", (15.0, 1.6 + 4.6 * count))
    panels = drawn.subplots(
        2 * count, 1, sharex=True, squeeze=False, height_ratios=[1.0, 1.25] * count
    )[:, 0]
    part = view.scored_ticks()
    for axis, (name, colour) in enumerate(zip(view.axes, axis_colours(view), strict=True)):
        where, error = panels[2 * axis], panels[2 * axis + 1]
        factor, unit = length_unit(float(np.max(np.abs(view.error[part, axis]), initial=0.0)))
        line(where, view.time, view.tool[:, axis] * 1e3, colour, f"{name} actual", 3.0)
        line(where, view.time, view.reference[:, axis] * 1e3, REFERENCE, f"{name} reference", 1.1)
        line(error, view.time, view.error[:, axis] * factor, colour, f"{name} reference - actual")
        turns = reversals(view, axis)
        if len(turns) <= 12:
            mark(error, turns * view.dt, REFERENCE, f"{name} reverses")
        limit(error, view.error[part, axis], view.error[:, axis], factor, unit)
        for panel, label in ((where, f"{name} in mm"), (error, f"error {name} in {unit}")):
            time_axis(panel, view, labelled=panel is panels[0])
            dress(panel, "time in s" if panel is panels[-1] else "", label)
            legend(panel)
    return drawn
