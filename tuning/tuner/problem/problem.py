"""A tuning problem: training runs and what matters, evaluated for many gains at once."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tuning.tuner.problem.compiled_objective import CompiledObjective, compile_objective
from tuning.tuner.problem.objective import Goal, Risk, Term, mean
from tuning.tuner.problem.run_group import RunGroup as RunGroup
from tuning.tuner.problem.run_group import make_group as make_group
from tuning.tuner.problem.search_space import SearchSpace
from tuning.tuner.problem.training_metrics import least_scale, training_metric

#: candidates of one call of the compiled evaluation
WIDTH = 8
#: weight of a missed goal at the start
PENALTY = 100.0


class Evaluation(NamedTuple):
    """m candidates in all runs. violation: largest of a goal, inf where a run is lost, below 0 when
    all are met. lost_at_s: NaN where a run was not lost; columns are NaN where it was."""

    objective: np.ndarray
    costs: np.ndarray
    violation: np.ndarray
    lost_at_s: np.ndarray
    columns: dict[str, np.ndarray]


class ValueAndGrad(NamedTuple):
    """J (m,), dJ/dz (m, n) and the violation (m,)."""

    objective: np.ndarray
    gradient: np.ndarray
    violation: np.ndarray


class GaussNewtonModel(NamedTuple):
    """J (m,), dJ/dz (m, n), the Gauss-Newton matrix 2 sum omega dr/dz dr/dz^T (m, n, n), the
    violation (m,), and dc/dz of the cost of each run (m, runs, n)."""

    objective: np.ndarray
    gradient: np.ndarray
    gauss_newton: np.ndarray
    violation: np.ndarray
    of_runs: np.ndarray


class Problem(NamedTuple):
    """What is tuned, on what, for what. weights: (k, terms), row r for candidates of start r; one
    row for all. scales: (terms,). before: of the gains before."""

    space: SearchSpace
    groups: tuple[RunGroup, ...]
    terms: tuple[Term, ...]
    goals: tuple[Goal, ...]
    risk: Risk
    weights: np.ndarray
    scales: np.ndarray
    penalty: float
    width: int
    programs: CompiledObjective
    data: Any
    before: Evaluation | None

    @property
    def runs(self) -> int:
        """Training runs of one evaluation."""
        return sum(group.runs for group in self.groups)

    @property
    def run_names(self) -> tuple[str, ...]:
        """One a training run."""
        return tuple(f"{group.name} {i}" for group in self.groups for i in range(group.runs))


def make_problem(
    space: SearchSpace,
    groups: Sequence[RunGroup],
    terms: Sequence[Term],
    goals: Sequence[Goal] = (),
    risk: Risk = mean,
    width: int = WIDTH,
) -> Problem:
    """Compile the evaluation and evaluate the gains before, which set the scales left out.

    Raises ValueError, one line, for no runs or terms, an unknown column, a weight that is not
    positive, gains before that lose a training run, and a scale of 0.
    """
    groups, terms, goals = tuple(groups), tuple(terms), tuple(goals)
    if not groups or not terms:
        raise ValueError("a problem needs training runs and at least one term")
    for term in terms:
        if not (math.isfinite(term.weight) and term.weight > 0):
            raise ValueError(f"weight = {term.weight:g} of {term.column}: must be > 0")
        if term.scale is not None and not (math.isfinite(term.scale) and term.scale > 0):
            raise ValueError(f"scale = {term.scale:g} of {term.column}: must be > 0")
    columns = [term.column for term in terms] + [name for goal in goals for name in goal.names]
    beside = [least_scale(term.column) for term in terms if term.scale is None]
    columns += [least[0] for least in beside if least is not None]
    made = tuple(training_metric(group.case, columns) for group in groups)
    programs = compile_objective(space, groups, made, terms, goals, risk)
    problem = Problem(
        space=space,
        groups=groups,
        terms=terms,
        goals=goals,
        risk=risk,
        weights=np.array([[term.weight for term in terms]], float),
        scales=np.ones(len(terms)),
        penalty=PENALTY,
        width=width,
        programs=programs,
        data=tuple((group.batch.scenario, group.batch.path) for group in groups),
        before=None,
    )
    first = evaluate(problem, space.start()[None])
    if any(term.scale is None for term in terms):
        _refuse_lost(problem, first)
    _refuse_undefined(problem, first)
    problem = problem._replace(scales=scales_of(problem, first))
    return problem._replace(before=evaluate(problem, space.start()[None]))


def _refuse_lost(problem: Problem, before: Evaluation) -> None:
    lost = before.lost_at_s[0]
    if np.all(np.isnan(lost)):
        return
    first = int(np.nanargmin(lost))
    raise ValueError(
        f"before tuning {int(np.sum(~np.isnan(lost)))} of {problem.runs} training runs are lost, "
        f"the first, {problem.run_names[first]}, at {lost[first]:.4g} s: start from gains that "
        "hold them all, or give every term a scale"
    )


def _refuse_undefined(problem: Problem, before: Evaluation) -> None:
    """A figure without value in a run that is not lost has none in any search."""
    kept = np.isnan(before.lost_at_s[0])
    for name, value in before.columns.items():
        missing = np.flatnonzero(kept & ~np.isfinite(value[0]))
        if len(missing):
            raise ValueError(
                f"{name} has no value in training run {problem.run_names[missing[0]]}: what it "
                "needs, such as a reversal or a longer run, is not there"
            )


def scales_of(problem: Problem, before: Evaluation) -> np.ndarray:
    """What counts as 1 of each term, (terms,). before: the gains before, at scales of 1."""
    each = np.concatenate([group.weights for group in problem.groups])
    scales = []

    def mean_of(column: str) -> float:
        return math.sqrt(np.average(before.columns[column][0] ** 2, weights=each))

    for term in problem.terms:
        own, least = term.scale, least_scale(term.column)
        if own is None:
            own = mean_of(term.column)
            own = own if least is None else max(own, least[1] * mean_of(least[0]))
        if not (math.isfinite(own) and own > 0):
            raise ValueError(f"{term.column} is {own:g} before tuning: give it a scale")
        scales.append(own)
    return np.array(scales)


def with_weights(problem: Problem, weights: np.ndarray) -> Problem:
    """The problem whose start r is minimised with row r of weights (k, terms)."""
    weights = np.asarray(weights, float)
    good = weights.ndim == 2 and weights.shape[1] == len(problem.terms)
    if not good or not np.all(weights >= 0) or not np.all(weights.sum(axis=1) > 0):
        raise ValueError(f"weights must be (starts, {len(problem.terms)}), >= 0, no row all 0")
    return problem._replace(weights=weights)


def _arguments(problem: Problem, rows: np.ndarray) -> tuple[Any, ...]:
    weights = problem.weights[rows if len(problem.weights) > 1 else np.zeros_like(rows)]
    numbers = (weights, problem.scales, problem.penalty)
    return *map(jnp.asarray, numbers), problem.data


def _rows(z: np.ndarray, rows: np.ndarray | None) -> np.ndarray:
    return np.zeros(len(z), int) if rows is None else np.asarray(rows, int)


def evaluate(problem: Problem, z: np.ndarray, rows: np.ndarray | None = None) -> Evaluation:
    """Candidates z (m, n) in all training runs, `width` at once. rows: the start of each."""
    parts, rows = [], _rows(z, rows)
    for first in range(0, len(z), problem.width):
        index = np.minimum(np.arange(first, first + problem.width), len(z) - 1)
        found = problem.programs.evaluate(jnp.asarray(z[index]), *_arguments(problem, rows[index]))
        kept = min(problem.width, len(z) - first)
        parts.append(jax.tree.map(lambda x: np.asarray(x, float)[:kept], found))  # noqa: B023
    return Evaluation(*jax.tree.map(lambda *x: np.concatenate(x), *parts))


def value_and_grad(problem: Problem, z: np.ndarray, rows: np.ndarray | None = None) -> ValueAndGrad:
    """Objective and gradient of z (m, n), reverse mode."""
    found = problem.programs.value_and_grad(jnp.asarray(z), *_arguments(problem, _rows(z, rows)))
    return ValueAndGrad(*(np.asarray(x, float) for x in found))


def gauss_newton_model(
    problem: Problem, z: np.ndarray, rows: np.ndarray | None = None
) -> GaussNewtonModel:
    """Objective, gradient and Gauss-Newton matrix of z (m, n), forward mode."""
    found = problem.programs.gauss_newton_model(
        jnp.asarray(z), *_arguments(problem, _rows(z, rows))
    )
    return GaussNewtonModel(*(np.asarray(x, float) for x in found))


def directional(problem: Problem, z: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Slope of the cost of each run at one z (n,) along directions (d, n), (d, runs); forward."""
    arguments = _arguments(problem, np.zeros(1, int))
    found = problem.programs.directional(jnp.asarray(z)[None], jnp.asarray(directions), *arguments)
    return np.asarray(found, float)[:, 0]
