"""A tuning in the terminal: the bar while it runs, the answers after."""

import math
from collections.abc import Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as RichProgress

from tuning.app.reports.tuning import (
    baselines,
    diagnostics,
    gains,
    metrics,
    scored,
    trade_offs,
    verdict,
)
from tuning.app.result_table import Row, number, plain_console, say
from tuning.app.result_table import show as show_table
from tuning.tuner.report import ACCEPTED, REFUSED
from tuning.tuner.session import Observer, TrainingProgress

#: parameters that are printed; tune.json has all
MOST = 24


@contextmanager
def bar(budget: float) -> Iterator[Observer]:
    """A bar on standard error: simulations spent, best objective, the same on other plants, norm of
    the gradient, time left."""
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(24),
        TextColumn("{task.fields[told]}", markup=False),
        TimeElapsedColumn(),
    )
    with RichProgress(*columns, console=plain_console(stderr=True)) as progress:
        task = progress.add_task("", total=budget, told="")
        spent = {"before": 0.0, "round": 0.0, "last": 0.0}

        def step(now: TrainingProgress) -> None:
            if now.round != spent["round"]:
                spent.update(before=spent["before"] + spent["last"], round=now.round)
            spent["last"] = now.progress.simulations
            simulations = spent["before"] + now.progress.simulations
            progress.update(task, completed=simulations, told=step_text(now, simulations, budget))

        def stage(text: str) -> None:
            progress.update(task, description=text)

        yield Observer(step, stage)


def step_text(now: TrainingProgress, simulations: float, budget: float) -> str:
    """One line on a step."""
    one = now.progress
    told = [f"{simulations:.0f}/{budget:.0f} simulations", f"best {one.best:.4g}"]
    if now.fresh is not None:
        told.append(f"other plants {now.fresh:.4g}")
    if math.isfinite(one.gradient_norm):
        told.append(f"gradient {one.gradient_norm:.2g}")
    if one.violation > 0:
        told.append(f"goals missed by {one.violation:.1%}" if one.violation < 1e3 else "runs lost")
    told.append(f"{one.left_s:.0f} s left")
    return ", ".join(told)


def show(answer: Row) -> None:
    """Print what a ``tune.json`` says: verdict, metrics before and after, gains, diagnostics."""
    say(
        f"{answer['loop']}  {answer['method']}, {answer['n']} parameters, "
        f"{answer['units']:.0f} simulations in {answer['seconds']:.0f} s ({answer['ended']})"
    )
    for line in verdict(answer):
        say(line, "green" if answer["accepted"] else "red")
    say(f"scored: {scored(answer)}")
    before, after = (number(answer[when]["objective"]) for when in ("before", "after"))
    without = number(answer["after"]["objective_without_pull"])
    say(
        f"objective {answer['objective']}: {before} before, {after} after, {without} without the "
        "pull towards the gains before"
    )
    show_table(metrics(answer, ("contour ", "ate", "energy")))
    table = gains(answer)
    show_table(table._replace(rows=table.rows[:MOST]))
    if len(table.rows) > MOST:
        say(f"  and {len(table.rows) - MOST} more")
    for table in (diagnostics(answer), *baselines(answer), *trade_offs(answer)):
        show_table(table)
    if answer["pareto"]:
        note = answer["pareto"]["note"]
        say(
            f"share of the box beaten: {number(answer['pareto']['hypervolume'])}"
            + (f"; {note}" if note else "")
        )
    for note in answer["diagnostics"]["notes"]:
        say(note)


def files_text(answer: Row, names: list[str]) -> str:
    """The files that a tuning has written."""
    gains_file = ACCEPTED if answer["accepted"] else REFUSED
    return ", ".join((gains_file, "tune.json", "history.csv", *names))
