"""The same problem by other methods at equal cost: best objective against units spent."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxstage.model.settings import nearest_name
from tuning.tuner.search.optimise import METHODS, SearchResult, tune
from tuning.tuner.session import TuningResult, log_folder


class ConvergenceCurve(NamedTuple):
    """How the best objective fell. method: its name. units, best, gradient: (k,)."""

    method: str
    simulations: np.ndarray
    best: np.ndarray
    gradient: np.ndarray

    def at(self, simulations: float) -> float:
        """The best objective after so many units: 1 and what the first step gave are the start."""
        reached = self.best[self.simulations <= simulations]
        return float(reached[-1]) if len(reached) else float(self.best[0])

    def reached(self, objective: float) -> float | None:
        """Units after which the objective was reached, None where it was not."""
        there = self.simulations[self.best <= objective]
        return float(there[0]) if len(there) else None


def convergence_curve(tuned: SearchResult) -> ConvergenceCurve:
    """The course of a tuning; it begins at the gains before."""
    steps = tuned.history
    return ConvergenceCurve(
        method=tuned.method,
        simulations=np.array([0.0, *(step.simulations for step in steps)]),
        best=np.minimum.accumulate([tuned.before, *(step.best for step in steps)]),
        gradient=np.array([np.nan, *(step.gradient_norm for step in steps)]),
    )


def parse_methods(text: str) -> tuple[str, ...]:
    """The methods of ``cma,random``. Raises ValueError for an unknown one or one named twice."""
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in METHODS:
            hint = nearest_name(name, METHODS)
            raise ValueError(f"--baseline {name}{hint}: must be one of {', '.join(METHODS)}")
    if len(set(names)) < len(names):
        raise ValueError(f"--baseline {text}: a method stands twice")
    return tuple(names)


def run_baselines(
    outcome: TuningResult, methods: Sequence[str], folder: Path | None
) -> tuple[ConvergenceCurve, ...]:
    """Other methods on the first round's problem, from the same starts and seed, each with the
    units that its first round spent."""
    first, table = outcome.rounds[0].tuned, outcome.plan.table
    found = []
    for name in methods:
        tuned = tune(
            outcome.problem,
            METHODS[name](),
            table["starts"],
            table["seed"],
            first.simulations,
            log_folder=log_folder(folder, f"baseline-{name}"),
        )
        found.append(convergence_curve(tuned))
    return tuple(found)
