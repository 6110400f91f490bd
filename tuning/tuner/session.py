"""A tuning from its configuration to evidence: rounds of training, then the tests of the result.

Training sees only the training runs. What accepts or refuses comes after, on the exact model.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from tuning.tuner.configuration import (
    TuningPlan,
    fresh_runs,
    groups_of,
    pool,
    problem_of,
    runs_of,
    validation_table,
)
from tuning.tuner.evidence.diagnostics import Diagnostics, diagnose
from tuning.tuner.evidence.validation import (
    HeldOut,
    PairedRuns,
    Validation,
    ValidationRuns,
    half_step,
    has_column,
    held_out_verdict,
    prolonged,
    refusals,
    simulate_pairs,
    validation_refusals,
)
from tuning.tuner.evidence.worst_case import worst_plants
from tuning.tuner.problem.problem import Evaluation, Problem, RunGroup, evaluate
from tuning.tuner.problem.scenario_set import RunSet, run_sets
from tuning.tuner.problem.surrogate import NONE
from tuning.tuner.search.optimise import METHODS, SearchProgress, SearchResult, tune
from tuning.uncertainty.metric_table import metric_names

#: how far gains may go from those before to those found; nearer ones where tests refuse the end
SHARES = (1.0, 0.9, 0.8, 0.65, 0.5, 0.35, 0.2)
#: figures that held-out runs are judged by where the objective has one of its own
USUAL = ("contour_rms_um", "following_rms_um")


class TrainingProgress(NamedTuple):
    """What is going on. round: of training. fresh: the objective on other plants, or None."""

    round: int
    progress: SearchProgress
    fresh: float | None


class Observer(NamedTuple):
    """Who is told: of every step, and of what comes next. other_plants: whether the objective on
    other plants is to be told, too."""

    step: Callable[[TrainingProgress], None]
    stage: Callable[[str], None]
    other_plants: bool = True


def _nothing(told: Any) -> None:
    return None


SILENT = Observer(_nothing, _nothing, other_plants=False)


class TrainingRound(NamedTuple):
    """One round of training. added: labels of the plants that were added for it."""

    tuned: SearchResult
    added: tuple[str, ...]


class SelectedGains(NamedTuple):
    """The gains that come out. share: of the way from those before to those that were found."""

    z: np.ndarray
    gains: Any
    share: float
    validation: Validation


class TuningResult(NamedTuple):
    """A tuning and what it rests on. problem: on the training runs, without added plants; exact:
    the same on the exact machine. surrogate: objective there before and after, None without one.
    judged: the held-out runs. refused: why the chosen gains are not accepted."""

    plan: TuningPlan
    problem: Problem
    exact: Problem
    surrogate: tuple[float, float] | None
    rounds: tuple[TrainingRound, ...]
    chosen: SelectedGains
    held_out: HeldOut
    pairs: PairedRuns
    diagnostics: Diagnostics
    refused: tuple[str, ...]

    @property
    def tuned(self) -> SearchResult:
        """The last round."""
        return self.rounds[-1].tuned

    @property
    def simulations(self) -> float:
        """Units of all rounds."""
        return sum(one.tuned.simulations for one in self.rounds)

    @property
    def seconds(self) -> float:
        """Seconds of all rounds."""
        return sum(one.tuned.seconds for one in self.rounds)


def run_tuning(
    plan: TuningPlan, folder: Path | None = None, watch: Observer = SILENT
) -> TuningResult:
    """Train, then test. folder: keeps every evaluation; a stopped tuning goes on from there."""
    watch.stage("compiling the training runs")
    problem = exact = problem_of(plan, groups_of(plan, runs_of(plan, "train")))
    if plan.table["surrogate"] != NONE:
        problem = problem_of(plan, _trained_on(plan, runs_of(plan, "train")))
    rounds = train_rounds(plan, problem, folder, watch)
    tuned = rounds[-1].tuned
    watch.stage("testing on the exact model: half the step, longer on other plants")
    chosen = _select(plan, exact, tuned)
    watch.stage("testing on held-out plants")
    pairs = held_out(plan, chosen.gains)
    verdict = held_out_verdict(pairs)
    watch.stage("diagnostics")
    return TuningResult(
        plan=plan,
        problem=problem,
        exact=exact,
        surrogate=_on_surrogate(problem, chosen.z) if problem is not exact else None,
        rounds=rounds,
        chosen=chosen,
        held_out=verdict,
        pairs=pairs,
        diagnostics=diagnose(problem, tuned, chosen.z, plan.case),
        refused=refusals(chosen.validation, verdict),
    )


def _trained_on(plan: TuningPlan, every: list[RunSet]) -> list[RunGroup]:
    """Runs of the search: of the surrogate, where there is one."""
    return groups_of(plan, every, plan.table["surrogate"])


def _on_surrogate(problem: Problem, z: np.ndarray) -> tuple[float, float]:
    before, after = evaluate(problem, np.stack([problem.space.start(), z])).objective
    return float(before), float(after)


def log_folder(folder: Path | None, name: str) -> Path | None:
    """Where the evaluations of one search are kept."""
    return None if folder is None else folder / "journal" / name


# --- training ----------------------------------------------------------------------------------


def train_rounds(
    plan: TuningPlan, problem: Problem, folder: Path | None = None, watch: Observer = SILENT
) -> tuple[TrainingRound, ...]:
    """Search, then, as often as the configuration asks for it, add the worst of other plants to the
    training runs and go on. folder: keeps every evaluation."""
    table, made = plan.table, METHODS.get(plan.table["method"])
    budget = table["budget"] / (table["worst_case"] + 1)
    other = _fresh_problem(plan, problem) if watch.other_plants else None
    rounds: list[TrainingRound] = []
    groups, added = list(problem.groups), ()
    for number in range(table["worst_case"] + 1):
        starts: int | np.ndarray = table["starts"]
        if number:
            watch.stage(f"round {number + 1}: looking for the worst plants")
            found = worst_plants(pool(plan, number), rounds[-1].tuned.gains, held_out_metric(plan))
            groups += _trained_on(plan, found.added)
            added = found.labels
            starts = rounds[-1].tuned.z[None]
        here = problem_of(plan, groups, problem) if number else problem
        watch.stage(f"training{f', round {number + 1}' if table['worst_case'] else ''}")
        tuned = tune(
            here,
            made() if made else None,
            starts,
            table["seed"] + number,
            budget,
            log_folder=log_folder(folder, f"round-{number}"),
            watch=_stepwise(number, other, watch),
        )
        rounds.append(TrainingRound(tuned, added))
    return tuple(rounds)


def _fresh_problem(plan: TuningPlan, problem: Problem) -> Problem:
    """The same problem on other plants: nothing is compiled again."""
    groups = _trained_on(plan, fresh_runs(plan))
    data = tuple((group.batch.scenario, group.batch.path) for group in groups)
    return problem._replace(groups=tuple(groups), data=data)


#: share of the time that may go into showing progress on other plants
SHOWING = 0.1


def _stepwise(
    number: int, other: Problem | None, watch: Observer
) -> Callable[[SearchProgress], None]:
    """Tells of a step, and of the same gains on other plants where they got better."""
    shown: dict[str, float] = {"best": np.inf, "spent": 0.0, "begun": time.perf_counter()}
    fresh: list[float] = []

    def told(progress: SearchProgress) -> None:
        now = time.perf_counter()
        due = shown["spent"] <= SHOWING * (now - shown["begun"])
        if other is not None and progress.best < shown["best"] and due:
            fresh.append(float(evaluate(other, progress.z[None]).objective[0]))
            shown["best"] = progress.best
            shown["spent"] += time.perf_counter() - now
        watch.step(TrainingProgress(number, progress, fresh[-1] if fresh else None))

    return told


# --- testing -----------------------------------------------------------------------------------


def _select(plan: TuningPlan, problem: Problem, tuned: SearchResult) -> SelectedGains:
    """The best gains on the way from those before to those found that pass their trials; those
    found where none do."""
    begun = problem.space.start()
    points = begun + np.append(0.0, SHARES)[:, None] * (tuned.z - begun)
    forms = [
        evaluate(problem, points),
        _again(plan, problem, half_step(plan.table["train"], plan.blocks), points),
        _again(plan, problem, prolonged(validation_table(plan), plan.blocks), points),
    ]
    found = [
        SelectedGains(
            points[i],
            problem.space.gains_of(jnp.asarray(points[i])),
            share,
            _validation(plan, problem, forms, i),
        )
        for i, share in enumerate(SHARES, start=1)
    ]
    good = [one for one in found if not validation_refusals(one.validation)]
    return min(good, key=lambda one: one.validation.exact.objective[1]) if good else found[0]


def _validation(
    plan: TuningPlan, problem: Problem, forms: list[Evaluation], index: int
) -> Validation:
    exact, half, longer = (_validation_runs(plan, form, index) for form in forms)
    return Validation(exact, half, longer, missed_goals(problem, forms[0], index))


def _again(plan: TuningPlan, problem: Problem, every: list[RunSet], z: np.ndarray) -> Evaluation:
    """Candidates on the training runs in another form."""
    return evaluate(problem_of(plan, groups_of(plan, every), problem, width=len(z)), z)


def _validation_runs(plan: TuningPlan, found: Evaluation, index: int) -> ValidationRuns:
    """The candidate at a place against the first."""
    values = found.columns[plan.metric][[0, index]]
    both = np.isfinite(values).all(axis=0)
    means = values[:, both].mean(axis=1) if both.any() else np.full(2, np.nan)
    before, after = found.objective[[0, index]]
    lost = int(np.isfinite(found.lost_at_s[index]).sum())
    return ValidationRuns((float(means[0]), float(means[1])), (float(before), float(after)), lost)


def missed_goals(problem: Problem, found: Evaluation, index: int) -> tuple[str, ...]:
    """The goals that a candidate does not meet, with the figures of the run that misses most."""
    columns = {name: values[index] for name, values in found.columns.items()}
    told = []
    for goal in problem.goals:
        over = np.nan_to_num(np.asarray(goal.violation(columns)), nan=np.inf)
        run = int(np.argmax(over))
        if over[run] > 0:
            figures = ", ".join(f"{name} = {columns[name][run]:.4g}" for name in goal.names)
            told.append(f"the goal {goal.text} is not met: {figures} in {problem.run_names[run]}")
    return tuple(told)


def held_out_metric(plan: TuningPlan) -> str:
    """What held-out runs are judged by: the figure of the objective where `jaxstage run` has it."""
    columns = dict.fromkeys(metric_names(plan.case))
    axes = plan.case.loop.plant.axes
    return next(n for n in (plan.metric, *USUAL) if has_column(columns, n, axes))


def held_out(plan: TuningPlan, gains: Any) -> PairedRuns:
    """The held-out runs under the gains before and some gains. Nothing has touched them before."""
    every = run_sets(plan.table["held_out"], plan.blocks)
    return simulate_pairs(every, plan.space.gains, gains, held_out_metric(plan))
