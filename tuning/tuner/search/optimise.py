"""From gains that work to gains that work better: method, budget, progress, kept evaluations.

A unit is one evaluation of the objective in all training runs; gradients and Jacobians are charged
as `prices` says. What would go beyond the budget is not asked. The same problem, method, seed,
starts and prices give the same result to the last bit on the same machine, in one go or stopped and
taken up again (`journal`).
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from tuning.tuner.problem import problem as problems
from tuning.tuner.problem.gradient_check import STEPS, GradientCheck, compare_slopes, directions_of
from tuning.tuner.problem.problem import Problem
from tuning.tuner.search.budgeted_oracle import (
    Best,
    BeyondBudget,
    BudgetedOracle,
    ask_all,
    kept,
    make_oracle,
    values_of,
)
from tuning.tuner.search.cma_es import cma_es
from tuning.tuner.search.cost_model import CostModel, measure_cost_model
from tuning.tuner.search.evaluation_log import digest, fingerprint, keep
from tuning.tuner.search.first_order import first_order
from tuning.tuner.search.lbfgs import lbfgs
from tuning.tuner.search.levenberg_marquardt import levenberg_marquardt
from tuning.tuner.search.method import Method, Oracle
from tuning.tuner.search.random_search import random_search
from tuning.uncertainty.designs import sobol_rows
from tuning.uncertainty.distributions import TAIL

#: up to so many parameters Levenberg-Marquardt, beyond them L-BFGS
FEW = 30
#: standard deviation in z of the CMA-ES that goes on where a descent has ended
POLISH = 0.3
#: points of the Sobol sequence that starts are picked from, and their standard deviation in z
AMONG, SPREAD = 16, 1.0
#: once this share of the budget is spent, a start so many times worse than the best is given up
TRIED, BEHIND = 1 / 3, 1.5
#: the weight of missed goals grows by this factor, to this at most, while a search ends at a miss
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
    """After a step. best, violation, z: of the best gains so far; gradient_norm: smallest of the
    starts, NaN where unknown; left_s: expected until the budget is spent."""

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
    """Where a start ended, at its best."""

    begun: np.ndarray
    z: np.ndarray
    objective: float
    violation: float


class SearchResult(NamedTuple):
    """before, after: J. feasible: no training run is lost and every goal is met. ended: why. note:
    why CMA-ES searched in place of the method that was asked for, or empty."""

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

    method: None chooses: by the number of parameters, and by a check of the gradients, CMA-ES where
    it fails; with few parameters what a descent leaves of the budget goes to CMA-ES from its best
    point, which passes kinks where no gradient leads on. starts: how many, the first the gains
    before, or their z (k, n). budget: units, never overrun; where it does not pay for the first
    step of the method, CMA-ES searches, and `note` says so. prices: None measures them. journal:
    folder that keeps every evaluation; given again, the tuning goes on where it was stopped. watch:
    called after each step.

    Raises ValueError for a budget that does not pay for the values of the starts, an impossible
    number of starts, and for a journal of something else.
    """
    count = starts if isinstance(starts, int) else len(starts)
    if not 1 <= count <= AMONG:
        raise ValueError(f"starts = {count}: must be 1..{AMONG}")
    screened = AMONG if isinstance(starts, int) and starts > 1 else 0
    if not budget >= screened + count:
        raise ValueError(f"budget = {budget:g}: must be >= {screened + count} units")
    few = problem.space.size <= FEW
    chosen = method or (levenberg_marquardt() if few else lbfgs())
    told = starts if isinstance(starts, int) else np.ascontiguousarray(starts, float)
    told_prices = None if cost_model is None else tuple(cost_model)
    question = digest(fingerprint(problem), chosen.name, method is None, told, seed, told_prices)
    keep(log_folder, 0, question, dict)
    cost_model = cost_model or _kept_cost_model(problem, chosen, count, log_folder)
    budgeted = BudgetedOracle(budget, log_folder, cost_model, count, [], {}, {})
    oracle = make_oracle(budgeted, problem)
    begun = _starts(oracle, problem, starts, seed)
    check, size = None, problem.space.size
    before = screened + (_cost_of_check(cost_model, size, count) if method is None else 0)
    chosen, note = _affordable(chosen, before + count * chosen.first(cost_model, size), budget)
    if method is None and not note:
        check = _check(budgeted, problem, begun[0], seed)
        chosen = chosen if check.ok else cma_es()
    history: list[SearchProgress] = []
    ended = _search(budgeted, problem, chosen, begun, seed, watch, history)
    ends = tuple(budgeted.best[k] for k in range(count))
    if method is None and few and chosen.needs and budgeted.simulations < budget:
        best = min(ends, key=Best.key).z[None]
        ended = _search(budgeted, problem, cma_es(POLISH), best, seed, watch, history)
    results = tuple(StartResult(z, *end) for z, end in zip(begun, ends, strict=True))
    return _result(problem, chosen, budgeted, results, check, history, ended, note)


