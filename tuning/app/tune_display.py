"""A tuning in the terminal: the bar while it runs, the answers after."""

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as RichProgress
from rich.table import Table

from jaxstage.metrics.table import split_key
from tuning.tuner.baselines import ConvergenceCurve, convergence_curve
from tuning.tuner.problem.search_space import Parameter, parameters
from tuning.tuner.report import ACCEPTED, REFUSED, Extras, verdict_text
from tuning.tuner.session import Observer, TrainingProgress, TuningResult

#: parameters that are printed; tune.json has all
MOST = 24


@contextmanager
def bar(budget: float) -> Iterator[Observer]:
    """A bar on standard error: simulations spent, best objective, the same on other plants, norm of
    the gradient, time left."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(24),
        TextColumn("{task.fields[told]}"),
        TimeElapsedColumn(),
    )
    with RichProgress(*columns, console=Console(stderr=True)) as progress:
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


def show(outcome: TuningResult, extras: Extras) -> None:
    """Print the verdict, the metrics before and after, gains, and diagnostics."""
    console = Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else 120)
    table, tuned = outcome.plan.table, outcome.tuned
    console.print(
        f"[bold]{table['loop']}[/bold]  {tuned.method}, {tuned.n} parameters, "
        f"{outcome.simulations:.0f} simulations in {outcome.seconds:.0f} s ({tuned.ended})"
    )
    verdict = "[green]accepted[/green]" if not outcome.refused else "[red]not accepted[/red]"
    console.print(f"{verdict}; held out: {verdict_text(outcome.held_out)}")
    for one in outcome.refused:
        console.print(f"  {one.reason}; try {one.advice}", markup=False)
    before, after = outcome.chosen.validation.exact.objective
    console.print(f"objective {table['objective']}: {before:.4g} before, {after:.4g} after")
    console.print(_metrics(outcome, extras))
    console.print(_gains(parameters(outcome.problem.space, outcome.chosen.z)))
    for text in _diagnostics(outcome):
        console.print(text)
    if extras.baselines:
        console.print(_baselines(outcome, extras.baselines))
    if extras.front is not None:
        console.print(_front(extras))


def _metrics(outcome: TuningResult, extras: Extras) -> Table:
    rows = Table(box=None, padding=(0, 2), header_style="bold")
    for head, side in (("metric", "left"), ("before", "right"), ("after", "right"), ("", "left")):
        rows.add_column(head, justify=side, no_wrap=True)  # type: ignore[arg-type]
    for name, value in extras.before.items():
        shown, unit = split_key(name)
        if not isinstance(value, dict) and name.startswith(("contour_", "ate", "energy_J")):
            rows.add_row(f"loop {shown}", _number(value), _number(extras.after[name]), unit)
    for name, (first, second) in outcome.held_out.others.items():
        if name in (outcome.held_out.metric, "contour_max_um", "energy_J"):
            shown, unit = split_key(name)
            rows.add_row(f"held out {shown}", _number(first), _number(second), unit)
    return rows


def _gains(every: tuple[Parameter, ...]) -> Table:
    rows = Table(box=None, padding=(0, 2), header_style="bold")
    for head, side in (
        ("gain", "left"),
        ("before", "right"),
        ("after", "right"),
        ("range", "left"),
        ("", "left"),
    ):
        rows.add_column(head, justify=side, no_wrap=True)  # type: ignore[arg-type]
    for p in every[:MOST]:
        bound = "on its bound" if p.at_bound else ""
        name = p.label.removeprefix("gains.")
        shown = f"{p.low:.4g}..{p.high:.4g} {p.unit if p.unit != '1' else ''}"
        rows.add_row(name, _number(p.before), _number(p.value), shown, bound)
    if len(every) > MOST:
        rows.add_row(f"and {len(every) - MOST} more", "", "", "", "")
    return rows


def _diagnostics(outcome: TuningResult) -> Iterator[str]:
    known = outcome.diagnostics
    if known.gradient_ok is not None:
        worst = max((known.gradient_error or {"": math.nan}).values())
        state = "agree" if known.gradient_ok else "do NOT agree"
        yield f"gradients and differences {state}, largest error {worst:.2g}"
    if known.at_bounds:
        yield f"on their bounds: {_named(known.at_bounds)}"
    if known.effects and known.effects.insensitive:
        yield f"without effect: {_named(known.effects.insensitive)}"
    for group in known.effects.redundant if known.effects else ():
        yield f"do the same: {_named(group)}"
    if known.starts_agree is not None:
        told = ", ".join(f"{value:.4g}" for value in known.starts)
        yield f"starts {'agree' if known.starts_agree else 'do NOT agree'}: {told}"
    validation = outcome.chosen.validation
    for name, one in (
        ("training runs, half the step", validation.half_step),
        ("other plants, longer", validation.longer),
    ):
        first, second = one.metric
        yield f"{name}: {outcome.plan.metric} {first:.4g} -> {second:.4g}"
    if outcome.surrogate:
        first, second = outcome.surrogate
        exact = validation.exact.objective
        yield (
            f"objective on the surrogate {first:.4g} -> {second:.4g}, on the exact model "
            f"{exact[0]:.4g} -> {exact[1]:.4g}"
        )
    if outcome.chosen.share < 1:
        yield (
            f"taken back to {outcome.chosen.share:.0%} of the way from the gains before: what was "
            "found did not pass these tests"
        )
    if known.radius:
        yield f"spectral radius of a period: {known.radius[0]:.6g} -> {known.radius[1]:.6g}"
    yield from known.notes


def _named(labels: tuple[str, ...]) -> str:
    shown = [label.removeprefix("gains.") for label in labels[:6]]
    more = f" and {len(labels) - 6} more" if len(labels) > 6 else ""
    return ", ".join(shown) + more


def _baselines(outcome: TuningResult, others: tuple[ConvergenceCurve, ...]) -> Table:
    own = convergence_curve(outcome.rounds[0].tuned)
    every = (own, *others)
    marks = [own.simulations[-1] * share for share in (0.1, 0.25, 0.5, 1.0)]
    rows = Table(box=None, padding=(0, 2), header_style="bold")
    rows.add_column("best objective after")
    for simulations in marks:
        rows.add_column(f"{simulations:.0f} simulations", justify="right", no_wrap=True)
    for one in every:
        rows.add_row(one.method, *(_number(one.at(simulations)) for simulations in marks))
    return rows


def _front(extras: Extras) -> Table:
    front = extras.front
    assert front is not None
    rows = Table(box=None, padding=(0, 2), header_style="bold")
    rows.add_column("trade-off")
    for name in front.columns:
        rows.add_column(" ".join(split_key(name)), justify="right", no_wrap=True)
    rows.add_column("")
    rows.add_row("before", *map(_number, front.before), "")
    for i, (point, kept) in enumerate(zip(front.points, front.kept, strict=True)):
        told = "suggested" if i == front.suggested else "" if kept else "beaten"
        rows.add_row(str(i), *map(_number, point), told)
    rows.caption = f"share of the box beaten: {front.volume:.3f}"
    rows.caption += f"; {front.note}" if front.note else ""
    return rows


def _number(value: Any) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.4g}"


def files_text(outcome: TuningResult, names: list[str]) -> str:
    """What was written."""
    gains = REFUSED if outcome.refused else ACCEPTED
    return ", ".join((gains, "tune.json", "history.csv", *names))
