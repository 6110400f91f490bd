"""From gains that work to gains that work better: method, starts, budget, progress, log.

The budget counts simulations of the whole training set; derivatives are charged as the cost model
says. What would go beyond the budget is not asked. The same problem, method, seed, starts and cost
model give the same result to the last bit on the same machine, in one go or stopped and taken up
again (`evaluation_log`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from tuning.tuner.problem import problem as problems
from tuning.tuner.problem.gradient_check import (
    STEPS,
    GradientCheck,
    compare_slopes,
    directions_of,
)
from tuning.tuner.problem.problem import Problem
from tuning.tuner.problem.screening import sobol_normal
from tuning.tuner.search.budgeted_oracle import Best, BeyondBudget, BudgetedOracle
from tuning.tuner.search.cma_es import cma_es
from tuning.tuner.search.cost_model import CostModel, measure_cost_model
from tuning.tuner.search.evaluation_log import digest, fingerprint, logged
from tuning.tuner.search.first_order import first_order
from tuning.tuner.search.lbfgs import lbfgs
from tuning.tuner.search.levenberg_marquardt import levenberg_marquardt
from tuning.tuner.search.method import Method
from tuning.tuner.search.random_search import random_search

#: up to so many parameters Levenberg-Marquardt, beyond them L-BFGS
FEW = 30
#: standard deviation in z of the CMA-ES that goes on where a descent has ended
POLISH = 0.3
#: points of the Sobol sequence that starts are picked from, and their standard deviation in z
AMONG, SPREAD = 16, 1.0
#: once this share of the budget is spent, a start so many times worse than the best is given up
TRIED, BEHIND = 1 / 3, 1.5
#: the penalty of missed goals grows by this factor, to this at most, while a search ends at a miss
HARDER, HARDEST = 10.0, 1e7
#: directions of the check of the gradients
DIRECTIONS = 3
#: the "start" of candidates that belong to none
SCREENING = -1

#: by the names that options use
METHODS: dict[str, Callable[[], Method]] = {
    "lm": levenberg_marquardt,
    "lbfgs": lbfgs,
    "adam": first_order,
    "cma": cma_es,
    "random": random_search,
}


class SearchProgress(NamedTuple):
    """State of a search after a step.

    Attributes:
        step: from 0.
        simulations: spent so far.
        budget: simulations that may be spent.
        seconds: of evaluation so far.
        left_s: seconds expected until the budget is spent.
        best: J of the best gains so far.
        gradient_norm: smallest of the starts, NaN where unknown.
        violation: largest miss of a goal at the best gains, inf where a run is lost.
        z: the best gains, (n,).
    """

    step: int
    simulations: float
    budget: float
    seconds: float
    left_s: float
    best: float
    gradient_norm: float
    violation: float
    z: np.ndarray


class StartResult(NamedTuple):
    """Where a start began and ended, at its best: z (n,), J and the largest miss of a goal."""

    begun: np.ndarray
    z: np.ndarray
    objective: float
    violation: float


class SearchResult(NamedTuple):
    """The best gains of a search, and how they were found.

    Attributes:
        method: that searched from the starts.
        n: parameters.
        z: the best gains, (n,).
        gains: the same as the law takes them.
        before: J of the gains before.
        after: J of the best gains.
        violation: largest miss of a goal there.
        feasible: no training run is lost and every goal is met.
        simulations: spent.
        seconds: of evaluation.
        cost_model: what derivatives were charged with.
        check: of the gradients; None where none was made.
        starts: where each ended.
        history: every step.
        ended: why the search ended.
        note: why CMA-ES searched in place of the method that was asked for, or empty.
    """

    method: str
    n: int
    z: np.ndarray
    gains: Any
    before: float
    after: float
    violation: float
    feasible: bool
    simulations: float
    seconds: float
    cost_model: CostModel
    check: GradientCheck | None
    starts: tuple[StartResult, ...]
    history: tuple[SearchProgress, ...]
    ended: str
    note: str


@dataclass
class _Search:
    """A search that is under way. history: a record of every step, which fills."""

    asked: BudgetedOracle
    problem: Problem
    seed: int
    watch: Callable[[SearchProgress], None]
    history: list[SearchProgress] = field(default_factory=list)


def tune(
    problem: Problem,
    method: Method | None = None,
    starts: int | np.ndarray = 1,
    seed: int = 0,
    budget: float = 2000.0,
    cost_model: CostModel | None = None,
    log_folder: Path | None = None,
    watch: Callable[[SearchProgress], None] = lambda progress: None,
) -> SearchResult:
    """Minimise J from the gains before, and from other starts.

    Args:
        problem: training runs and objective.
        method: None chooses: Levenberg-Marquardt for few parameters, L-BFGS for many, CMA-ES where
            a check of the gradients fails. With few parameters CMA-ES then spends the rest of the
            budget around the best point, which passes kinks where no gradient leads on.
        starts: how many, the first the gains before (where these lose a run, gains that hold all),
            or their z (k, n).
        seed: of starts and method.
        budget: simulations, never overrun. Where it does not pay for the first step of the method,
            CMA-ES searches, and `SearchResult.note` says so.
        cost_model: None measures it.
        log_folder: keeps every evaluation; given again, the search goes on where it was stopped.
        watch: called after each step.

    Raises:
        ValueError: a budget that does not pay for the values of the starts, an impossible number of
            starts, or a log of something else.
    """
    count = starts if isinstance(starts, int) else len(starts)
    if not 1 <= count <= AMONG:
        raise ValueError(f"starts = {count}: must be 1..{AMONG}")
    screened = AMONG if isinstance(starts, int) and starts > 1 else 0
    if not budget >= screened + count:
        raise ValueError(f"budget = {budget:g}: must be >= {screened + count} simulations")
    size = problem.space.size
    chosen = method or (levenberg_marquardt() if size <= FEW else lbfgs())
    named = starts if isinstance(starts, int) else np.ascontiguousarray(starts, float)
    costs = None if cost_model is None else tuple(cost_model)
    question = digest(fingerprint(problem), chosen.name, method is None, named, seed, costs)
    logged(log_folder, 0, question, dict)
    cost_model = cost_model or _logged_cost_model(problem, chosen, count, log_folder)
    asked = BudgetedOracle(budget, log_folder, cost_model, count)
    search = _Search(asked, problem, seed, watch)
    begun = _starts(search, starts)
    before = screened + (_cost_of_check(cost_model, size, count) if method is None else 0)
    chosen, note = _affordable(chosen, before + count * chosen.first(cost_model, size), budget)
    check = _check(search, begun[0]) if method is None and not note else None
    chosen = cma_es() if check and not check.ok else chosen
    ended = _run(search, chosen, begun)
    ends = tuple(asked.best[k] for k in range(count))
    if method is None and size <= FEW and chosen.needs and asked.simulations < budget:
        ended = _run(search, cma_es(POLISH), min(ends, key=Best.key).z[None])
    results = tuple(StartResult(z, *end) for z, end in zip(begun, ends, strict=True))
    best = min(asked.best.values(), key=Best.key)
    assert problem.before is not None
    return SearchResult(
        method=chosen.name,
        n=size,
        z=best.z,
        gains=problem.space.gains_of(jnp.asarray(best.z)),
        before=float(problem.before.objective[0]),
        after=best.objective,
        violation=best.violation,
        feasible=best.violation <= 0,
        simulations=asked.simulations,
        seconds=asked.seconds,
        cost_model=cost_model,
        check=check,
        starts=results,
        history=tuple(search.history),
        ended=ended,
        note=note,
    )


def _affordable(method: Method, least: float, budget: float) -> tuple[Method, str]:
    """The method, or CMA-ES and a note where the budget does not pay for a gradient method's first
    step. least: simulations until then."""
    if not method.needs or least <= budget:
        return method, ""
    return cma_es(), (
        f"the first step of {method.name} costs {math.ceil(least)} simulations, more than the "
        "budget: CMA-ES searched"
    )


def least_budget(method: Method, n: int, starts: int) -> int:
    """Simulations until the first step of a derivative-free method.

    Methods with derivatives fall back on CMA-ES.

    Args:
        method: that is to search.
        n: parameters.
        starts: how many.
    """
    first = (method if not method.needs else cma_es()).first
    return math.ceil(AMONG + starts * first(CostModel(math.nan, math.nan, math.nan), n))


def _logged_cost_model(
    problem: Problem, method: Method, starts: int, log_folder: Path | None
) -> CostModel:
    def compute() -> dict[str, float]:
        return measure_cost_model(problem, method.needs, starts)._asdict()

    answer, _ = logged(log_folder, 1, f"cost model {method.needs} {starts}", compute)
    return CostModel(**{name: float(value) for name, value in answer.items()})


def _starts(search: _Search, starts: int | np.ndarray) -> np.ndarray:
    """z (k, n): the gains before, or those that hold where they do not, and the best of `AMONG`
    Sobol points around them."""
    if not isinstance(starts, int):
        return np.array(starts, float)
    problem = search.problem
    first = (problem.space.start() if problem.holding is None else problem.holding)[None]
    if starts == 1:
        return first
    points = first + SPREAD * sobol_normal(search.seed, AMONG, first.shape[1])
    values = search.asked.values(search.problem, points, np.full(AMONG, SCREENING))["objective"]
    return np.concatenate([first, points[np.argsort(values, kind="stable")[: starts - 1]]])


def _cost_of_check(cost_model: CostModel, size: int, starts: int) -> float:
    """Simulations of `_check`; its Jacobian is the one that a search from one start begins with."""
    jacobian = cost_model.gauss_newton if starts > 1 else 0.0
    return 2 * DIRECTIONS * len(STEPS) + (jacobian if size <= FEW else DIRECTIONS)


def _check(search: _Search, z: np.ndarray) -> GradientCheck:
    """The check of the gradients at the first start. What it asks is logged and charged:
    differences as evaluations, slopes along directions as one each."""
    asked, problem = search.asked, search.problem
    along = directions_of(len(z), DIRECTIONS, search.seed)
    if len(z) <= FEW:
        model = asked.oracle(problem).gauss_newton_model(z[None], np.zeros(1, int))
        slopes = along @ model.of_runs[0].T
    else:
        question = digest("directional", z, along)
        slopes = asked.answer(
            question,
            float(DIRECTIONS),
            lambda: {"slopes": problems.directional(problem, z, along)},
        )["slopes"]
    differences = []
    for step in STEPS:
        ends = np.concatenate([z + step * along, z - step * along])
        costs = asked.values(problem, ends, np.full(len(ends), SCREENING))["costs"]
        differences.append((costs[:DIRECTIONS] - costs[DIRECTIONS:]).T / (2 * step))
    return compare_slopes(problem.run_names, slopes.T, differences)


def _run(search: _Search, method: Method, begun: np.ndarray) -> str:
    """Step until all starts are at their end or the budget is; which of them it was.

    What was still tried of a step that could not be paid is told, too."""
    try:
        return _steps(search, method, begun)
    except BeyondBudget:
        if search.history[-1].simulations < search.asked.simulations:
            _tell(search, np.full(len(begun), np.nan))
        return "the budget does not pay for the next step"


def _steps(search: _Search, method: Method, begun: np.ndarray) -> str:
    asked, problem = search.asked, search.problem
    state = method.begin(asked.oracle(problem), begun, search.seed)
    while True:
        _tell(search, state.gradient_norm)
        if np.all(state.done):
            missed = problem.objective.goals and min(b.key()[0] for b in asked.best.values()) > 0
            if not missed or problem.penalty * HARDER > HARDEST:
                return "no start finds anything better"
            problem = problem._replace(penalty=problem.penalty * HARDER)
            again = np.stack([asked.best[row].z for row in range(len(begun))])
            state = method.begin(asked.oracle(problem), again, search.seed)
            continue
        if asked.simulations > TRIED * asked.budget and len(problem.weights) == 1:
            state = state._replace(done=state.done | (state.value > BEHIND * np.min(state.value)))
        state = method.step(asked.oracle(problem), state)


def _tell(search: _Search, norms: np.ndarray) -> None:
    """Record a step and tell of it. norms: of the gradients, (k,)."""
    asked = search.asked
    best = min(asked.best.values(), key=Best.key)
    norms = norms[np.isfinite(norms)]
    left = (asked.budget - asked.simulations) * asked.seconds / max(asked.simulations, 1.0)
    progress = SearchProgress(
        step=len(search.history),
        simulations=asked.simulations,
        budget=asked.budget,
        seconds=asked.seconds,
        left_s=left,
        best=best.objective,
        gradient_norm=float(np.min(norms)) if len(norms) else np.nan,
        violation=best.violation,
        z=best.z,
    )
    search.history.append(progress)
    search.watch(progress)
