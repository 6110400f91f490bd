"""Plots of a sweep: distribution, parameters, controller against controller.

They draw plain arrays; a metric is an error, smaller is better, NaN for a lost run.
"""

import math
from collections.abc import Sequence
from itertools import cycle
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator
from matplotlib.transforms import ScaledTranslation

from jaxstage.plot.numbers import plain
from jaxstage.plot.sheet import Sheet, log_where_wide, sheet_page
from jaxstage.plot.style import AXIS_COLOURS, LOST, NORMAL, REFERENCE, SMALL, dress

#: share of the values that a scatter shows at least, where the others reach beyond so many times
#: their span
MOST_SHOWN, FAR = 0.98, 3.0
#: points of a scatter that are drawn, of those that pass
POINTS = 3000
#: dots of fewer plants are larger
FEW = 200
#: slices whose medians are drawn, from so many plants on
SLICES, MEDIANS_FROM = 12, 120
#: bins of all samples together
MOST_BINS = 400


class MetricSample(NamedTuple):
    """One loop of a sweep. values: its metric, (n,), NaN where lost. passed: (n,), or None without
    a specification. text: what is said of it. met: share that meets the specification, and its
    interval, or None. chance: whether the plants are a sample of the spreads, as a band needs."""

    name: str
    values: np.ndarray
    passed: np.ndarray | None
    text: str = ""
    met: tuple[float, float, float] | None = None
    chance: bool = True


def distribution(samples: Sequence[MetricSample], sheet: Sheet) -> Figure:
    """Histogram and cumulative share of the metric, a curve a loop, with the specification."""
    text = (
        "Left: how often each value occurs. Right: share of all plants with at most this value, "
        "with its 95 % band (Dvoretzky-Kiefer-Wolfowitz); a curve that ends below 1 has lost runs. "
        "Bar at the limit: share that meets the whole specification, 95 % interval."
        if all(sample.chance for sample in samples)
        else "Left: how often each value occurs. Right: share of the plants that were run with at "
        "most this value; a curve that ends below 1 has lost runs. These plants are no sample of "
        "the spreads: the shares are no probabilities."
    )
    drawn = sheet_page(
        f"{sheet.label}: its distribution over the plants", text, sheet.footer, 17, 7.5
    )
    often, share = drawn.subplots(1, 2)
    every = [s.values for s in samples]
    if not any(np.isfinite(v).any() for v in every):
        often.text(0.5, 0.5, "all runs were lost", ha="center", fontsize=NORMAL, color=LOST)
        return drawn
    logarithmic = log_where_wide((often.set_xscale, share.set_xscale), *every)
    bins = _bins([s.values[np.isfinite(s.values)] for s in samples], logarithmic)
    for index, (sample, colour) in enumerate(zip(samples, cycle(AXIS_COLOURS))):
        kept = sample.values[np.isfinite(sample.values)]
        often.hist(kept, bins.tolist(), color=colour, histtype="stepfilled", alpha=0.25)
        often.hist(kept, bins.tolist(), color=colour, histtype="step", linewidth=1.5)
        _cumulative(share, sample, kept, colour)
        if sheet.limit is not None and sample.met is not None:
            _yield_mark(share, sheet.limit, sample.met, colour, index - (len(samples) - 1) / 2)
    often.yaxis.set_major_locator(MaxNLocator(integer=True))
    for ax, side in ((often, "plants"), (share, "share of plants")):
        dress(ax, sheet.label, side)
        if sheet.limit is not None:
            ax.axvline(sheet.limit, color=LOST, linestyle="--", linewidth=1.5)
    if sheet.limit is not None:
        often.text(
            sheet.limit,
            1.0,
            f"limit {plain(sheet.limit)}",
            transform=often.get_xaxis_transform(),
            ha="center",
            va="bottom",
            fontsize=SMALL,
            color=LOST,
        )
    share.set_ylim(0, 1.02)
    share.legend(loc="lower left", bbox_to_anchor=(0, 1.0), fontsize=SMALL, frameon=False)
    return drawn


def _yield_mark(
    ax: Axes, limit: float, met: tuple[float, float, float], colour: str, place: float
) -> None:
    """The yield with its interval. place: marks beside the limit, so that none is hidden."""
    value, least, most = met
    beside = ax.transData + ScaledTranslation(place * 0.14, 0, ax.figure.dpi_scale_trans)
    ax.errorbar(
        limit,
        value,
        [[value - least], [most - value]],
        color=colour,
        marker="o",
        markersize=6,
        capsize=4,
        elinewidth=2,
        zorder=5,
        transform=beside,
    )