def _affordable(method: Method, least: float, budget: float) -> tuple[Method, str]:
    """The method, or CMA-ES and a note where the budget does not pay for a gradient method's first
    step. least: units until then."""
    if not method.needs or least <= budget:
        return method, ""
    return cma_es(), (
        f"the first step of {method.name} costs {math.ceil(least)} units, more than the budget: "
        "CMA-ES searched"
    )


def least_budget(method: Method, n: int, starts: int) -> int:
    """The budget that pays for the first step of a method without gradients, which n parameters
    are searched by from so many starts. Other methods fall back on CMA-ES."""
    first = (method if not method.needs else cma_es()).first
    return math.ceil(AMONG + starts * first(CostModel(math.nan, math.nan, math.nan), n))


def _kept_cost_model(
    problem: Problem, method: Method, starts: int, log_folder: Path | None
) -> CostModel:
    def ask() -> dict[str, float]:
        return measure_cost_model(problem, method.needs, starts)._asdict()

    found, _ = keep(log_folder, 1, f"prices {method.needs} {starts}", ask)
    return CostModel(**{name: float(value) for name, value in found.items()})


def _starts(oracle: Oracle, problem: Problem, starts: int | np.ndarray, seed: int) -> np.ndarray:
    """z (k, n): the gains before, and the best of `AMONG` Sobol points around them."""
    if not isinstance(starts, int):
        return np.array(starts, float)
    first = problem.space.start()[None]
    if starts == 1:
        return first
    points = first + SPREAD * sobol_normal(seed, AMONG, first.shape[1])
    values = oracle.values(points, np.full(AMONG, SCREENING))
    return np.concatenate([first, points[np.argsort(values, kind="stable")[: starts - 1]]])


def sobol_normal(seed: int, count: int, size: int) -> np.ndarray:
    """Points (count, size) of a scrambled Sobol sequence, normally distributed."""
    from scipy.special import ndtri

    return ndtri(np.clip(sobol_rows(seed, count, size, 0, count), TAIL, 1 - TAIL))


def _cost_of_check(cost_model: CostModel, size: int, starts: int) -> float:
    """Units of `_check`; its Jacobian is the one that a search from one start begins with."""
    jacobian = cost_model.curvature if starts > 1 else 0.0
    return 2 * DIRECTIONS * len(STEPS) + (jacobian if size <= FEW else DIRECTIONS)


