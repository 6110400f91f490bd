"""A sweep in the terminal: the bar while it runs, the answers after."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

from jaxstage.metrics.table import split_key
from tuning.app.reports.sweep import answers, scored
from tuning.app.result_table import Row, interval, number, plain_console, say, share
from tuning.app.result_table import show as show_table
from tuning.sweeps.sweep import SweepProgress

#: parameters that are named as the most important ones
MOST = 4


@contextmanager
def bar(
    metric: str, total: int, kept: pa.Table | None = None
) -> Iterator[Callable[[SweepProgress], None]]:
    """A bar on standard error: runs per second, time left, lost runs, worst metric so far.

    kept: rows that were there before, of an earlier sweep into the folder.
    """
    name, unit = split_key(metric)
    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}", markup=False),
        TimeRemainingColumn(),
        TextColumn("{task.fields[state]}", markup=False),
    )
    lost, worst = (0, -np.inf) if kept is None else _lost_and_worst(kept, metric)
    # a chunk may take minutes: the rate is that of all chunks so far
    with RichProgress(
        *columns, console=plain_console(stderr=True), speed_estimate_period=np.inf
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
    """Runs that were lost, and the largest metric of the others."""
    finite, values = (rows[c].to_numpy() for c in ("finite", metric))
    largest = np.max(values, initial=-np.inf, where=np.isfinite(values))
    return int((~finite).sum()), float(largest)


def show(summary: Row) -> None:
    """Print what a ``summary.json`` says: answers of every loop, comparisons, worst runs, notes."""
    unit = split_key(summary["metric"])[1]
    say(
        f"{summary['runs']} plants, design {summary['design']}, seed {summary['seed']}, "
        f"{summary['precision']} precision; {summary['simulated']} runs simulated in "
        f"{summary['seconds']:.1f} s"
    )
    say(f"scored: {scored(summary)}")
    if summary["specification"]:
        say(f"specification: {summary['specification']}")
    show_table(answers(summary))
    for loop in summary["loops"]:
        for told in _influences(loop):
            say(f"{loop['loop']}: {told}")
    for pair in summary["comparisons"]:
        say(_comparison(pair, unit))
    runs = ", ".join(f"{w['loop']} run {w['run']}: {_worst(w, unit)}" for w in summary["worst"][:3])
    again = f"jaxstage replay {summary['sweep']} --worst K --metric {summary['metric']}"
    say(f"worst: {runs}  ({again})")
    for note in summary["notes"]:
        say(note, "dim")


def _influences(loop: Row) -> Iterator[str]:
    """The most important uncertain values, by rank correlation and by Sobol index."""
    rhos = [(name, rho) for name, rho in loop["rank_correlation"].items() if rho is not None]
    if rhos:
        ranked = sorted(rhos, key=lambda one: -abs(one[1]))[:MOST]
        yield f"rank correlation {', '.join(f'{name} {rho:+.2f}' for name, rho in ranked)}"
    indices = loop["sobol_indices"]
    if indices:
        ranked = sorted(indices.items(), key=lambda one: -(one[1]["st"] or 0))[:MOST]
        told = (f"{n} {number(one['st'])} +- {number(one['st_error'])}" for n, one in ranked)
        yield f"total Sobol index {', '.join(told)}"


def _comparison(pair: Row, unit: str) -> str:
    same = pair["survived"] == pair["plants"]
    both = "" if same else f" of the {pair['survived']} that neither lost"
    return (
        f"{pair['first']} - {pair['second']} on the same {pair['plants']} plants: mean{both} "
        f"{interval(pair['difference'])} {unit}; {pair['first']} smaller on {share(pair['better'])}"
    )


def _worst(run: Row, unit: str) -> str:
    if run["value"] is None:
        return f"lost at {run['lost_at_s']:.4g} s" if run["lost_at_s"] is not None else "no value"
    return f"{run['value']:.4g} {unit}".rstrip()


def show_replayed(rows: list[dict[str, Any]], out: Path | None) -> None:
    """Print what became of replayed runs and whether their numbers are those of the sweep."""
    for row in rows:
        say(f"{row['loop']} run {row['run']}: {_verdict(row)}")
        for name in ("parameters", "figures"):
            values = {k: v for k, v in row[name].items() if v is not None}
            say("  " + ", ".join(f"{name} {value:.5g}" for name, value in values.items()))
    if out is not None:
        say(f"pictures, run.json, gains.toml, scenario.toml of each run: {out}/")


def _verdict(row: dict[str, Any]) -> str:
    state = "complete" if row["finite"] else f"lost at {row['lost_at_s']:.4g} s"
    if row["identical"] is None:
        return f"{state}; the sweep has not come to it yet"
    if row["identical"]:
        return f"{state}; identical to its row"
    gap = row["largest_difference"]
    told = "it was lost in one of the two" if gap is None else f"largest difference {gap:.1e}"
    return f"{state}; NOT identical to its row ({told}): other versions, devices or processor?"
