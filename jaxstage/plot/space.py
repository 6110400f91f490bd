"""Reference and tool path in space, with the contour error magnified."""

import numpy as np
from matplotlib.figure import Figure

from jaxstage.plot.contour import magnification
from jaxstage.plot.numbers import pixels
from jaxstage.plot.style import LOST, NORMAL, REFERENCE, SCORED, SMALL, figure
from jaxstage.plot.view import View


def space(view: View) -> Figure:
    """The curve in space and beside it the tool, moved off its nearest point by the magnified
    contour error; thin spokes join the two.

    Raises ValueError for a run that does not have three axes.
    """
    if len(view.axes) != 3:
        raise ValueError("a picture in space needs three axes")
    factor = magnification(view)
    times = f"contour error drawn × {factor:,.0f}" if factor > 1 else "contour error true to scale"
    drawn = figure(view, times, (12.0, 10.0))
    ax = drawn.add_subplot(projection="3d")
    part = view.scored_ticks()
    base = view.nearest[part] * 1e3
    tool = base + factor * (view.tool[part] * 1e3 - base)
    kept = pixels(tool)
    ax.plot(*(view.curve * 1e3).T, color=REFERENCE, linewidth=1.3, label="reference")
    name = view.scored_text if view.lost is None else "before it was lost"
    ax.plot(
        *tool[kept].T, color=SCORED, linewidth=1.4, label=f"tool, error × {factor:,.0f} ({name})"
    )
    for k in np.unique(np.linspace(0, len(tool) - 1, 200).astype(int)):
        ax.plot(*np.stack([base[k], tool[k]]).T, color=SCORED, linewidth=0.6, alpha=0.5)
    ax.plot(*(view.curve[:1] * 1e3).T, "o", color=REFERENCE, markersize=9, label="start")
    if view.lost is not None:
        ax.plot(*tool[-1:].T, "X", color=LOST, markersize=14, label="lost here")
    for label, axis in zip(view.axes, (ax.xaxis, ax.yaxis, ax.zaxis), strict=True):  # type: ignore[attr-defined]
        axis.set_label_text(f"{label} in mm", fontsize=NORMAL)
    size = np.maximum(np.ptp(np.concatenate([view.curve * 1e3, tool]), axis=0), 1e-9)
    ax.set_box_aspect(size / size.max())  # type: ignore[arg-type]
    ax.legend(loc="upper right", fontsize=SMALL, frameon=False)
    return drawn
