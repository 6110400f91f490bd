"""Trade-offs of contour error, energy and chattering: a Pareto front by weighted sums.

Every weighting of the three metrics is a start of one search, all in the same batch, from the tuned
gains. What ends up dominated by another is told apart from the front; the metrics are the means
over the training runs, of the exact model.
"""

from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxstage.metrics.table import key
from jaxstage.model.settings import nearest_name
from tuning.tuner.configuration import TuningPlan
from tuning.tuner.problem.objective import Term
from tuning.tuner.problem.problem import Evaluation, evaluate, make_problem, with_weights
from tuning.tuner.problem.training_metrics import available_columns
from tuning.tuner.search.optimise import FEW, METHODS, tune
from tuning.tuner.search.pareto_front import hypervolume, knee, non_dominated, weights
from tuning.tuner.session import TuningResult, log_folder

#: parts of an edge of the weights: 10 weightings of three metrics
STEPS = 3
#: least weight of a metric: nobody wants the last bit of one at any price of the others
LEAST = 0.02
#: the reference of the hypervolume is so much worse than the worst point
BEYOND = 1.1


class Front(NamedTuple):
    """Trade-offs of m metrics, one row a weighting; row 0 is the tuned gains.

    Attributes:
        columns: names of the metrics, (m,).
        weights: of the metrics, NaN in row 0, (k, m).
        points: mean metrics over the training runs, (k, m).
        kept: which are on the front, (k,) bool.
        suggested: row of the knee.
        before: metrics of the gains before, (m,).
        reference: of the hypervolume, (m,).
        volume: share that the front dominates of the box from the ideal point to the reference.
        gains: of each row.
        simulations: spent.
        note: why CMA-ES searched in place of the method that was asked for, or empty.
    """

    columns: tuple[str, ...]
    weights: np.ndarray
    points: np.ndarray
    kept: np.ndarray
    suggested: int
    before: np.ndarray
    reference: np.ndarray
    volume: float
    gains: tuple[Any, ...]
    simulations: float
    note: str


def trade_off_columns(plan: TuningPlan) -> tuple[str, ...]:
    """Contour error (of one axis following error), energy, chattering.

    Raises:
        ValueError: the loop lacks one.
    """
    known = available_columns(plan.case)
    unit = plan.case.loop.plant.command_unit
    error = "contour_rms_um" if "contour_rms_um" in known else "following_rms_um"
    columns = (error, "energy_J", key("chattering", unit))
    for name in columns:
        if name not in known:
            raise ValueError(f"--pareto: the loop has no {name}{nearest_name(name, known)}")
    return columns


def pareto(outcome: TuningResult, budget: float, folder: Path | None) -> Front:
    """The trade-offs around tuned gains.

    Args:
        outcome: of the tuning.
        budget: simulations of all weightings together.
        folder: keeps every evaluation.
    """
    plan, problem, tuned = outcome.plan, outcome.exact, outcome.tuned
    columns = trade_off_columns(plan)
    objective = problem.objective._replace(terms=tuple(map(Term, columns)))
    every = make_problem(problem.space, problem.groups, objective)
    shares = LEAST + (1 - len(columns) * LEAST) * weights(len(columns), STEPS)
    begun = np.repeat(outcome.chosen.z[None], len(shares), axis=0)
    make = METHODS.get(plan.table["method"], METHODS["lm" if tuned.n <= FEW else "lbfgs"])
    common = (begun, plan.table["seed"], budget)
    log = log_folder(folder, "pareto")
    search = tune(with_weights(every, shares), make(), *common, log_folder=log)
    z = np.stack([outcome.chosen.z, *(start.z for start in search.starts)])
    points = _means(evaluate(every, z), columns)
    before = _means(evaluate(every, problem.space.start()[None]), columns)[0]
    kept = non_dominated(points)
    shown = np.vstack([points[kept], before])
    ideal, reference = shown.min(axis=0), BEYOND * shown.max(axis=0)
    return Front(
        columns=columns,
        weights=np.vstack([np.full(len(columns), np.nan), shares]),
        points=points,
        kept=kept,
        suggested=int(np.flatnonzero(kept)[knee(points[kept])]),
        before=before,
        reference=reference,
        volume=hypervolume(points, reference) / float(np.prod(reference - ideal)),
        gains=tuple(problem.space.gains_of(jnp.asarray(one)) for one in z),
        simulations=search.simulations,
        note=search.note,
    )


def _means(evaluation: Evaluation, columns: tuple[str, ...]) -> np.ndarray:
    """(m, columns) means over the runs; NaN where one was lost."""
    return np.stack([evaluation.columns[name].mean(axis=1) for name in columns], axis=1)
