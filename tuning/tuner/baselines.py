"""Baselines: the same problem by other methods at equal cost, as convergence curves."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxstage.model.settings import nearest_name
from tuning.tuner.search.optimise import METHODS, SearchResult, tune
from tuning.tuner.session import TuningResult, log_folder


class ConvergenceCurve(NamedTuple):
    """Best objective against cost.

    Attributes:
        method: its name.
        simulations: spent, (k,).
        best: J of the best gains so far, (k,).
        gradient: norm of the gradient, NaN where unknown, (k,).
        violation: largest miss of a goal there, NaN where unknown, (k,).
    """

    method: str
    simulations: np.ndarray
    best: np.ndarray
    gradient: np.ndarray
    violation: np.ndarray

    def at(self, simulations: float) -> float:
        """Best J after so many simulations; before the first step, of the gains before."""
        reached = self.best[self.simulations <= simulations]
        return float(reached[-1]) if len(reached) else float(self.best[0])

    def reached(self, objective: float) -> float | None:
        """Simulations after which J was reached, None where it was not."""
        there = self.simulations[self.best <= objective]
        return float(there[0]) if len(there) else None


def convergence_curve(result: SearchResult) -> ConvergenceCurve:
    """The curve of a search; it begins at the gains before."""
    steps = result.history
    return ConvergenceCurve(
        method=result.method,
        simulations=np.array([0.0, *(step.simulations for step in steps)]),
        best=np.array([result.before, *(step.best for step in steps)]),
        gradient=np.array([np.nan, *(step.gradient_norm for step in steps)]),
        violation=np.array([np.nan, *(step.violation for step in steps)]),
    )


def parse_methods(text: str) -> tuple[str, ...]:
    """The methods of ``cma,random``.

    Raises:
        ValueError: one is unknown, or named twice.
    """
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
    """Other methods on the first round's problem, from the same starts and seed.

    Args:
        outcome: of the tuning.
        methods: names; each may spend the simulations of the first round.
        folder: keeps every evaluation.
    """
    first, table = outcome.rounds[0].tuned, outcome.plan.table
    curves = []
    for name in methods:
        log = log_folder(folder, f"baseline-{name}")
        common = (table["starts"], table["seed"], first.simulations)
        curves.append(
            convergence_curve(tune(outcome.problem, METHODS[name](), *common, log_folder=log))
        )
    return tuple(curves)
