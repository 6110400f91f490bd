"""What a tuning has asked so far: answers, what they cost, and the best of each start.

Every question is asked and charged once, and none that goes beyond the budget is asked at all.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tuning.tuner.problem import problem as problems
from tuning.tuner.problem.problem import GaussNewtonModel, Problem, ValueAndGrad
from tuning.tuner.search.cost_model import CostModel
from tuning.tuner.search.evaluation_log import Answer, digest, keep
from tuning.tuner.search.method import Oracle

#: by which a sum of units may be off
ROUNDING = 1e-6
#: questions kept before those of the search: what is tuned, and the prices
FIRST = 2


class Best(NamedTuple):
    """The best of the candidates of a start."""

    z: np.ndarray
    objective: float
    violation: float

    def key(self) -> tuple[float, float]:
        """Smaller is better: first what is missed, then J."""
        return max(self.violation, 0.0), self.objective


class BudgetedOracle(NamedTuple):
    """What a tuning has asked so far; it fills while it runs. costs: (units, seconds) of every
    question. known: answers of this process by question."""

    budget: float
    folder: Path | None
    cost_model: CostModel
    starts: int
    costs: list[tuple[float, float]]
    best: dict[int, Best]
    known: dict[str, Answer]

    @property
    def simulations(self) -> float:
        """Units spent."""
        return sum(simulations for simulations, _ in self.costs)

    @property
    def seconds(self) -> float:
        """Seconds of evaluation, those of an earlier process included."""
        return sum(seconds for _, seconds in self.costs)


class BeyondBudget(Exception):
    """A question costs more than what is left."""


def kept(
    budgeted: BudgetedOracle, question: str, simulations: float, answer: Callable[[], Answer]
) -> Answer:
    """The answer to a question, asked and charged only once. Raises `BeyondBudget`."""
    if question not in budgeted.known:
        if budgeted.simulations + simulations > budgeted.budget + ROUNDING:
            raise BeyondBudget
        index = len(budgeted.costs) + FIRST
        budgeted.known[question], seconds = keep(budgeted.folder, index, question, answer)
        budgeted.costs.append((simulations, seconds))
    return budgeted.known[question]


def ask_all(
    budgeted: BudgetedOracle,
    problem: Problem,
    ask: Callable[..., Any],
    price: float,
    z: np.ndarray,
    rows: np.ndarray,
) -> Answer:
    """What ``ask`` says of candidates z (m, n) of starts ``rows``; the best are remembered."""
    question = digest(ask.__name__, problem.penalty, z, rows.astype(np.int64))
    found = kept(budgeted, question, len(z) * price, lambda: ask(problem, z, rows))
    for i, row in enumerate(map(int, rows)):
        own = Best(z[i], float(found["objective"][i]), float(found["violation"][i]))
        if row not in budgeted.best or own.key() < budgeted.best[row].key():
            budgeted.best[row] = own
    return found


def values_of(problem: Problem, z: np.ndarray, rows: np.ndarray) -> Answer:
    """Plain evaluations, as `ask_all` asks for them."""
    found = problems.evaluate(problem, z, rows)
    return {"objective": found.objective, "violation": found.violation, "costs": found.costs}


def make_oracle(budgeted: BudgetedOracle, problem: Problem) -> Oracle:
    """The oracle of a problem whose answers are kept, charged and remembered."""
    cost_model = budgeted.cost_model

    def filled(z: np.ndarray, rows: np.ndarray, ask: Callable[..., Any]) -> Answer:
        """All starts in one call, so that one program does, however many of them move."""
        full = np.minimum(np.arange(max(budgeted.starts, len(z))), len(z) - 1)
        found = ask(problem, z[full], rows[full])
        return {name: x[: len(z)] for name, x in found._asdict().items()}

    def reverse(problem: Problem, z: np.ndarray, rows: np.ndarray) -> Answer:
        return filled(z, rows, problems.value_and_grad)

    def forward(problem: Problem, z: np.ndarray, rows: np.ndarray) -> Answer:
        return filled(z, rows, problems.gauss_newton_model)

    def values(z: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return ask_all(budgeted, problem, values_of, 1.0, z, rows)["objective"]

    def value_and_grad(z: np.ndarray, rows: np.ndarray) -> ValueAndGrad:
        return ValueAndGrad(**ask_all(budgeted, problem, reverse, cost_model.gradient, z, rows))

    def gauss_newton_model(z: np.ndarray, rows: np.ndarray) -> GaussNewtonModel:
        return GaussNewtonModel(
            **ask_all(budgeted, problem, forward, cost_model.curvature, z, rows)
        )

    return Oracle(values, value_and_grad, gauss_newton_model)
