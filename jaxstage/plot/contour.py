"""Reference and tool path in the plane, with the contour error magnified."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstage.metrics.words import length_text
from jaxstage.plot.numbers import pixels, round_down
from jaxstage.plot.style import (
    LOST,
    OTHER,
    REFERENCE,
    SCORED,
    SMALL,
    dress,
    figure,
    other_laps,
)
from jaxstage.plot.view import View

#: the largest error is drawn about this share of the size of the curve
SHARE = 0.12
#: inches above the panels for the legend
LEGEND = 0.3


def magnification(view: View) -> float:
    """Round factor that makes the largest error of the judged part easy to see; 1 at least."""
    part = view.scored_ticks()
    largest = float(np.max(view.distance[part], initial=0.0))
    size = float(np.max(np.ptp(view.curve, axis=0)))
    return max(1.0, round_down(SHARE * size / largest)) if largest > 0 else 1.0


def contour(view: View) -> Figure:
    """The path nearest to the tool plus the magnified error, in one panel per pair of axes.

    Raises ValueError for a run of one axis, which has no contour.
    """
    count = len(view.axes)
    pairs = [(a, b) for a in range(count) for b in range(a + 1, count)]
    if not pairs:
        raise ValueError("a contour needs at least two axes")
    factor = magnification(view)
    times = f"contour error drawn × {factor:,.0f}" if factor > 1 else "contour error true to scale"
    paths = [_magnified(view, view.scored_ticks(), pair, factor) for pair in pairs]
    boxes = [_box(view, pair, path) for pair, (_, path) in zip(pairs, paths, strict=True)]
    tallest = max((high[1] - low[1]) / (high[0] - low[0]) for low, high in boxes)
    wide = 11.0 if len(pairs) == 1 else 5.5
    size = (wide * len(pairs) + 1.0, 2.4 + wide * min(max(tallest, 0.5), 1.1))
    drawn = figure(view, times, size, above=LEGEND)
    for index, pair in enumerate(pairs):
        ax = drawn.add_subplot(1, len(pairs), index + 1)
        ax.set_aspect("equal", adjustable="box")
        ax.set_xlim(boxes[index][0][0], boxes[index][1][0])
        ax.set_ylim(boxes[index][0][1], boxes[index][1][1])
        _panel(ax, view, pair, factor, *paths[index])
    handles, names = drawn.axes[0].get_legend_handles_labels()
    drawn.legend(
        handles,
        names,
        loc="upper right",
        bbox_to_anchor=(1.0, _panels_top(drawn) + LEGEND / drawn.get_figheight()),
        ncols=len(names),
        fontsize=SMALL,
        frameon=False,
    )
    return drawn


def _panels_top(drawn: Figure) -> float:
    """Where the panels end, as a share of the height."""
    engine = drawn.get_layout_engine()
    assert engine is not None
    _, low, _, height = engine.get()["rect"]
    return low + height


def _magnified(
    view: View, ticks: slice, pair: tuple[int, int], factor: float
) -> tuple[np.ndarray, np.ndarray]:
    """Nearest points and magnified tool path in one plane, in mm, thinned to pixels."""
    plane = list(pair)
    base, tool = view.nearest[ticks][:, plane], view.tool[ticks][:, plane]
    path = base + factor * (tool - base)
    kept = pixels(path)
    return base[kept] * 1e3, path[kept] * 1e3


def _box(view: View, pair: tuple[int, int], path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a panel in mm that holds curve and path, with room below for the scale bars."""
    points = np.concatenate([view.curve[:, list(pair)] * 1e3, path])
    low, high = points.min(axis=0), points.max(axis=0)
    pad = 0.05 * np.max(high - low)
    low, high = low - pad * np.array([1.0, 2.8]), high + pad
    # wide enough for the legend
    wider = max(0.95 * (high - low)[1] - (high - low)[0], 0.0) / 2 * np.array([1.0, 0.0])
    return low - wider, high + wider


def _panel(
    ax: Axes,
    view: View,
    pair: tuple[int, int],
    factor: float,
    base: np.ndarray,
    path: np.ndarray,
) -> None:
    plane = list(pair)
    curve = view.curve[:, plane] * 1e3
    others = [lap for lap in view.laps if not view.is_scored(lap) and view.lost is None]
    for index, lap in enumerate(others):
        _, other = _magnified(view, slice(*lap), pair, factor)
        name = None if index else other_laps(view)
        ax.plot(*other.T, color=OTHER, linewidth=1.1, label=name, zorder=2)
    ring = np.concatenate([base, path[::-1]])
    ax.fill(*ring.T, color=SCORED, alpha=0.16, linewidth=0, zorder=1)
    ax.plot(*curve.T, color=REFERENCE, linewidth=1.3, label="reference", zorder=3)
    name = view.scored_text if view.lost is None else "before it was lost"
    ax.plot(
        *path.T,
        color=SCORED,
        linewidth=1.8,
        zorder=4,
        label=f"tool, error × {factor:,.0f} ({name})",
    )
    dress(ax, f"{view.axes[pair[0]]} in mm", f"{view.axes[pair[1]]} in mm")
    _start(ax, view, plane)
    _bars(ax, curve, factor)
    if view.lost is not None:
        ax.plot(*path[-1], "X", color=LOST, markersize=14, label="lost here", zorder=6)


def _start(ax: Axes, view: View, plane: list[int]) -> None:
    """A dot where the path begins, and an arrow the way it goes."""
    begin = view.curve[0, plane] * 1e3
    heading = view.heading[plane]
    tip = begin + heading * 0.13 * np.max(np.ptp(view.curve, axis=0)) * 1e3
    ax.plot(
        *begin,
        marker="o",
        color=REFERENCE,
        markersize=9,
        zorder=5,
        linestyle="none",
        label="start and direction",
    )
    ax.annotate(
        "",
        xy=(tip[0], tip[1]),
        xytext=(begin[0], begin[1]),
        zorder=5,
        arrowprops={"arrowstyle": "-|>", "color": REFERENCE, "lw": 2.2, "mutation_scale": 22},
    )


def _bars(ax: Axes, curve: np.ndarray, factor: float) -> None:
    """One scale bar for the geometry, one for the magnified error."""
    size = float(np.max(np.ptp(curve, axis=0)))
    true = round_down(0.3 * size)
    error = round_down(0.12 * size / factor)
    left, right = curve[:, 0].min(), curve[:, 0].max()
    y = ax.get_ylim()[0] + 0.045 * size
    if factor == 1:
        _bar(ax, (left + right - true) / 2, y, true, f"{true:g} mm (path and error)", REFERENCE)
        return
    _bar(ax, left, y, true, f"path: {true:g} mm", REFERENCE)
    text = f"error: {length_text(error * 1e-3)}"
    _bar(ax, right - error * factor, y, error * factor, text, SCORED)


def _bar(ax: Axes, x: float, y: float, length: float, text: str, colour: str) -> None:
    ax.errorbar(
        x + length / 2, y, xerr=length / 2, color=colour, capsize=7, capthick=2.5, elinewidth=2.5
    )
    ax.annotate(
        text,
        xy=(x + length / 2, y),
        xytext=(0, 8),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=SMALL + 1,
        color=colour,
    )
