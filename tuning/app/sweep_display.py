"""A sweep in the terminal: the bar while it runs, the answers after."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress
from rich.table import Table

from jaxstage.metrics.table import split_key
from tuning.sweeps.analysis import Analysis, LoopResult, choose_metric
from tuning.sweeps.sweep import SweepProgress
from tuning.uncertainty.statistics import Interval

#: parameters that are named as the most important ones
MOST = 4


@contextmanager
def bar(
    metric: str, total: int, kept: pa.Table | None = None
) -> Iterator[Callable[[SweepProgress], None]]:
    """A bar on standard error: runs per second, time left, lost runs, worst figure so far.

    kept: rows that were there before, of an earlier sweep into the folder.
    """
    name, unit = split_key(metric)
    columns = (
        BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(), TextColumn("{task.fields[state]}"),
    )  # fmt: skip
    lost, worst = (0, -np.inf) if kept is None else _lost_and_worst(kept, metric)
    # a chunk may take minutes: the rate is that of all chunks so far
    with RichProgress(
        *columns, console=Console(stderr=True), speed_estimate_period=np.inf
    ) as progress:
        task = progress.add_task("", total=total, rate="", state="")

        def watch(now: SweepProgress) -> None:
            nonlocal lost, worst
            more, largest = _lost_and_worst(now.written, metric)
            lost, worst = lost + more, max(worst, largest)
            shown = f"{lost} lost" + (f", worst {name} {worst:.4g} {unit}" if worst > 0 else "")
            speed = progress.tasks[task].speed
            rate = f"{speed:.3g} runs/s" if speed else ""
            progress.update(task, completed=now.done, rate=rate, state=shown)

        yield watch


def _lost_and_worst(rows: pa.Table, metric: str) -> tuple[int, float]:
    """Runs that were lost, and the largest figure of the others."""
    finite, values = (rows[c].to_numpy() for c in ("finite", metric))
    largest = np.max(values, initial=-np.inf, where=np.isfinite(values))
    return int((~finite).sum()), float(largest)


def show(found: Analysis, answer: dict[str, Any]) -> None:
    """Print yield and statistics of every loop, comparisons, the worst runs and the notes."""
    console = Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else 120)
    table, (name, unit) = found.plan.table, split_key(found.metric)
    console.print(
        f"{table['runs']} plants, design {table['design']}, seed {table['seed']}, "
        f"{table['precision']} precision; {answer['simulated']} runs simulated in "
        f"{answer['seconds']:.1f} s"
    )
    if found.spec:
        console.print(f"specification: {found.spec.text}")
    console.print(_table(found, f"{name} {unit}"))
    for loop in found.loops:
        _influences(console, loop)
    for c in found.comparisons:
        both = "" if c.survived == c.plants else f" of the {c.survived} that neither lost"
        console.print(
            f"{c.first} - {c.second} on the same {c.plants} plants: mean{both} "
            f"{_interval(c.difference)} {unit}; {c.first} smaller on {c.better.text()}"
        )
    rows = ", ".join(f"{w['loop']} run {w['run']}: {_worst(w, unit)}" for w in answer["worst"][:3])
    again = f"jaxstage replay {answer['sweep']} --worst K"
    asked = "" if found.metric == choose_metric(found.plan, None, None) else found.metric
    console.print(f"worst: {rows}  ({again}{asked and ' --metric '}{asked})")
    for note in found.notes:
        console.print(f"[dim]{note}[/dim]")


def _table(found: Analysis, figure: str) -> Table:
    rows = Table(box=None, padding=(0, 2), header_style="bold")
    for head, side in (("loop", "left"), ("", "left"), ("value", "right"), ("95 %", "left")):
        rows.add_column(head, justify=side, no_wrap=True)  # type: ignore[arg-type]
    for loop in found.loops:
        title = loop.name
        for name, value, interval in _lines(loop, figure):
            rows.add_row(title, name, value, interval)
            title = ""
    return rows


def _lines(loop: LoopResult, figure: str) -> Iterator[tuple[str, str, str]]:
    """Name, value and interval (or why there is none) of all that is said of a loop."""
    yield "lost", str(loop.lost), ""
    if loop.passed is not None and loop.met is None:
        yield "meet the specification", str(int(loop.passed.sum())), ""
    if loop.met:
        yield "yield", f"{loop.met.value:.2%}", f"{loop.met.low:.2%}..{loop.met.high:.2%}"
    if loop.claim:
        yield f"yield >= {loop.claim.target:.4g}", "", loop.claim.text()
    if loop.statistics:
        mean = "mean (not lost)" if loop.lost else "mean"
        for name, key in ((mean, "mean"), ("P50", "p50"), ("P95", "p95"), ("CVaR 95", "cvar95")):
            stated: Interval | None = getattr(loop.statistics, key)
            if stated:
                yield f"{figure} {name}", f"{stated.value:.4g}", _ends(stated)
            else:
                yield f"{figure} {name}", "-", loop.statistics.reasons[key]


def _influences(console: Console, loop: LoopResult) -> None:
    ranked = sorted(loop.correlations.items(), key=lambda item: -abs(item[1] or 0))[:MOST]
    told = ", ".join(f"{name} {rho:+.2f}" for name, rho in ranked if rho is not None)
    if told:
        console.print(f"{loop.name}: rank correlation {told}")
    if loop.indices:
        order = np.argsort(-loop.indices.total)[:MOST]
        told = ", ".join(
            f"{loop.indices.names[i]} {loop.indices.total[i]:.2f} +- "
            f"{loop.indices.total_error[i]:.2f}"
            for i in order
        )
        console.print(f"{loop.name}: total Sobol index {told}")


def _interval(found: Interval | None) -> str:
    return f"{found.value:.4g} ({_ends(found)})" if found else "-"


def _ends(found: Interval) -> str:
    return f"{found.low:.4g}..{found.high:.4g}"


def _worst(row: dict[str, Any], unit: str) -> str:
    if row["value"] is None:
        return f"lost at {row['lost_at_s']:.4g} s" if row["lost_at_s"] is not None else "no figure"
    return f"{row['value']:.4g} {unit}".rstrip()


def show_replayed(rows: list[dict[str, Any]], out: Path | None) -> None:
    """Print what became of replayed runs and whether their numbers are those of the sweep."""
    console = Console(highlight=False, soft_wrap=True)
    for row in rows:
        console.print(f"[bold]{row['loop']} run {row['run']}[/bold]: {_verdict(row)}")
        drawn = ", ".join(f"{name} {value:.5g}" for name, value in row["parameters"].items())
        console.print(f"  {drawn}")
        figures = {k: v for k, v in row["figures"].items() if v is not None}
        console.print("  " + ", ".join(f"{name} {value:.5g}" for name, value in figures.items()))
    if out is not None:
        console.print(f"pictures, run.json, gains.toml, scenario.toml of each run: {out}/")


def _verdict(row: dict[str, Any]) -> str:
    state = "complete" if row["finite"] else f"lost at {row['lost_at_s']:.4g} s"
    if row["identical"] is None:
        return f"{state}; the sweep has not come to it yet"
    if row["identical"]:
        return f"{state}; identical to its row"
    gap = row["largest_difference"]
    told = "it was lost in one of the two" if gap is None else f"largest difference {gap:.1e}"
    return f"{state}; NOT identical to its row ({told}): other versions, devices or processor?"
