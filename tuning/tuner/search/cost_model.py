"""Cost model: what derivatives cost, in simulations of the whole training set.

One simulation is one candidate of a full batch of plain evaluations. A gradient (reverse mode) and
a Jacobian (forward mode) cost the time that their compiled program takes, over that of a
simulation: measured once, without compilation, the fastest of `REPEATS` calls each, in turn. On a
CPU it is processor time, which other programs on the machine disturb less than the clock.
"""

import math
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from tuning.tuner.problem.problem import Problem, evaluate, gauss_newton_model, value_and_grad

REPEATS = 3


class CostModel(NamedTuple):
    """Simulations that derivatives of one candidate cost; NaN for those that nobody needs.

    Attributes:
        gradient: reverse-mode gradient, in simulations.
        gauss_newton: forward-mode Jacobian, in simulations.
        simulation_s: one simulation, in seconds of the same clock.
    """

    gradient: float
    gauss_newton: float
    simulation_s: float


def measure_cost_model(problem: Problem, needs: str, starts: int = 1) -> CostModel:
    """Time the compiled programs at the gains before.

    Args:
        problem: whose programs are timed.
        needs: the derivatives that a method asks for, see `method.Derivatives`.
        starts: candidates of one call.
    """
    z = problem.space.start()[None]
    clock = time.process_time if jax.default_backend() == "cpu" else time.perf_counter
    full, many = np.repeat(z, problem.width, axis=0), np.repeat(z, starts, axis=0)
    calls: dict[str, Callable[[], object]] = {"": lambda: evaluate(problem, full)}
    if needs == "gradient":
        calls[needs] = lambda: value_and_grad(problem, many)
    if needs == "gauss_newton":
        calls[needs] = lambda: gauss_newton_model(problem, many)
    for call in calls.values():
        call()
    fastest = dict.fromkeys(calls, math.inf)
    for _ in range(REPEATS):
        for name, call in calls.items():
            begin = clock()
            call()
            fastest[name] = min(fastest[name], clock() - begin)
    simulation = fastest[""] / problem.width

    def cost(name: str) -> float:
        return round(fastest[name] / starts / simulation, 1) if name in fastest else math.nan

    return CostModel(cost("gradient"), cost("gauss_newton"), simulation)
