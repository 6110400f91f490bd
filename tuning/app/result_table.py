"""Result tables: one model of columns and rows, shown in the terminal, as JSON and as HTML.

A row is the object that ``--json`` prints of it; a column says under which key its values stand
and how they read. `report.html` renders `ResultTable.heads` and `ResultTable.cells`.
"""

import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table as TerminalTable
from rich.text import Text

from jaxstage.metrics.table import split_key

Row = Mapping[str, Any]

#: stands where there is no value
DASH = "-"


def number(value: float | None) -> str:
    """Four significant digits."""
    return DASH if value is None or not math.isfinite(value) else f"{value:.4g}"


def decimal(value: float | None) -> str:
    """Four digits behind the point where that is readable, else four significant ones."""
    readable = value is not None and (1e-2 <= abs(value) < 1e6 or value == 0)
    return f"{value:.4f}" if readable else number(value)


def interval(estimate: Row | None) -> str:
    """An estimate with its confidence interval, from ``value``, ``low`` and ``high``."""
    return f"{number(estimate['value'])} ({ends(estimate)})" if estimate else DASH


def ends(estimate: Row) -> str:
    """The confidence interval of an estimate."""
    return f"{number(estimate['low'])} to {number(estimate['high'])}"


def share(estimate: Row | None) -> str:
    """A share with its confidence interval, in per cent."""
    if not estimate:
        return DASH
    return f"{estimate['value']:.2%} ({estimate['low']:.2%} to {estimate['high']:.2%})"


def words(value: object) -> str:
    """The text of a value, nothing for None."""
    return "" if value is None else str(value)


class Column(NamedTuple):
    """A column of a result table.

    Args:
        key: where its values stand in a row.
        label: its head.
        text: a value as people read it.
        numeric: aligned right and never wrapped.
        wrap: share of the terminal's width that wrapped text takes, 0 for a line that is not.
        styles: terminal style of some texts.
    """

    key: str
    label: str = ""
    text: Callable[[Any], str] = words
    numeric: bool = False
    wrap: int = 0
    styles: Mapping[str, str] = {}


def numeric(key: str, label: str, text: Callable[[Any], str] = number) -> Column:
    """A column of numbers."""
    return Column(key, label, text, numeric=True)


class ResultTable(NamedTuple):
    """Columns and rows. title: its heading in a report; note: one sentence on how to read it."""

    columns: tuple[Column, ...]
    rows: Sequence[Row]
    title: str = ""
    note: str = ""

    @property
    def cells(self) -> list[tuple[str, ...]]:
        """The text of every cell, row by row."""
        return [tuple(c.text(row.get(c.key)) for c in self.columns) for row in self.rows]


def plain_console(**options: Any) -> Console:
    """A console without markup: text of a user in brackets stays what it is."""
    return Console(markup=False, emoji=False, highlight=False, **options)


def say(text: str, style: str = "") -> None:
    """Print a line on standard output, never broken by the terminal's width."""
    _print(plain_console(), Text(text, style), wrap=False)


def show(table: ResultTable) -> None:
    """Print a table on standard output; 200 columns wide where that is no terminal."""
    console = plain_console(width=None if sys.stdout.isatty() else 200)
    _print(console, terminal_table(table), wrap=any(column.wrap for column in table.columns))


def _print(console: Console, shown: Text | TerminalTable, wrap: bool) -> None:
    """Print as Python does: a console of its own would end the process where a pipe is closed."""
    with console.capture() as captured:
        console.print(shown, soft_wrap=not wrap)
    print(captured.get(), end="")


def terminal_table(table: ResultTable) -> TerminalTable:
    """A table for a terminal."""
    labelled = any(column.label for column in table.columns)
    shown = TerminalTable(box=None, padding=(0, 2), header_style="bold", show_header=labelled)
    for column in table.columns:
        shown.add_column(
            Text(column.label),
            justify="right" if column.numeric else "left",
            no_wrap=not column.wrap,
            ratio=column.wrap or None,
            overflow="fold",
        )
    for row in table.cells:
        texts = zip(row, table.columns, strict=True)
        shown.add_row(*(Text(text, column.styles.get(text, "")) for text, column in texts))
    return shown


def objects(table: ResultTable) -> list[dict[str, Any]]:
    """The rows as JSON objects: what is not finite is None."""
    return [{key: _plain(value) for key, value in row.items()} for row in table.rows]


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def metric_rows(reports: Mapping[str, Row]) -> Iterator[dict[str, Any]]:
    """Reports of equal keys side by side: a row a metric and axis.

    Args:
        reports: heading -> metrics, each a number or one number per axis.

    Yields:
        ``metric``, ``unit`` and one value under each heading.
    """
    first = next(iter(reports.values()))
    for key, value in first.items():
        name, unit = split_key(key)
        for axis in value if isinstance(value, Mapping) else ("",):
            values = {head: _of_axis(report.get(key), axis) for head, report in reports.items()}
            yield {"metric": f"{name} {axis}".strip(), **values, "unit": unit}


def _of_axis(value: Any, axis: str) -> Any:
    return value.get(axis) if isinstance(value, Mapping) else value


def metric_table(
    reports: Mapping[str, Row], text: Callable[[Any], str] = number, title: str = "", note: str = ""
) -> ResultTable:
    """A table of `metric_rows`."""
    columns = (
        Column("metric", "metric"),
        *(numeric(head, head, text) for head in reports),
        Column("unit", "unit"),
    )
    return ResultTable(columns, list(metric_rows(reports)), title, note)


def heading(key: str) -> str:
    """A metric's key as the head of a column: name and unit."""
    return " ".join(split_key(key)).strip()
