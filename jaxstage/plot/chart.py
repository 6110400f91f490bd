"""Panels of lines or bars computed from a study's evidence."""

import textwrap
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstage import __version__
from jaxstage.plot.page import page
from jaxstage.plot.style import AXIS_COLOURS, NORMAL, SMALL, dress
from jaxstage.studies.plots import Chart

COLOURS = (*AXIS_COLOURS, "#56B4E9", "#E69F00", "#7F7F7F")
WIDTH, HEIGHT = 7.2, 5.2


def chart(title: str, text: str, panels: tuple[Chart, ...]) -> Figure:
    """One figure of panels, up to three a row. title: of the figure. text: how to read it."""
    columns = 2 if len(panels) == 4 else min(len(panels), 3)
    rows = -(-len(panels) // columns)
    size = (WIDTH * columns + 0.6, HEIGHT * rows + 1.7)
    drawn = page(title, text, f"jaxstage {__version__}", size)
    for ax, panel in zip(drawn.subplots(rows, columns, squeeze=False).flat, panels, strict=False):
        _panel(ax, panel)
    for ax in drawn.axes[len(panels) :]:
        ax.set_visible(False)
    return drawn


def _panel(ax: Axes, panel: Chart) -> None:
    if panel.bars:
        _bars(ax, panel)
    else:
        for line, colour in zip(panel.lines, cycle(COLOURS)):
            few = len(line.x) <= 40
            ax.plot(
                np.asarray(line.x),
                _numbers(line.y),
                label=line.label,
                color=colour,
                linewidth=1.4,
                marker="o" if few else "",
                markersize=4,
            )
    if panel.log_x:
        ax.set_xscale("log")
    if panel.log_y:
        ax.set_yscale("log")
    if panel.equal:
        ax.set_aspect("equal", adjustable="datalim")
    dress(ax, panel.x, panel.y)
    if panel.bars:
        ax.grid(False, axis="x")
    ax.set_title(panel.title, fontsize=NORMAL, loc="left")
    if len(panel.lines) > 1:
        columns = 4 if len(panel.lines) > 4 else 2
        ax.legend(
            loc="lower left",
            bbox_to_anchor=(0, 1.06),
            ncols=columns,
            frameon=False,
            fontsize=SMALL,
            borderaxespad=0,
        )
    if panel.text:
        ax.text(
            0.5,
            -0.17,
            textwrap.fill(panel.text, 80),
            transform=ax.transAxes,
            ha="center",
            va="top",
            fontsize=SMALL,
            color="#44586B",
        )


def _bars(ax: Axes, panel: Chart) -> None:
    """Groups of bars, a number over each; a lost run leaves a gap."""
    names = list(panel.lines[0].x)
    wide = 0.8 / len(panel.lines)
    for index, (line, colour) in enumerate(zip(panel.lines, cycle(COLOURS))):
        where = np.arange(len(names)) + (index - (len(panel.lines) - 1) / 2) * wide
        values = _numbers(line.y)
        ax.bar(where, values, wide * 0.92, color=colour, label=line.label)
        for x, value in zip(where, values, strict=True):
            if np.isfinite(value):
                ax.annotate(
                    f"{value:.3g}",
                    (x, value),
                    (0, 2),
                    textcoords="offset points",
                    ha="center",
                    va="bottom",
                    fontsize=SMALL - 2.5,
                    rotation=90 if len(panel.lines) > 3 else 0,
                )
    ax.set_xticks(np.arange(len(names)), names)
    ax.margins(y=0.16)


def _numbers(values: object) -> np.ndarray:
    """Floats, NaN for None."""
    return np.asarray([np.nan if v is None else float(v) for v in list(values)])  # type: ignore[call-overload]
