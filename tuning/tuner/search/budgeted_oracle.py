"""Budgeted oracle: answers are asked, charged and logged once, and never beyond the budget.

It remembers what a search has asked so far: the answers, what they cost, and the best candidate of
each start.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tuning.tuner.problem import problem as problems
from tuning.tuner.problem.problem import GaussNewtonModel, Problem, ValueAndGrad
from tuning.tuner.search.cost_model import CostModel
from tuning.tuner.search.evaluation_log import Answer, digest, logged
from tuning.tuner.search.method import Oracle

#: by which a sum of simulations may be off
ROUNDING = 1e-6
#: questions logged before those of the search: what is tuned, and the cost model
FIRST = 2


class Best(NamedTuple):
    """The best candidate of a start: z (n,), J there, and the largest violation of a goal."""

    z: np.ndarray
    objective: float
    violation: float

    def key(self) -> tuple[float, float]:
        """Smaller is better: first what is missed, then J."""
        return max(self.violation, 0.0), self.objective


class BeyondBudget(Exception):
    """A question costs more than what is left."""


@dataclass
class BudgetedOracle:
    """What a search has asked so far; it fills while the search runs.

    Attributes:
        budget: simulations that may be spent.
        folder: of the evaluation log; None keeps nothing.
        cost_model: what derivatives cost.
        starts: how many starts move in one call at most.
        costs: (simulations, seconds) of every question.
        best: start -> its best candidate.
        known: question -> answer, of this process.
    """

    budget: float
    folder: Path | None
    cost_model: CostModel
    starts: int
    costs: list[tuple[float, float]] = field(default_factory=list)
    best: dict[int, Best] = field(default_factory=dict)
    known: dict[str, Answer] = field(default_factory=dict)

    @property
    def simulations(self) -> float:
        """Simulations spent."""
        return sum(simulations for simulations, _ in self.costs)

    @property
    def seconds(self) -> float:
        """Seconds of evaluation, those of an earlier process included."""
        return sum(seconds for _, seconds in self.costs)

    def answer(self, question: str, cost: float, compute: Callable[[], Answer]) -> Answer:
        """The answer to a question, asked and charged only once.

        Args:
            question: its digest.
            cost: simulations that it is charged with.
            compute: gives the answer where it is not known.

        Raises:
            BeyondBudget: the cost is more than what is left.
        """
        if question not in self.known:
            if self.simulations + cost > self.budget + ROUNDING:
                raise BeyondBudget
            index = len(self.costs) + FIRST
            self.known[question], seconds = logged(self.folder, index, question, compute)
            self.costs.append((cost, seconds))
        return self.known[question]

    def _remembered(
        self,
        question: str,
        cost: float,
        z: np.ndarray,
        rows: np.ndarray,
        compute: Callable[[], Answer],
    ) -> Answer:
        """The answer about candidates z (m, n) of starts ``rows``; the best are remembered."""
        answer = self.answer(question, cost, compute)
        for i, row in enumerate(map(int, rows)):
            own = Best(z[i], float(answer["objective"][i]), float(answer["violation"][i]))
            if row not in self.best or own.key() < self.best[row].key():
                self.best[row] = own
        return answer

    def values(self, problem: Problem, z: np.ndarray, rows: np.ndarray) -> Answer:
        """Plain evaluations: objective (m,), violation (m,) and costs of the runs (m, runs)."""

        def compute() -> Answer:
            evaluation = problems.evaluate(problem, z, rows)
            return {k: getattr(evaluation, k) for k in ("objective", "violation", "costs")}

        question = digest("values", problem.penalty, z, rows.astype(np.int64))
        return self._remembered(question, float(len(z)), z, rows, compute)

    def oracle(self, problem: Problem) -> Oracle:
        """The oracle of a problem whose answers are charged, logged and remembered."""
        costs = self.cost_model

        def derivatives(
            of: Callable[..., Any], cost: float, z: np.ndarray, rows: np.ndarray
        ) -> Answer:
            """All starts in one call, so that one program does, however many of them move."""

            def compute() -> Answer:
                full = np.minimum(np.arange(max(self.starts, len(z))), len(z) - 1)
                fields = of(problem, z[full], rows[full])._asdict()
                return {name: x[: len(z)] for name, x in fields.items()}

            question = digest(of.__name__, problem.penalty, z, rows.astype(np.int64))
            return self._remembered(question, len(z) * cost, z, rows, compute)

        def value_and_grad(z: np.ndarray, rows: np.ndarray) -> ValueAndGrad:
            answer = derivatives(problems.value_and_grad, costs.gradient, z, rows)
            return ValueAndGrad(**answer)

        def gauss_newton_model(z: np.ndarray, rows: np.ndarray) -> GaussNewtonModel:
            answer = derivatives(problems.gauss_newton_model, costs.gauss_newton, z, rows)
            return GaussNewtonModel(**answer)

        def values(z: np.ndarray, rows: np.ndarray) -> np.ndarray:
            return self.values(problem, z, rows)["objective"]

        return Oracle(values, value_and_grad, gauss_newton_model)
