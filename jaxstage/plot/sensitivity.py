"""Plots of what uncertain values do to a metric: first-order effects and Sobol indices."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstage.plot.sheet import Sheet, sheet_page
from jaxstage.plot.style import AXIS_COLOURS, LOST, REFERENCE, SMALL, dress


class Effect(NamedTuple):
    """One bar of a tornado: the metric at the low and at the high end of a value, to first order.

    seen: the median metric of the plants in the lowest and in the highest tenth, or None.
    """

    name: str
    low: float
    high: float
    seen: tuple[float, float] | None = None


def tornado(
    name: str,
    nominal: float,
    effects: Sequence[Effect],
    sheet: Sheet,
    left_out: Sequence[str] = (),
) -> Figure:
    """First-order effect of each value around the nominal plant, the largest on top. left_out: what
    has no slope."""
    text = (
        "Bars: from one differentiated run of the nominal plant, its slope times the way to the "
        "5 % and the 95 % quantile of each value alone. Diamonds: what the sweep shows, the median "
        "of the plants in the lowest and in the highest tenth of that value, all others spread "
        "(so they may lie beside the nominal plant, and scatter by chance). Where a pair spans "
        "clearly more or less than its bar, the slope does not hold over the spread."
    )
    if left_out:
        text += f" Not drawn, as there is no slope: {', '.join(left_out)}."
    title = f"{name}: first-order effect of each uncertain value"
    drawn = sheet_page(title, text, sheet.footer, 12, 3.2 + 0.42 * len(effects))
    ax = drawn.subplots()
    for row, effect in enumerate(effects):
        for end, colour, which in (
            (effect.low, AXIS_COLOURS[0], "at its 5 % quantile"),
            (effect.high, AXIS_COLOURS[1], "at its 95 % quantile"),
        ):
            label = which if row == 0 else None
            ax.barh(row, end - nominal, left=nominal, height=0.7, color=colour, label=label)
        for x, colour in zip(effect.seen or (), AXIS_COLOURS, strict=False):
            ax.plot(
                x,
                row,
                marker="D",
                markersize=7,
                color=colour,
                markeredgecolor=REFERENCE,
                linestyle="",
                zorder=4,
            )
    ax.axvline(nominal, color=REFERENCE, linewidth=1.2)
    ax.set_yticks(range(len(effects)), [effect.name for effect in effects])
    ax.invert_yaxis()
    dress(ax, f"{sheet.label} (nominal plant: {nominal:.4g})", "")
    ax.grid(False, axis="y")
    if sheet.limit is not None and _near(sheet.limit, nominal, effects):
        ax.axvline(sheet.limit, color=LOST, linestyle="--", linewidth=1.5, label="limit")
    _legend_above(ax)
    return drawn


def _legend_above(ax: Axes) -> None:
    """In one row over the axes: no bar and no mark is hidden."""
    ax.legend(
        loc="lower right",
        bbox_to_anchor=(1, 1),
        ncols=3,
        fontsize=SMALL,
        frameon=False,
        borderaxespad=0.2,
    )


def _near(limit: float, nominal: float, effects: Sequence[Effect]) -> bool:
    """Whether the limit can be drawn without squeezing the bars."""
    reach = max((abs(end - nominal) for e in effects for end in (e.low, e.high)), default=0.0)
    return abs(limit - nominal) <= 3 * reach


class Index(NamedTuple):
    """Sobol indices of a value and half widths of their intervals."""

    name: str
    first: float
    first_error: float
    total: float
    total_error: float


def indices(name: str, values: Sequence[Index], sheet: Sheet) -> Figure:
    """First and total Sobol index of each value, the largest on top."""
    text = (
        "Share of the variance of the metric that a value explains alone (S1) and with all its "
        "interactions (ST), with 95 % intervals."
    )
    order = sorted(values, key=lambda index: -index.total)
    title = f"{name}: Sobol indices of {sheet.label}"
    drawn = sheet_page(title, text, sheet.footer, 12, 2.0 + 0.5 * len(order))
    ax = drawn.subplots()
    rows = np.arange(len(order))
    for shift, colour, label, value, error in (
        (-0.19, AXIS_COLOURS[0], "S1, alone", "first", "first_error"),
        (0.19, AXIS_COLOURS[1], "ST, with interactions", "total", "total_error"),
    ):
        ax.barh(
            rows + shift,
            [getattr(i, value) for i in order],
            height=0.36,
            color=colour,
            label=label,
            xerr=[getattr(i, error) for i in order],
            error_kw={"ecolor": REFERENCE, "linewidth": 1.1, "capsize": 2.5},
        )
    ax.set_yticks(rows, [index.name for index in order])
    ax.invert_yaxis()
    ax.axvline(0, color=REFERENCE, linewidth=0.8)
    dress(ax, "share of the variance", "")
    ax.grid(False, axis="y")
    _legend_above(ax)
    return drawn
