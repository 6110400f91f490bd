"""What gradients cost, in units of one evaluation of the objective in all training runs.

One unit is one candidate of a full batch of plain evaluations. A gradient (reverse mode) and a
Jacobian (forward mode) are charged with the time that the compiled program takes for it, over that
of a unit: measured once, without compilation, the fastest of `REPEATS` calls each, taken in turn.
On a CPU it is processor time, which other programs on the machine disturb less than the clock.
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
    """Units of one gradient and one Jacobian of one candidate; NaN where it is not needed. unit_s:
    seconds of a unit, by the same clock."""

    gradient: float
    curvature: float
    simulation_s: float


def measure_cost_model(problem: Problem, needs: str, starts: int = 1) -> CostModel:
    """The prices of what a method needs beside values: "", "slopes" or "curvatures".

    starts: candidates of one call.
    """
    z = problem.space.start()
    clock = time.process_time if jax.default_backend() == "cpu" else time.perf_counter
    asked: dict[str, Callable[[], object]] = {
        "": lambda: evaluate(problem, np.repeat(z[None], problem.width, axis=0))
    }
    many = np.repeat(z[None], starts, axis=0)
    if needs == "slopes":
        asked[needs] = lambda: value_and_grad(problem, many)
    if needs == "curvatures":
        asked[needs] = lambda: gauss_newton_model(problem, many)
    for ask in asked.values():
        ask()
    best = dict.fromkeys(asked, math.inf)
    for _ in range(REPEATS):
        for name, ask in asked.items():
            begin = clock()
            ask()
            best[name] = min(best[name], clock() - begin)
    unit = best[""] / problem.width

    def price(name: str) -> float:
        return round(best[name] / starts / unit, 1) if name in best else math.nan

    return CostModel(price("slopes"), price("curvatures"), unit)
