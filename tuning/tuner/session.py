"""A tuning from its configuration to evidence: rounds of training, then validation of the result.

Training sees only the training runs. What accepts or refuses comes after, on the exact model.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxstage.studies.verdict import scored_columns
from tuning.store.gains_file import refused_text
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
    Refusal,
    Validation,
    ValidationRuns,
    half_step,
    has_column,
    held_out_verdict,
    prolonged,
    refusals,
    simulate_pairs,
    validation_refusals,
    warnings,
)
from tuning.tuner.evidence.worst_case import worst_plants
from tuning.tuner.problem.objective import pull_factor
from tuning.tuner.problem.problem import Evaluation, Problem, RunGroup, evaluate
from tuning.tuner.problem.scenario_set import RunSet
from tuning.tuner.problem.surrogate import NONE
from tuning.tuner.search.optimise import METHODS, SearchProgress, SearchResult, tune
from tuning.uncertainty.metric_table import metric_names

#: how far gains may go from those before to those of the search; nearer ones where tests refuse
SHARES = (1.0, 0.9, 0.8, 0.65, 0.5, 0.35, 0.2)
#: metrics of held-out runs where the objective has one of its own
USUAL = ("contour_rms_um", "following_rms_um")


class TrainingProgress(NamedTuple):
    """What is going on. round: of training. fresh: J on other plants, or None."""

    round: int
    progress: SearchProgress
    fresh: float | None


class Observer(NamedTuple):
    """Callbacks of a tuning.

    Attributes:
        step: is told of every step.
        stage: is told of what comes next.
        other_plants: whether J on other plants is to be told, too.
    """

    step: Callable[[TrainingProgress], None]
    stage: Callable[[str], None]
    other_plants: bool = True


def _nothing(_: Any) -> None:
    return None


SILENT = Observer(_nothing, _nothing, other_plants=False)


class TrainingRound(NamedTuple):
    """One round of training. added: labels of the plants that were added for it."""

    tuned: SearchResult
    added: tuple[str, ...]


class SelectedGains(NamedTuple):
    """The gains that come out.

    Attributes:
        z: (n,).
        gains: the same as the law takes them.
        share: of the way from the gains before to those of the search.
        validation: what they were tested on.
    """

    z: np.ndarray
    gains: Any
    share: float
    validation: Validation


class TuningResult(NamedTuple):
    """A tuning and what it rests on.

    Attributes:
        plan: its configuration.
        problem: on the training runs, without added plants.
        exact: the same on the exact machine.
        surrogate: J on the surrogate before and after, None without one.
        rounds: of training.
        chosen: the gains that come out.
        held_out: verdict of the held-out runs.
        pairs: the held-out runs.
        diagnostics: of the search and its result.
        refused: why the gains are not accepted.
        scored: what of the runs is scored: of the loop itself, in training, held out.
        warnings: what they pay for their accuracy, one line each.
    """

    plan: TuningPlan
    problem: Problem
    exact: Problem
    surrogate: tuple[float, float] | None
    rounds: tuple[TrainingRound, ...]
    chosen: SelectedGains
    held_out: HeldOut
    pairs: PairedRuns
    diagnostics: Diagnostics
    refused: tuple[Refusal, ...]
    scored: Mapping[str, list[dict[str, float]]]
    warnings: tuple[str, ...]

    @property
    def without_pull(self) -> float:
        """J of the chosen gains without the pull towards the gains before."""
        moved = self.chosen.z - self.exact.space.start()
        return self.chosen.validation.exact.objective[1] / float(pull_factor(moved))

    @property
    def tuned(self) -> SearchResult:
        """The last round."""
        return self.rounds[-1].tuned

    @property
    def simulations(self) -> float:
        """Simulations of all rounds."""
        return sum(one.tuned.simulations for one in self.rounds)

    @property
    def seconds(self) -> float:
        """Seconds of all rounds."""
        return sum(one.tuned.seconds for one in self.rounds)


def run_tuning(
    plan: TuningPlan, folder: Path | None = None, watch: Observer = SILENT
) -> TuningResult:
    """Train, then validate.

    Args:
        plan: the configuration.
        folder: keeps every evaluation; a stopped tuning goes on from there.
        watch: is told of what happens.
    """
    watch.stage("compiling the training runs")
    train = runs_of(plan, "train")
    problem = exact = problem_of(plan, groups_of(plan, train))
    if plan.table["surrogate"] != NONE:
        problem = problem_of(plan, _trained_on(plan, train))
    rounds = train_rounds(plan, problem, folder, watch)
    tuned = rounds[-1].tuned
    watch.stage("testing on the exact model: half the step, longer on other plants")
    chosen = _select(plan, exact, tuned)
    watch.stage("testing on held-out plants")
    metric = held_out_metric(plan)
    held_out = runs_of(plan, "held_out")
    pairs = simulate_pairs(held_out, plan.space.gains, chosen.gains, metric)
    verdict = held_out_verdict(pairs)
    watch.stage("diagnostics")
    diagnostics = diagnose(problem, tuned, chosen.z, plan.case)
    if "refused" in plan.table:
        note = f"the gains before: {refused_text(plan.table['refused'])}"
        diagnostics = diagnostics._replace(notes=(note, *diagnostics.notes))
    return TuningResult(
        plan=plan,
        problem=problem,
        exact=exact,
        surrogate=_on_surrogate(problem, chosen.z) if problem is not exact else None,
        rounds=rounds,
        chosen=chosen,
        held_out=verdict,
        pairs=pairs,
        diagnostics=diagnostics,
        refused=refusals(chosen.validation, verdict),
        scored={
            "loop": [scored_columns(plan.case)],
            "training": _scored(train),
            "held_out": _scored(held_out),
        },
        warnings=warnings(verdict, plan.case.loop.plant.axes),
    )


def _scored(every: list[RunSet]) -> list[dict[str, float]]:
    """What of the runs is scored, each part once."""
    parts = [scored_columns(runs.case) for runs in every]
    return [part for k, part in enumerate(parts) if part not in parts[:k]]


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
    training runs and go on.

    Args:
        plan: the configuration.
        problem: on the training runs.
        folder: keeps every evaluation.
        watch: is told of what happens.
    """
    table, make = plan.table, METHODS.get(plan.table["method"])
    number_of_rounds = table["worst_case"] + 1
    other = _fresh_problem(plan, problem) if watch.other_plants else None
    rounds: list[TrainingRound] = []
    groups, added = list(problem.groups), ()
    for number in range(number_of_rounds):
        starts: int | np.ndarray = table["starts"]
        if number:
            watch.stage(f"round {number + 1}: looking for the worst plants")
            worst = worst_plants(pool(plan, number), rounds[-1].tuned.gains, held_out_metric(plan))
            groups += _trained_on(plan, worst.added)
            added = worst.labels
            starts = rounds[-1].tuned.z[None]
        here = problem_of(plan, groups, problem) if number else problem
        watch.stage(f"training{f', round {number + 1}' if table['worst_case'] else ''}")
        tuned = tune(
            here,
            make() if make else None,
            starts,
            table["seed"] + number,
            table["budget"] / number_of_rounds,
            log_folder=log_folder(folder, f"round-{number}"),
            watch=_Narrator(number, other, watch).tell,
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


@dataclass
class _Narrator:
    """Tells of a step, and of the same gains on other plants where they got better.

    best: J when other plants were last simulated. spent: seconds of that. fresh: J there.
    """

    number: int
    other: Problem | None
    watch: Observer
    best: float = np.inf
    spent: float = 0.0
    begun: float = field(default_factory=time.perf_counter)
    fresh: float | None = None

    def tell(self, progress: SearchProgress) -> None:
        """Tell of a step."""
        now = time.perf_counter()
        due = self.spent <= SHOWING * (now - self.begun)
        if self.other is not None and progress.best < self.best and due:
            self.fresh = float(evaluate(self.other, progress.z[None]).objective[0])
            self.best = progress.best
            self.spent += time.perf_counter() - now
        self.watch.step(TrainingProgress(self.number, progress, self.fresh))


# --- validation --------------------------------------------------------------------------------


def _select(plan: TuningPlan, problem: Problem, tuned: SearchResult) -> SelectedGains:
    """The best gains on the way from those before to those of the search that pass validation;
    those of the search where none do."""
    begun = problem.space.start()
    points = begun + np.append(0.0, SHARES)[:, None] * (tuned.z - begun)
    others = (
        half_step(plan.table["train"], plan.blocks),
        prolonged(validation_table(plan), plan.blocks),
    )
    forms = [(problem, evaluate(problem, points))]
    for every in others:
        other = problem_of(plan, groups_of(plan, every), problem, width=len(points))
        forms.append((other, evaluate(other, points)))
    candidates = []
    for i, share in enumerate(SHARES, start=1):
        exact, half, far = (_validation_runs(plan.metric, *form, i) for form in forms)
        validation = Validation(exact, half, far, missed_goals(*forms[0], i))
        gains = problem.space.gains_of(jnp.asarray(points[i]))
        candidates.append(SelectedGains(points[i], gains, share, validation))
    good = [one for one in candidates if not validation_refusals(one.validation)]
    return min(good, key=lambda one: one.validation.exact.objective[1], default=candidates[0])


def _validation_runs(metric: str, problem: Problem, form: Evaluation, index: int) -> ValidationRuns:
    """The candidate at a place against the first."""
    values = form.columns[metric][[0, index]]
    both = np.isfinite(values).all(axis=0)
    after = values[1][np.isfinite(values[1])]
    alone = np.array([np.nan, after.mean() if len(after) else np.nan])
    means = values[:, both].mean(axis=1) if both.any() else alone
    before, after = form.objective[[0, index]]
    lost_at = form.lost_at_s[index]
    lost = int(np.isfinite(lost_at).sum())
    decides = np.nanargmin(lost_at) if lost else np.argmax(np.nan_to_num(values[1]))
    run = problem.run_names[int(decides)]
    metrics, objectives = (float(means[0]), float(means[1])), (float(before), float(after))
    return ValidationRuns(metrics, objectives, lost, run)


def missed_goals(problem: Problem, evaluation: Evaluation, index: int) -> tuple[str, ...]:
    """The goals that a candidate does not meet, with the metrics of the run that misses most.

    Args:
        problem: whose goals.
        evaluation: of candidates.
        index: of the candidate.
    """
    columns = {name: values[index] for name, values in evaluation.columns.items()}
    lines = []
    for goal in problem.objective.goals:
        over = np.nan_to_num(np.asarray(goal.violation(columns)), nan=np.inf)
        run = int(np.argmax(over))
        if over[run] > 0:
            numbers = ", ".join(f"{name} = {columns[name][run]:.4g}" for name in goal.names)
            lines.append(f"the goal {goal.text} is not met: {numbers} in {problem.run_names[run]}")
    return tuple(lines)


def held_out_metric(plan: TuningPlan) -> str:
    """The metric of held-out runs: that of the objective where `jaxstage run` has it."""
    columns = dict.fromkeys(metric_names(plan.case))
    axes = plan.case.loop.plant.axes
    return next(n for n in (plan.metric, *USUAL) if has_column(columns, n, axes))
