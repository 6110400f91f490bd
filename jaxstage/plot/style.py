"""How every figure looks: colours, title with verdict, footer, shading, markers.

Colours are those of Okabe and Ito, which colour-blind readers can tell apart.
"""

from collections.abc import Sequence
from itertools import cycle, islice

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogFormatter, ScalarFormatter

from jaxstage.metrics import glitch
from jaxstage.plot.numbers import envelope, plain
from jaxstage.plot.page import LARGE as LARGE
from jaxstage.plot.page import NORMAL as NORMAL
from jaxstage.plot.page import REFERENCE as REFERENCE
from jaxstage.plot.page import SMALL as SMALL
from jaxstage.plot.page import page
from jaxstage.plot.view import View

AXIS_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
SCORED = "#0072B2"
OTHER = "#A8A8A8"
LOST = "#B00020"
SHADE = "#E9F0F7"


def axis_colours(view: View) -> list[str]:
    """One colour per axis."""
    return list(islice(cycle(AXIS_COLOURS), len(view.axes)))


def figure(view: View, title: str, size: tuple[float, float], above: float = 0.0) -> Figure:
    """An empty figure with title, verdict and settings of a run. size, above: as of `page`."""
    colour = REFERENCE if view.lost is None else LOST
    return page(f"{view.name}: {title}", view.verdict, view.footer, size, colour, above)


def plain_ticks(side: Axis) -> FuncFormatter:
    """Ticks of a logarithmic axis as plain numbers: those that matplotlib would label."""
    labelled = LogFormatter()
    labelled.set_axis(side)

    def label(x: float, pos: int | None = None) -> str:
        labelled.set_locs()
        return plain(x) if labelled(x, pos) else ""

    return FuncFormatter(label)


def dress(ax: Axes, x: str, y: str) -> None:
    """Labels, grid and text sizes of a panel."""
    ax.set_xlabel(x, fontsize=NORMAL, parse_math=False)
    ax.set_ylabel(y, fontsize=NORMAL, parse_math=False)
    ax.tick_params(labelsize=SMALL)
    for side in (ax.xaxis, ax.yaxis):
        ticks = side.get_major_formatter()
        if isinstance(ticks, LogFormatter):
            side.set_major_formatter(plain_ticks(side))
            side.set_minor_formatter(plain_ticks(side))
        elif isinstance(ticks, ScalarFormatter):
            ticks.set_useOffset(False)
            ticks.set_powerlimits((-4, 6))
    ax.grid(True, color="#DDDDDD", linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def line(
    ax: Axes, x: np.ndarray, y: np.ndarray, colour: str, label: str = "", width: float = 1.3
) -> None:
    """A line through ascending x, thinned without losing a spike."""
    kept = envelope(x, y)
    ax.plot(x[kept], y[kept], color=colour, label=label or None, linewidth=width)


def time_axis(ax: Axes, view: View, labelled: bool = False) -> None:
    """Limits of a time axis, the scored part shaded, and where the run was lost."""
    start, stop = view.scored
    end = view.duration if view.lost is None else 1.15 * max(view.lost, 1) * view.dt
    ax.set_xlim(0, end)
    if stop > start:
        name = f"scored: {view.scored_text}" if labelled else None
        ax.axvspan(start * view.dt, stop * view.dt, color=SHADE, zorder=0, linewidth=0, label=name)
    if view.lost is not None:
        name = "lost here" if labelled else None
        ax.axvline(view.lost * view.dt, color=LOST, linewidth=1.5, linestyle="--", label=name)


def other_laps(view: View) -> str:
    """What the part of a run that metrics do not cover is called."""
    return "other laps" if len(view.laps) > 1 else "not scored"


def note(ax: Axes, text: str, align: str = "left") -> None:
    """Small text above the left end of the panel, or above its middle (``center``)."""
    ax.text(
        0.5 if align == "center" else 0.0,
        1.015,
        text,
        transform=ax.transAxes,
        ha=align,
        va="bottom",
        fontsize=SMALL,
        color="#44586B",
    )


def legend(ax: Axes) -> None:
    """The legend of a panel in one row above its right end, where it hides nothing."""
    handles, names = ax.get_legend_handles_labels()
    if names:
        ax.legend(
            handles,
            names,
            loc="lower right",
            bbox_to_anchor=(1.0, 0.985),
            fontsize=SMALL,
            ncols=len(names),
            frameon=False,
            borderaxespad=0.1,
            handlelength=1.6,
        )


def limit(ax: Axes, judged: np.ndarray, every: np.ndarray, factor: float, unit: str) -> None:
    """Scale y to the judged part if the rest is far larger; then say how large that gets.

    judged, every: values in SI; factor: display units in one SI unit.
    """
    low, high = (float(f(judged)) * factor for f in (np.min, np.max))
    margin = 0.12 * ((high - low) or abs(high) or 1.0)
    least, most = (float(f(every)) * factor for f in (np.min, np.max))
    if least > low - 8 * margin and most < high + 8 * margin:
        return
    ax.set_ylim(low - margin, high + 2 * margin)
    peak = most if abs(most) > abs(least) else least
    note(ax, f"off scale outside the scored part: {peak:.3g} {unit}")


def reversals(view: View, axis: int) -> np.ndarray:
    """Ticks of the judged part at which an axis reverses, by the rule of the quadrant glitch."""
    turned = np.flatnonzero(np.asarray(glitch.reversals(jnp.asarray(view.velocity)))[:, axis])
    part = range(len(view.velocity))[view.scored_ticks()]
    return turned[(turned >= part.start) & (turned < part.stop)]


def mark(ax: Axes, where: Sequence[float] | np.ndarray, colour: str, label: str) -> None:
    """Dotted vertical lines, named once in the legend."""
    for index, x in enumerate(where):
        ax.axvline(x, color=colour, linestyle=":", linewidth=1.4, label=None if index else label)