def _bins(samples: Sequence[np.ndarray], logarithmic: bool) -> np.ndarray:
    """Edges of bins that all samples share, so narrow that the narrowest has about ten: heights
    can be compared, however far apart the samples lie."""
    values = [np.log10(s) if logarithmic else s for s in samples if len(s)]
    low, high = min(map(np.min, values)), max(map(np.max, values))
    high = high if high > low else low + max(abs(low), 1.0) * 1e-3
    narrowest = min((np.ptp(v) for v in values if np.ptp(v) > 0), default=high - low)
    each = min(40, 5 + math.sqrt(max(map(len, values))) / 3)
    edges = np.linspace(low, high, 1 + min(MOST_BINS, math.ceil(each * (high - low) / narrowest)))
    edges = 10**edges if logarithmic else edges
    ends = np.concatenate(samples)
    edges[[0, -1]] = min(edges[0], ends.min()), max(edges[-1], ends.max())  # of the rounding
    return edges


def _cumulative(ax: Axes, sample: MetricSample, kept: np.ndarray, colour: str) -> None:
    runs = len(sample.values)
    x = np.sort(kept)
    y = np.arange(1, len(x) + 1) / runs
    thin = np.unique(np.linspace(0, len(x) - 1, 2000).astype(int)) if len(x) else []
    band = math.sqrt(math.log(2 / 0.05) / (2 * runs))
    lost = runs - len(kept)
    label = sample.name + (f": {sample.text}" if sample.text else "")
    label += f"; {lost} lost" if lost else ""
    ax.step(x[thin], y[thin], where="post", color=colour, linewidth=1.8, label=label)
    if sample.chance:
        ax.fill_between(
            x[thin],
            np.maximum(y[thin] - band, 0),
            np.minimum(y[thin] + band, 1),
            step="post",
            color=colour,
            alpha=0.18,
            linewidth=0,
        )


