"""Trade-offs of contour error, energy and chattering: many weights tuned in one batch.

Every weighting of the three figures is a start of one search, all in the same batch, from the tuned
gains. What ends up beaten by another is told apart from the front; the figures are the means over
the training runs, of the exact model.
"""

from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxstage.metrics.table import key
from jaxstage.model.settings import nearest_name
from tuning.tuner.configuration import TuningPlan
from tuning.tuner.problem.objective import RISKS, Term
from tuning.tuner.problem.problem import Evaluation, Problem, evaluate, make_problem, with_weights
from tuning.tuner.problem.training_metrics import available_columns
from tuning.tuner.search.optimise import METHODS, tune
from tuning.tuner.search.pareto_front import hypervolume, knee, non_dominated, weights
from tuning.tuner.session import TuningResult, log_folder

#: parts of an edge of the weights: 10 weightings of three figures
STEPS = 3
#: least weight of a figure: nobody wants the last bit of one at any price of the others
LEAST = 0.02
#: the reference of the hypervolume is so much worse than the worst point
BEYOND = 1.1


class Front(NamedTuple):
    """Trade-offs. columns: (m,) names. weights: (k, m), row 0 NaN: the tuned gains. points: (k, m),
    mean figures. kept: (k,) bool, on the front. suggested: row. before: (m,). volume: share of the
    box from the best of each figure to the reference that the front beats. gains: of each row.
    units: spent. note: why CMA-ES searched in place of the method that was asked for, or empty."""

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
    """Contour error (of one axis following error), energy, chattering. Raises ValueError where the
    loop lacks one."""
    known = available_columns(plan.case)
    unit = plan.case.loop.plant.command_unit
    error = "contour_rms_um" if "contour_rms_um" in known else "following_rms_um"
    wanted = (error, "energy_J", key("chattering", unit))
    for name in wanted:
        if name not in known:
            raise ValueError(f"--pareto: the loop has no {name}{nearest_name(name, known)}")
    return wanted


def pareto(outcome: TuningResult, budget: float, folder: Path | None) -> Front:
    """The trade-offs around tuned gains. budget: units for all weightings together."""
    plan, problem, tuned = outcome.plan, outcome.exact, outcome.tuned
    columns = trade_off_columns(plan)
    every = _problem(plan, problem, columns)
    shares = weights(len(columns), STEPS)
    shares = LEAST + (1 - len(columns) * LEAST) * shares
    begun = np.repeat(outcome.chosen.z[None], len(shares), axis=0)
    made = METHODS.get(plan.table["method"], METHODS["lm" if tuned.n <= 30 else "lbfgs"])
    found = tune(
        with_weights(every, shares),
        made(),
        begun,
        plan.table["seed"],
        budget,
        log_folder=log_folder(folder, "pareto"),
    )
    z = np.stack([outcome.chosen.z, *(start.z for start in found.starts)])
    points = _means(evaluate(every, z), columns)
    before = _means(evaluate(every, problem.space.start()[None]), columns)[0]
    kept = non_dominated(points)
    front = np.flatnonzero(kept)
    every_kept = np.vstack([points[kept], before])
    ideal, reference = every_kept.min(axis=0), BEYOND * every_kept.max(axis=0)
    return Front(
        columns=columns,
        weights=np.vstack([np.full(len(columns), np.nan), shares]),
        points=points,
        kept=kept,
        suggested=int(front[knee(points[kept])]),
        before=before,
        reference=reference,
        volume=hypervolume(points, reference) / float(np.prod(reference - ideal)),
        gains=tuple(problem.space.gains_of(jnp.asarray(one)) for one in z),
        simulations=found.simulations,
        note=found.note,
    )


def _problem(plan: TuningPlan, problem: Problem, columns: tuple[str, ...]) -> Problem:
    terms = [Term(name) for name in columns]
    risk = RISKS[plan.table["risk"]]()
    return make_problem(problem.space, problem.groups, terms, problem.goals, risk)


def _means(found: Evaluation, columns: tuple[str, ...]) -> np.ndarray:
    """(m, columns) means over the runs; NaN where one was lost."""
    return np.stack([found.columns[name].mean(axis=1) for name in columns], axis=1)
