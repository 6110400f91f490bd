"""Pictures of a sweep: distribution, parameters, effects, controller against controller.

They draw plain arrays; a figure is an error, smaller is better, NaN for a lost run.
"""

import math
import textwrap
from collections.abc import Sequence
from itertools import cycle
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator

from jaxstage.plot.style import AXIS_COLOURS, LARGE, LOST, NORMAL, REFERENCE, SMALL, dress

#: points of a scatter that are drawn, of those that pass
POINTS = 3000
#: dots of fewer plants are larger
FEW = 200
#: slices whose medians are drawn, from so many plants on
SLICES, MEDIANS_FROM = 12, 120
#: bins of all samples together
MOST_BINS = 400
#: a figure that spans more than this ratio is drawn on a log axis
DECADES = 20.0


class Sample(NamedTuple):
    """One loop of a sweep. values: its figure, (n,), NaN where lost. passed: (n,), or None without
    a specification. text: what is said of it. met: share that meets the specification, and its
    interval, or None. chance: whether the plants are a sample of the spreads, as a band needs."""

    name: str
    values: np.ndarray
    passed: np.ndarray | None
    text: str = ""
    met: tuple[float, float, float] | None = None
    chance: bool = True


class Sheet(NamedTuple):
    """What all pictures of a sweep share. label: of the figure, with unit. limit: of the
    specification, or None. footer: settings, seed, version."""

    label: str
    limit: float | None
    footer: str


def sheet_figure(title: str, text: str, footer: str, width: float, height: float) -> Figure:
    """An empty figure with title, explanation and footer."""
    drawn = Figure(figsize=(width, height), dpi=100, layout="constrained", facecolor="white")
    lines = textwrap.wrap(text, int(10.4 * width))
    footer = "\n".join(line.strip(" |") for line in textwrap.wrap(footer, int(12 * width)))
    top = 0.6 + 0.24 * len(lines)
    engine = drawn.get_layout_engine()
    assert engine is not None
    low = (0.24 + 0.18 * (1 + footer.count("\n"))) / height
    engine.set(rect=(0.005, low, 0.99, 1 - top / height - low), w_pad=0.1, h_pad=0.08)  # type: ignore[call-arg]
    left = 0.25 / width
    drawn.text(left, 1 - 0.14 / height, title, va="top", fontsize=LARGE, weight="bold")
    drawn.text(left, 1 - 0.55 / height, "\n".join(lines), va="top", fontsize=NORMAL - 1)
    drawn.text(left, 0.12 / height, footer, va="bottom", fontsize=SMALL, color="#555555")
    return drawn


def scale(ax_set: Sequence[object], *values: np.ndarray) -> bool:
    """Set log scales where the values span a wide range; returns whether it did."""
    finite = np.concatenate([v[np.isfinite(v)] for v in values])
    if len(finite) and finite.min() > 0 and finite.max() > DECADES * finite.min():
        for set_scale in ax_set:
            set_scale("log")  # type: ignore[operator]
        return True
    return False


def distribution(samples: Sequence[Sample], sheet: Sheet) -> Figure:
    """Histogram and cumulative share of the figure, a curve a loop, with the specification."""
    text = (
        "Left: how often each value occurs. Right: share of all plants with at most this value, "
        "with its 95 % band (Dvoretzky-Kiefer-Wolfowitz); a curve that ends below 1 has lost runs. "
        "Bar on the limit: share that meets the whole specification, 95 % interval."
        if all(sample.chance for sample in samples)
        else "Left: how often each value occurs. Right: share of the plants that were run with at "
        "most this value; a curve that ends below 1 has lost runs. These plants are no sample of "
        "the spreads: the shares are no probabilities."
    )
    drawn = sheet_figure(
        f"{sheet.label}: its distribution over the plants", text, sheet.footer, 17, 7.5
    )
    often, share = drawn.subplots(1, 2)
    every = [s.values for s in samples]
    if not any(np.isfinite(v).any() for v in every):
        often.text(0.5, 0.5, "all runs were lost", ha="center", fontsize=NORMAL, color=LOST)
        return drawn
    logarithmic = scale((often.set_xscale, share.set_xscale), *every)
    bins = _bins([s.values[np.isfinite(s.values)] for s in samples], logarithmic)
    for sample, colour in zip(samples, cycle(AXIS_COLOURS)):
        kept = sample.values[np.isfinite(sample.values)]
        often.hist(kept, bins.tolist(), color=colour, histtype="stepfilled", alpha=0.25)
        often.hist(kept, bins.tolist(), color=colour, histtype="step", linewidth=1.5)
        _cumulative(share, sample, kept, colour)
        if sheet.limit is not None and sample.met is not None:
            value, least, most = sample.met
            share.errorbar(
                sheet.limit,
                value,
                [[value - least], [most - value]],
                color=colour,
                marker="o",
                markersize=6,
                capsize=5,
                elinewidth=2,
                zorder=5,
            )
    often.yaxis.set_major_locator(MaxNLocator(integer=True))
    for ax, side in ((often, "plants"), (share, "share of plants")):
        dress(ax, sheet.label, side)
        if sheet.limit is not None:
            ax.axvline(sheet.limit, color=LOST, linestyle="--", linewidth=1.5)
    if sheet.limit is not None:
        often.text(
            sheet.limit,
            1.0,
            f"limit {sheet.limit:g}",
            transform=often.get_xaxis_transform(),
            ha="center",
            va="bottom",
            fontsize=SMALL,
            color=LOST,
        )
    share.set_ylim(0, 1.02)
    share.legend(loc="lower left", bbox_to_anchor=(0, 1.0), fontsize=SMALL, frameon=False)
    return drawn


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


