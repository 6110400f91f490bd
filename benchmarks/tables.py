"""Tables for a terminal."""

from collections.abc import Sequence


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]], note: str = "") -> str:
    """A title, a head, rows under it, the first column left and the others right, and a note."""
    widths = [max(len(r[i]) for r in (head, *rows)) for i in range(len(head))]

    def line(cells: Sequence[str]) -> str:
        first = cells[0].ljust(widths[0])
        return "  ".join([first, *(c.rjust(w) for c, w in zip(cells[1:], widths[1:], strict=True))])

    rule = "-" * len(line(head))
    body = [f"\n{title}", rule, line(head), rule, *(line(r) for r in rows), rule]
    return "\n".join(body + ([note] if note else []))


def rate(value: float) -> str:
    """Lane-steps per second."""
    return f"{value:.2e}".replace("e+0", "e").replace("e+", "e")


def ratio(value: float) -> str:
    """A share in per cent."""
    return f"{100 * value:.1f} %" if value < 0.1 else f"{100 * value:.0f} %"
