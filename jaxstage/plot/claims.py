"""All claims of a study at one glance: what is printed, what this simulation gives, the verdict."""

import textwrap

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstage import __version__
from jaxstage.plot.numbers import plain
from jaxstage.plot.style import LARGE, LOST, NORMAL, SMALL, dress
from jaxstage.studies.claim import FAILS, HOLDS, UNCHECKED, Judgement, count

COLOURS = {HOLDS: "#009E73", FAILS: LOST, UNCHECKED: "#8A8A8A"}
MARKS = {HOLDS: "o", FAILS: "X", UNCHECKED: "s"}
#: ratios beyond these are drawn at the border, with the number
LEAST, MOST = 0.2, 5.0


def claims(title: str, judged: tuple[Judgement, ...]) -> Figure:
    """One row a claim: its words, its verdict, both numbers, and ours over published.

    Claims that no simulation can decide are only counted, in the title line.
    """
    shown = [j for j in judged if j.verdict != UNCHECKED]
    height = 2.0 + 0.36 * len(shown)
    drawn = Figure(figsize=(19, height), dpi=100, facecolor="white")
    ax = drawn.add_axes((0.74, 0.75 / height, 0.24, (height - 2.0) / height))
    _ratios(ax, shown)
    for row, judgement in enumerate(shown):
        _row(ax, row, judgement)
    numbers = count(judged)
    drawn.text(
        0.012,
        1 - 0.15 / height,
        f"{title}: published against this simulation",
        va="top",
        fontsize=LARGE,
        weight="bold",
    )
    drawn.text(
        0.012,
        1 - 0.55 / height,
        f"{numbers[HOLDS]} claims hold, {numbers[FAILS]} fail, {numbers[UNCHECKED]} cannot be "
        "checked by simulation (not drawn). Dots: our number over the published one, 1 is equal; "
        "no dot where only words are printed.",
        va="top",
        fontsize=NORMAL,
    )
    drawn.text(0.012, 0.12 / height, f"jaxstage {__version__}", fontsize=SMALL, color="#555555")
    return drawn


def _ratios(ax: Axes, shown: list[Judgement]) -> None:
    ax.set_ylim(len(shown) - 0.5, -0.5)
    ax.set_xscale("log")
    ax.set_xlim(LEAST, MOST)
    dress(ax, "ours / published", "")
    ax.set_yticks([])
    ticks = (0.2, 0.5, 0.8, 1.0, 1.25, 2.0, 5.0)
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.set_xticks([], minor=True)
    ax.axvline(1.0, color="#222222", linewidth=1.2)
    for row in range(0, len(shown), 2):
        ax.axhspan(row - 0.5, row + 0.5, color="#F3F5F8", zorder=0)


def _row(ax: Axes, row: int, judgement: Judgement) -> None:
    colour = COLOURS[judgement.verdict]
    place = {"transform": ax.get_yaxis_transform(), "va": "center", "clip_on": False}
    text = textwrap.shorten(judgement.text, 100, placeholder=" …")
    ax.text(-3.03, row, judgement.where[:34], fontsize=SMALL, color="#555555", **place)
    ax.text(-2.42, row, text, fontsize=SMALL, **place)
    ax.text(-0.53, row, number(judgement.published), fontsize=SMALL, ha="right", **place)
    ax.text(-0.30, row, number(judgement.ours), fontsize=SMALL, ha="right", **place)
    ax.text(-0.28, row, judgement.unit, fontsize=SMALL, color="#555555", **place)
    ax.text(-0.15, row, judgement.verdict, fontsize=SMALL, color=colour, weight="bold", **place)
    if row == 0:
        for x, name in ((-0.53, "published"), (-0.30, "ours")):
            ax.text(x, -0.9, name, fontsize=SMALL, ha="right", color="#555555", **place)
    if judgement.ours is None or not judgement.published:
        return
    ratio = judgement.ours / judgement.published
    inside = min(max(ratio, LEAST * 1.06), MOST / 1.06) if ratio > 0 else LEAST * 1.06
    ax.plot(inside, row, MARKS[judgement.verdict], color=colour, markersize=8)
    if inside != ratio:
        side = "left" if ratio < 1 else "right"
        ax.annotate(
            f"{ratio:.3g} ×",
            (inside, row),
            (10 if side == "left" else -10, 0),
            textcoords="offset points",
            ha=side,
            va="center",
            fontsize=SMALL,
            color=colour,
        )


def number(value: float | None) -> str:
    """A number with four digits, a dash for none."""
    return "–" if value is None else plain(value)
