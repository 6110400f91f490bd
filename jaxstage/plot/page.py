"""The frame of a figure: title, explanation and footer, with the panels between them."""

import textwrap

from matplotlib.figure import Figure

REFERENCE = "#222222"
QUIET = "#555555"
SMALL, NORMAL, LARGE = 11, 13, 18
#: characters in an inch of a title, of a text and of a footer, at most
TITLE, TEXT, FOOTER = 6.2, 10.0, 11.5
#: inches that a line of each takes
TITLE_LINE, TEXT_LINE, FOOTER_LINE = 0.32, 0.24, 0.18


def page(
    title: str,
    text: str,
    footer: str,
    size: tuple[float, float],
    colour: str = REFERENCE,
    above: float = 0.0,
) -> Figure:
    """An empty figure at 100 dpi.

    Args:
        title: What is shown; wrapped where it does not fit.
        text: How to read it, or the verdict; wrapped.
        footer: Settings, parted by ``   |   ``; wrapped between them.
        size: Width and height in inches; lines beyond the first of each part come on top.
        colour: Of the text.
        above: Inches that stay free above the panels, for a legend.
    """
    width, height = size
    titles = textwrap.wrap(title, int(TITLE * (width - 0.4))) or [""]
    lines = textwrap.wrap(text, int(TEXT * (width - 0.4)))
    settings = _footer(footer, int(FOOTER * (width - 0.4)))
    height += TITLE_LINE * (len(titles) - 1) + TEXT_LINE * max(len(lines) - 1, 0)
    height += FOOTER_LINE * (len(settings) - 1)
    drawn = Figure(figsize=(width, height), dpi=100, layout="constrained", facecolor="white")
    # inches from the borders, so that they do not depend on the height
    below_title = 0.2 + TITLE_LINE * len(titles)
    top = below_title + TEXT_LINE * len(lines) + 0.12 + above
    low = 0.22 + FOOTER_LINE * len(settings)
    engine = drawn.get_layout_engine()
    assert engine is not None
    rect = (0.005, low / height, 0.99, 1 - (top + low) / height)
    engine.set(rect=rect, h_pad=0.07, w_pad=0.09)  # type: ignore[call-arg]
    left = 0.25 / width
    for words, y, va, style in (
        (titles, 1 - 0.14 / height, "top", {"fontsize": LARGE, "weight": "bold"}),
        (lines, 1 - below_title / height, "top", {"fontsize": NORMAL, "color": colour}),
        (settings, 0.12 / height, "bottom", {"fontsize": SMALL, "color": QUIET}),
    ):
        drawn.text(left, y, "\n".join(words), va=va, parse_math=False, **style)
    return drawn


def _footer(text: str, width: int) -> list[str]:
    lines = [""]
    for part in text.split("   |   "):
        longer = f"{lines[-1]}   |   {part}" if lines[-1] else part
        if len(longer) <= width or not lines[-1]:
            lines[-1] = longer
        else:
            lines.append(part)
    return lines