def _cumulative(ax: Axes, sample: Sample, kept: np.ndarray, colour: str) -> None:
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
    sample: Sample,
    columns: dict[str, np.ndarray],
    correlations: dict[str, float | None],
    sheet: Sheet,
) -> Figure:
    """The figure against each uncertain value, the strongest rank correlation first; failing plants
    marked.

    columns, correlations: label with unit -> (n,) values, and their rank correlation.
    """
    order = sorted(columns, key=lambda name: -abs(correlations.get(name) or 0.0))
    across = min(4, len(order))
    rows = -(-len(order) // across)
    text = _legend(sample)
    if sheet.limit is not None and not _beside(sheet.limit, sample.values):
        text += f" The limit of {sheet.limit:g} is off the scale."
    title = f"{sample.name}: {sheet.label} against each uncertain value"
    drawn = sheet_figure(title, text, sheet.footer, 4.4 * across + 0.4, 3.5 * rows + 1.6)
    panels = drawn.subplots(rows, across, squeeze=False, sharey=True)
    finite = sample.values[np.isfinite(sample.values)]
    seen = sheet.limit is None or _beside(sheet.limit, finite)
    for index, (ax, name) in enumerate(zip(panels.flat, order, strict=False)):
        scale((ax.set_yscale,), sample.values)
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


def _legend(sample: Sample) -> str:
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


def _scatter(ax: Axes, x: np.ndarray, sample: Sample, finite: np.ndarray) -> None:
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


class Effect(NamedTuple):
    """One bar of a tornado: the figure at the low and at the high end of a value, to first order.

    seen: the median figure of the plants in the lowest and in the highest tenth, or None.
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
    drawn = sheet_figure(title, text, sheet.footer, 12, 3.2 + 0.42 * len(effects))
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
        "Share of the variance of the figure that a value explains alone (S1) and with all its "
        "interactions (ST), with 95 % intervals."
    )
    order = sorted(values, key=lambda index: -index.total)
    title = f"{name}: Sobol indices of {sheet.label}"
    drawn = sheet_figure(title, text, sheet.footer, 12, 2.0 + 0.5 * len(order))
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


def versus(a: Sample, b: Sample, text: str, sheet: Sheet) -> Figure:
    """One controller against another on the same plants. text: the comparison in words."""
    drawn = sheet_figure(f"{a.name} against {b.name}", text, sheet.footer, 9.5, 9.5)
    ax = drawn.subplots()
    both = np.isfinite(a.values) & np.isfinite(b.values)
    scale((ax.set_xscale, ax.set_yscale), np.concatenate([a.values, b.values]))
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
        ends = [min(x.min(), y.min()), max(x.max(), y.max())]
        ax.plot(ends, ends, color=REFERENCE, linewidth=1.2, label="equal")
        ax.set_aspect("equal", adjustable="datalim")
    gone = int((~both).sum())
    if gone:
        ax.plot([], [], linestyle="", label=f"lost under one or both: {gone} plants")
    if sheet.limit is not None:
        ax.axvline(sheet.limit, color=LOST, linestyle="--", linewidth=1.2)
        ax.axhline(sheet.limit, color=LOST, linestyle="--", linewidth=1.2, label="limit")
    dress(ax, f"{a.name}: {sheet.label}", f"{b.name}: {sheet.label}")
    ax.legend(loc="best", fontsize=SMALL, frameon=True, framealpha=0.9)
    return drawn
