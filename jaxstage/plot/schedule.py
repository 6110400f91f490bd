"""The gains that a cross-coupled law scheduled."""

from matplotlib.figure import Figure

from jaxstage.plot.style import AXIS_COLOURS, dress, figure, legend, line, time_axis
from jaxstage.plot.view import View

GAINS = (("K_P", "1/s²"), ("K_I", "1/s³"), ("K_D", "1/s"))


def schedule(view: View) -> Figure:
    """K_P, K_I and K_D of the contour law in time. Raises ValueError for a law without them."""
    if view.schedule is None:
        raise ValueError("this law schedules no contour gains")
    drawn = figure(view, "scheduled contour gains", (15.0, 10.5))
    panels = drawn.subplots(3, 1, sharex=True)
    for index, (panel, (name, unit)) in enumerate(zip(panels, GAINS, strict=True)):
        line(panel, view.time, view.schedule[:, index], AXIS_COLOURS[index], name)
        time_axis(panel, view, labelled=index == 0)
        dress(panel, "time in s" if index == 2 else "", f"{name} in {unit}")
        legend(panel)
    return drawn