def _check(budgeted: BudgetedOracle, problem: Problem, z: np.ndarray, seed: int) -> GradientCheck:
    """The check of the gradients at the first start. What it asks is kept and charged: differences
    as evaluations, slopes along directions as one each."""
    along = directions_of(len(z), DIRECTIONS, seed)
    if len(z) <= FEW:
        found = make_oracle(budgeted, problem).gauss_newton_model(z[None], np.zeros(1, int))
        slopes = along @ found.of_runs[0].T
    else:
        question = digest("directional", z, along)
        slopes = kept(
            budgeted,
            question,
            float(DIRECTIONS),
            lambda: {"slopes": problems.directional(problem, z, along)},
        )["slopes"]
    differences = []
    for step in STEPS:
        ends = np.concatenate([z + step * along, z - step * along])
        rows = np.full(len(ends), SCREENING)
        costs = ask_all(budgeted, problem, values_of, 1.0, ends, rows)["costs"]
        differences.append((costs[:DIRECTIONS] - costs[DIRECTIONS:]).T / (2 * step))
    return compare_slopes(problem.run_names, slopes.T, differences)


def _search(
    budgeted: BudgetedOracle,
    problem: Problem,
    method: Method,
    begun: np.ndarray,
    seed: int,
    watch: Callable[[SearchProgress], None],
    history: list[SearchProgress],
) -> str:
    """Step until all starts are at their end or the budget is; which of them it was.

    history: every step is added to it, and what was still tried of one that could not be paid."""

    def tell(norms: np.ndarray) -> None:
        history.append(_progress(budgeted, norms, len(history)))
        watch(history[-1])

    try:
        return _steps(budgeted, problem, method, begun, seed, tell)
    except BeyondBudget:
        if history[-1].simulations < budgeted.simulations:
            tell(np.full(len(begun), np.nan))
        return "the budget does not pay for the next step"


def _steps(
    budgeted: BudgetedOracle,
    problem: Problem,
    method: Method,
    begun: np.ndarray,
    seed: int,
    tell: Callable[[np.ndarray], None],
) -> str:
    state = method.begin(make_oracle(budgeted, problem), begun, seed)
    while True:
        tell(state.gradient_norm)
        if np.all(state.done):
            missed = problem.goals and min(b.key()[0] for b in budgeted.best.values()) > 0
            if not missed or problem.penalty * HARDER > HARDEST:
                return "no start finds anything better"
            problem = problem._replace(penalty=problem.penalty * HARDER)
            again = np.stack([budgeted.best[row].z for row in range(len(begun))])
            state = method.begin(make_oracle(budgeted, problem), again, seed)
            continue
        if budgeted.simulations > TRIED * budgeted.budget and len(problem.weights) == 1:
            state = state._replace(done=state.done | (state.value > BEHIND * np.min(state.value)))
        state = method.step(make_oracle(budgeted, problem), state)


def _progress(budgeted: BudgetedOracle, norms: np.ndarray, step: int) -> SearchProgress:
    best = min(budgeted.best.values(), key=Best.key)
    norms = norms[np.isfinite(norms)]
    left = (
        (budgeted.budget - budgeted.simulations) * budgeted.seconds / max(budgeted.simulations, 1.0)
    )
    return SearchProgress(
        step=step,
        simulations=budgeted.simulations,
        budget=budgeted.budget,
        seconds=budgeted.seconds,
        left_s=left,
        best=best.objective,
        gradient_norm=float(np.min(norms)) if len(norms) else np.nan,
        violation=best.violation,
        z=best.z,
    )


def _result(
    problem: Problem,
    method: Method,
    budgeted: BudgetedOracle,
    starts: tuple[StartResult, ...],
    check: GradientCheck | None,
    history: list[SearchProgress],
    ended: str,
    note: str,
) -> SearchResult:
    best = min(budgeted.best.values(), key=Best.key)
    assert problem.before is not None
    gains = problem.space.gains_of(jnp.asarray(best.z))
    return SearchResult(
        method=method.name,
        n=problem.space.size,
        z=best.z,
        gains=gains,
        before=float(problem.before.objective[0]),
        after=best.objective,
        violation=best.violation,
        feasible=best.violation <= 0,
        simulations=budgeted.simulations,
        seconds=budgeted.seconds,
        cost_model=budgeted.cost_model,
        check=check,
        starts=starts,
        history=tuple(history),
        ended=ended,
        note=note,
    )
