"""What an adaptive law with a cell memory learned."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstage.plot.numbers import envelope
from jaxstage.plot.style import AXIS_COLOURS, NORMAL, SMALL, dress, figure, note, time_axis
from jaxstage.plot.view import View

#: names in a legend beyond this number would not be read
MOST_NAMED = 20

Cell = tuple[int, ...]


def weights(view: View) -> Figure:
    """Per axis: the weights that ever change, named by cell (layer, block of e, block of e').

    Cells that always agree share a line. Colour tells the layer (of the first); the middle cell
    of a layer is solid, the others are dashed. Raises ValueError for a law without weights.
    """
    if view.weights is None:
        raise ValueError("this law has no weights")
    count = len(view.axes)
    drawn = figure(view, "adapted weights", (15.0, 1.7 + 4.2 * count))
    panels = drawn.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    for axis, panel in enumerate(panels):
        values = view.weights[:, axis]
        groups = equal_cells(values)
        for cells in groups:
            _draw(panel, view.time, values, cells)
        time_axis(panel, view)
        below = "time in s" if axis == count - 1 else ""
        dress(panel, below, f"{view.axes[axis]} weights in {view.command_unit}")
        changing, size = sum(map(len, groups)), values[0].size
        note(panel, f"{view.axes[axis]}: {changing} of {size} weights ever change")
        _legend(panel)
    return drawn


def equal_cells(values: np.ndarray) -> list[list[Cell]]:
    """The cells that ever change, grouped where they agree to 1e-9 of the largest value.

    values: (ticks, layers, blocks, ...).
    """
    tolerance = 1e-9 * float(np.max(np.abs(values)))
    groups: list[list[Cell]] = []
    for index in np.argwhere(np.ptp(values, axis=0) > 0):
        cell = tuple(int(i) for i in index)
        of_cell = values[(slice(None), *cell)]
        alike = (
            group
            for group in groups
            if np.max(np.abs(of_cell - values[(slice(None), *group[0])])) <= tolerance
        )
        group = next(alike, None)
        if group is None:
            groups.append([cell])
        else:
            group.append(cell)
    return groups


def _draw(ax: Axes, time: np.ndarray, values: np.ndarray, cells: list[Cell]) -> None:
    first = cells[0]
    middle = all(2 * i + 1 == size for i, size in zip(first[1:], values.shape[2:], strict=True))
    one = values[(slice(None), *first)]
    kept = envelope(time, one)
    ax.plot(
        time[kept],
        one[kept],
        color=AXIS_COLOURS[first[0] % len(AXIS_COLOURS)],
        linewidth=1.6,
        linestyle="-" if middle else (0, (4 + 2 * first[-1], 2)),
        label="\n= ".join(f"({', '.join(map(str, cell))})" for cell in cells),
    )


def _legend(ax: Axes) -> None:
    handles, names = ax.get_legend_handles_labels()
    if names:
        ax.legend(
            handles[:MOST_NAMED],
            names[:MOST_NAMED],
            loc="center left",
            bbox_to_anchor=(1.005, 0.5),
            fontsize=SMALL,
            title="cell (layer, e, e')",
            title_fontsize=NORMAL - 1,
            frameon=False,
            ncols=1 + (len(names) > 10),
            handlelength=2.6,
        )
