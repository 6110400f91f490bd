"""Tuning problem: search space, training runs and objective, evaluated for many gains at once.

Scales that the user leaves out are the metrics of the gains before. Where these lose a run there
are none: then they are those of the best of `SCREENED` quasi-random points around, among those that
hold every run.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tuning.tuner.problem.compiled_objective import CompiledObjective, compile_objective
from tuning.tuner.problem.objective import Objective
from tuning.tuner.problem.run_group import RunGroup as RunGroup
from tuning.tuner.problem.run_group import make_group as make_group
from tuning.tuner.problem.screening import sobol_normal
from tuning.tuner.problem.search_space import SearchSpace
from tuning.tuner.problem.training_metrics import least_scale, training_metric

#: candidates of one call of the compiled evaluation
WIDTH = 8
#: weight mu of a missed goal at the start
PENALTY = 100.0
#: points that are tried around gains that lose a run, with each of some standard deviations in z
SCREENED, SPREADS = 32, (1.0, 2.0, 4.0)


class Evaluation(NamedTuple):
    """m candidates in all runs.

    Attributes:
        objective: J, (m,).
        costs: c of each run, (m, runs).
        violation: largest of a goal, inf where a run is lost, below 0 when all are met, (m,).
        lost_at_s: when a run was lost, NaN where it was not, (m, runs).
        columns: metrics by name, NaN where a run was lost, (m, runs) each.
    """

    objective: np.ndarray
    costs: np.ndarray
    violation: np.ndarray
    lost_at_s: np.ndarray
    columns: dict[str, np.ndarray]


class ValueAndGrad(NamedTuple):
    """Objective and gradient.

    Attributes:
        objective: J, (m,).
        gradient: dJ/dz, (m, n).
        violation: as in `Evaluation`, (m,).
    """

    objective: np.ndarray
    gradient: np.ndarray
    violation: np.ndarray


class GaussNewtonModel(NamedTuple):
    """Quadratic model of the objective: J + g^T p + p^T H p / 2.

    Attributes:
        objective: J, (m,).
        gradient: g = dJ/dz, (m, n).
        gauss_newton: H = 2 sum_s omega_s dr_s/dz dr_s/dz^T, (m, n, n).
        violation: as in `Evaluation`, (m,).
        of_runs: dc/dz of the cost of each run, (m, runs, n).
    """

    objective: np.ndarray
    gradient: np.ndarray
    gauss_newton: np.ndarray
    violation: np.ndarray
    of_runs: np.ndarray


class Problem(NamedTuple):
    """What is tuned, on what, for what.

    Attributes:
        space: search space of n coordinates.
        groups: training runs.
        objective: terms, goals and risk.
        weights: of the terms, (k, terms): row r for candidates of start r, or one row for all.
        scales: what counts as 1 of each term, (terms,).
        penalty: mu of missed goals.
        width: candidates of one call of the compiled evaluation.
        programs: the compiled functions.
        data: (scenario, motion) of each group.
        before: the gains before, evaluated.
        holding: z of other gains that hold all runs, where those before do not and the scales are
            theirs, (n,); else None.
    """

    space: SearchSpace
    groups: tuple[RunGroup, ...]
    objective: Objective
    weights: np.ndarray
    scales: np.ndarray
    penalty: float
    width: int
    programs: CompiledObjective
    data: tuple[tuple[Any, Any], ...]
    before: Evaluation | None
    holding: np.ndarray | None = None

    @property
    def runs(self) -> int:
        """Training runs of one evaluation."""
        return sum(group.runs for group in self.groups)

    @property
    def run_names(self) -> tuple[str, ...]:
        """One a training run."""
        return tuple(f"{group.name} {i}" for group in self.groups for i in range(group.runs))


def make_problem(
    space: SearchSpace, groups: Sequence[RunGroup], objective: Objective, width: int = WIDTH
) -> Problem:
    """Compile the evaluation and evaluate the gains before, which set the scales left out.

    Where the gains before lose a run, other gains that hold them all set the scales.

    Args:
        space: what is searched.
        groups: training runs.
        objective: what matters.
        width: candidates of one call.

    Raises:
        ValueError: in one line, for no runs or terms, an unknown column, a weight that is not
            positive, gains before that lose a training run where no others are found that hold all
            and a term has no scale, and a scale of 0.
    """
    groups, terms = tuple(groups), objective.terms
    if not groups or not terms:
        raise ValueError("a problem needs training runs and at least one term")
    for term in terms:
        for name, value in (("weight", term.weight), ("scale", term.scale)):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} = {value:g} of {term.column}: must be > 0")
    columns = [term.column for term in terms]
    columns += [name for goal in objective.goals for name in goal.names]
    beside = [least_scale(term.column) for term in terms if term.scale is None]
    columns += [least[0] for least in beside if least is not None]
    metrics = tuple(training_metric(group.case, columns) for group in groups)
    problem = Problem(
        space=space,
        groups=groups,
        objective=objective,
        weights=np.array([[term.weight for term in terms]], float),
        scales=np.ones(len(terms)),
        penalty=PENALTY,
        width=width,
        programs=compile_objective(space, groups, metrics, objective),
        data=tuple((group.batch.scenario, group.batch.path) for group in groups),
        before=None,
    )
    first = evaluate(problem, space.start()[None])
    if any(term.scale is None for term in terms) and np.any(np.isfinite(first.lost_at_s)):
        problem, first = _with_holding(problem, first)
    _refuse_undefined(problem, first)
    problem = problem._replace(scales=scales_of(problem, first))
    return problem._replace(before=evaluate(problem, space.start()[None]))


def _with_holding(problem: Problem, before: Evaluation) -> tuple[Problem, Evaluation]:
    """The problem with gains that hold all runs, and these evaluated: of quasi-random points around
    the gains before the one with the smallest first term.

    Raises:
        ValueError: there is none.
    """
    start = problem.space.start()
    points = sobol_normal(0, SCREENED, len(start))
    every = np.concatenate([start + s * points for s in SPREADS])
    tried = evaluate(problem, every)
    holds = np.isnan(tried.lost_at_s).all(axis=1)
    if holds.any():
        each = np.concatenate([group.weights for group in problem.groups])
        error = np.average(tried.columns[problem.objective.terms[0].column] ** 2, 1, each)
        best = int(np.argmin(np.where(holds & np.isfinite(error), error, np.inf)))
        own = Evaluation(*jax.tree.map(lambda x: x[best : best + 1], tuple(tried)))
        return problem._replace(holding=every[best]), own
    lost = before.lost_at_s[0]
    first = int(np.nanargmin(lost))
    raise ValueError(
        f"before tuning {int(np.sum(~np.isnan(lost)))} of {problem.runs} training runs are lost, "
        f"the first, {problem.run_names[first]}, at {lost[first]:.4g} s, and none of {len(every)} "
        "other gains holds them all: start from gains that do, widen the ranges, or give every "
        "term a scale"
    )


def _refuse_undefined(problem: Problem, before: Evaluation) -> None:
    """A metric without value in a run that is not lost has none in any search."""
    kept = np.isnan(before.lost_at_s[0])
    for name, value in before.columns.items():
        missing = np.flatnonzero(kept & ~np.isfinite(value[0]))
        if len(missing):
            raise ValueError(
                f"{name} has no value in training run {problem.run_names[missing[0]]}: what it "
                "needs, such as a reversal or a longer run, is not there"
            )


def scales_of(problem: Problem, before: Evaluation) -> np.ndarray:
    """Normalisation of the terms: what counts as 1 of each.

    Args:
        problem: whose terms may say so themselves.
        before: the gains before, at scales of 1.

    Returns:
        (terms,), in the unit of each column.

    Raises:
        ValueError: a scale is not positive.
    """
    each = np.concatenate([group.weights for group in problem.groups])
    scales = []

    def rms(column: str) -> float:
        return math.sqrt(np.average(before.columns[column][0] ** 2, weights=each))

    for term in problem.objective.terms:
        own, least = term.scale, least_scale(term.column)
        if own is None:
            own = rms(term.column)
            own = own if least is None else max(own, least[1] * rms(least[0]))
        if not (math.isfinite(own) and own > 0):
            raise ValueError(f"{term.column} is {own:g} before tuning: give it a scale")
        scales.append(own)
    return np.array(scales)


def with_weights(problem: Problem, weights: np.ndarray) -> Problem:
    """The problem whose start r is minimised with row r of the weights.

    Args:
        problem: of any weights.
        weights: (k, terms), >= 0.

    Raises:
        ValueError: of another shape, negative, or a row of zeros.
    """
    weights, terms = np.asarray(weights, float), len(problem.objective.terms)
    good = weights.ndim == 2 and weights.shape[1] == terms
    if not good or not np.all(weights >= 0) or not np.all(weights.sum(axis=1) > 0):
        raise ValueError(f"weights must be (starts, {terms}), >= 0, no row all 0")
    return problem._replace(weights=weights)


def _arguments(problem: Problem, rows: np.ndarray | None, count: int) -> tuple[Any, ...]:
    """Weights (count, terms), scales, penalty and data, as the programs take them."""
    one = rows is None or len(problem.weights) == 1
    weights = problem.weights[np.zeros(count, int) if one else np.asarray(rows, int)]
    return *map(jnp.asarray, (weights, problem.scales, problem.penalty)), problem.data


def evaluate(problem: Problem, z: np.ndarray, rows: np.ndarray | None = None) -> Evaluation:
    """Simulate candidates in all training runs, `Problem.width` at once.

    Args:
        problem: training runs and objective.
        z: candidates, (m, n).
        rows: the start of each, (m,); None: the first.
    """
    parts = []
    for first in range(0, len(z), problem.width):
        index = np.minimum(np.arange(first, first + problem.width), len(z) - 1)
        own = _arguments(problem, None if rows is None else np.asarray(rows)[index], len(index))
        batch = problem.programs.evaluate(jnp.asarray(z[index]), *own)
        kept = min(problem.width, len(z) - first)
        parts.append(jax.tree.map(lambda x, kept=kept: np.asarray(x, float)[:kept], batch))
    return Evaluation(*jax.tree.map(lambda *x: np.concatenate(x), *parts))


def value_and_grad(problem: Problem, z: np.ndarray, rows: np.ndarray | None = None) -> ValueAndGrad:
    """Objective and gradient of candidates z (m, n) by reverse mode. rows: as in `evaluate`."""
    arguments = _arguments(problem, rows, len(z))
    fields = problem.programs.value_and_grad(jnp.asarray(z), *arguments)
    return ValueAndGrad(*(np.asarray(x, float) for x in fields))


def gauss_newton_model(
    problem: Problem, z: np.ndarray, rows: np.ndarray | None = None
) -> GaussNewtonModel:
    """Quadratic model at candidates z (m, n) by forward mode. rows: as in `evaluate`."""
    arguments = _arguments(problem, rows, len(z))
    fields = problem.programs.gauss_newton_model(jnp.asarray(z), *arguments)
    return GaussNewtonModel(*(np.asarray(x, float) for x in fields))


def directional(problem: Problem, z: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Directional derivatives of the cost of each run, by forward mode.

    Args:
        problem: training runs and objective.
        z: where, (n,).
        directions: (d, n).

    Returns:
        (d, runs).
    """
    arguments = _arguments(problem, None, 1)
    slopes = problem.programs.directional(jnp.asarray(z)[None], jnp.asarray(directions), *arguments)
    return np.asarray(slopes, float)[:, 0]