def parameters(
    sample: MetricSample,
    columns: dict[str, np.ndarray],
    correlations: dict[str, float | None],
    sheet: Sheet,
) -> Figure:
    """The metric against each uncertain value, the strongest rank correlation first; failing plants
    marked.

    columns, correlations: label with unit -> (n,) values, and their rank correlation.
    """
    order = sorted(columns, key=lambda name: -abs(correlations.get(name) or 0.0))
    across = min(4, len(order))
    rows = -(-len(order) // across)
    text = _legend(sample)
    if sheet.limit is not None and not _beside(sheet.limit, sample.values):
        text += f" The limit of {plain(sheet.limit)} is off the scale."
    title = f"{sample.name}: {sheet.label} against each uncertain value"
    drawn = sheet_page(title, text, sheet.footer, max(4.4 * across + 0.4, 7.0), 3.5 * rows + 1.6)
    panels = drawn.subplots(rows, across, squeeze=False, sharey=True)
    finite = sample.values[np.isfinite(sample.values)]
    seen = sheet.limit is None or _beside(sheet.limit, finite)
    for index, (ax, name) in enumerate(zip(panels.flat, order, strict=False)):
        log_where_wide((ax.set_yscale,), sample.values)
        _scatter(ax, columns[name], sample, finite)
        rho = correlations.get(name)
        told = "" if rho is None else f"rho {round(rho, 2) + 0.0:+.2f}"  # no -0.00
        ax.set_title(told, fontsize=NORMAL, loc="right")
        dress(ax, name, sheet.label if index % across == 0 else "")
        few = np.unique(columns[name])
        ax.xaxis.set_major_locator(FixedLocator(few.tolist()) if len(few) <= 4 else MaxNLocator(4))
        if sheet.limit is not None and seen:
            ax.axhline(sheet.limit, color=LOST, linestyle="--", linewidth=1.2)
    for ax in list(panels.flat)[len(order) :]:
        ax.set_visible(False)
    return drawn


def _legend(sample: MetricSample) -> str:
    """What is drawn of the plants, and nothing that is not."""
    lost = ~np.isfinite(sample.values)
    text = (
        "Each dot is one plant. rho: rank correlation, lost runs as the worst, the strongest "
        "first; it sees a trend, not a valley."
    )
    if np.sum(~lost) >= MEDIANS_FROM:
        text += f" Black: median of {SLICES} slices, or of each value."
    if sample.passed is not None and np.any(~sample.passed & ~lost):
        text += " Crosses do not meet the specification."
    return text + (" Triangles at the top were lost." if lost.any() else "")


def _beside(limit: float, values: np.ndarray) -> bool:
    """Whether a limit can be drawn with the values without squeezing them."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return True
    low, high = finite.min(), finite.max()
    return low - (high - low) <= limit <= high + (high - low)


def _scatter(ax: Axes, x: np.ndarray, sample: MetricSample, finite: np.ndarray) -> None:
    lost = ~np.isfinite(sample.values)
    failed = np.zeros(len(x), bool) if sample.passed is None else ~sample.passed & ~lost
    good = np.flatnonzero(~failed & ~lost)
    shown = good[:: max(1, len(good) // POINTS)]
    ax.plot(
        x[shown],
        sample.values[shown],
        linestyle="",
        marker=".",
        markersize=3 + 4 * (len(x) < FEW),
        color=AXIS_COLOURS[0],
        alpha=0.5,
        rasterized=True,
    )
    bad = np.flatnonzero(failed)
    bad = bad[:: max(1, len(bad) // POINTS)]
    ax.plot(
        x[bad],
        sample.values[bad],
        linestyle="",
        marker="x",
        markersize=4,
        color=LOST,
        alpha=0.7,
        rasterized=True,
    )
    if lost.any():
        where = x[lost][:POINTS]
        ax.plot(
            where,
            np.full(len(where), 0.985),
            linestyle="",
            marker="v",
            markersize=5,
            color=LOST,
            transform=ax.get_xaxis_transform(),
        )
    _medians(ax, x[~lost], finite)


def _medians(ax: Axes, x: np.ndarray, y: np.ndarray) -> None:
    if len(x) < MEDIANS_FROM or np.ptp(x) == 0:
        return
    few = np.unique(x)
    parts = (
        [np.flatnonzero(x == value) for value in few]
        if len(few) <= SLICES
        else np.array_split(np.argsort(x, kind="stable"), SLICES)
    )
    middle = [np.median(x[part]) for part in parts]
    ax.plot(middle, [np.median(y[part]) for part in parts], color=REFERENCE, linewidth=1.6)


def versus(a: MetricSample, b: MetricSample, text: str, sheet: Sheet) -> Figure:
    """One controller against another on the same plants. text: the comparison in words."""
    drawn = sheet_page(f"{a.name} against {b.name}", text, sheet.footer, 9.5, 9.5)
    ax = drawn.subplots()
    both = np.isfinite(a.values) & np.isfinite(b.values)
    logarithmic = log_where_wide((ax.set_xscale, ax.set_yscale), a.values, b.values)
    x, y = a.values[both], b.values[both]
    step = max(1, len(x) // (2 * POINTS))
    for part, colour, label in (
        (x < y, AXIS_COLOURS[0], f"{a.name} smaller"),
        (x > y, AXIS_COLOURS[1], f"{b.name} smaller"),
        (x == y, REFERENCE, "the same"),
    ):
        if colour == REFERENCE and not part.any():
            continue
        ax.plot(
            x[part][::step],
            y[part][::step],
            linestyle="",
            marker=".",
            markersize=3.5,
            alpha=0.5,
            color=colour,
            label=f"{label}: {part.sum()} plants",
            rasterized=True,
        )
    if both.any():
        ends = _one_scale(ax, np.concatenate([x, y]), logarithmic)
        ax.plot(ends, ends, color=REFERENCE, linewidth=1.2, label="equal")
        beyond = int((np.maximum(x, y) > ends[1]).sum())
        if beyond:
            ax.plot([], [], linestyle="", label=f"beyond the scale: {beyond} plants")
    gone = int((~both).sum())
    if gone:
        ax.plot([], [], linestyle="", label=f"lost under one or both: {gone} plants")
    if sheet.limit is not None and ax.get_xlim()[0] <= sheet.limit <= ax.get_xlim()[1]:
        ax.axvline(sheet.limit, color=LOST, linestyle="--", linewidth=1.2)
        ax.axhline(sheet.limit, color=LOST, linestyle="--", linewidth=1.2, label="limit")
    elif sheet.limit is not None:
        ax.plot([], [], linestyle="", label=f"limit {plain(sheet.limit)}: off the scale")
    dress(ax, f"{a.name}: {sheet.label}", f"{b.name}: {sheet.label}")
    ax.legend(loc="best", fontsize=SMALL, frameon=True, framealpha=0.9)
    return drawn


def _one_scale(ax: Axes, values: np.ndarray, logarithmic: bool) -> list[float]:
    """Both axes over the same values, in a square; returns the ends of the diagonal.

    A few values far above all others are cut off: they would squeeze these into a corner.
    """
    low, high = float(values.min()), float(values.max())
    most = float(np.quantile(values, MOST_SHOWN))
    high = most if not logarithmic and high - low > FAR * (most - low) > 0 else high
    if logarithmic:
        low, high = low / 1.1, high * 1.1
    else:
        margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
        low, high = low - margin, high + margin
    ax.set_xlim(low, high)
    ax.set_ylim(low, high)
    ax.set_box_aspect(1)
    return [low, high]
