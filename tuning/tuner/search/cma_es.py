"""CMA-ES: without gradients, the baseline and the fallback.

Source: Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772, as in the package cmaes.
"""

import copy
import functools
import math
from typing import Any, NamedTuple

import numpy as np

from tuning.tuner.search.cost_model import CostModel
from tuning.tuner.search.method import Method, Oracle


class CmaState(NamedTuple):
    """optimisers: one a start, never changed in place. z, value: the best so far."""

    optimisers: tuple[Any, ...]
    seed: int
    z: np.ndarray
    value: np.ndarray
    gradient_norm: np.ndarray
    done: np.ndarray


def _begin(
    sigma: float, population: int | None, oracle: Oracle, starts: np.ndarray, seed: int
) -> CmaState:
    from cmaes import CMA

    made = tuple(
        CMA(mean=z.copy(), sigma=sigma, seed=seed + k, population_size=population)
        for k, z in enumerate(starts)
    )
    unknown = np.full(len(starts), np.nan)
    values = oracle.values(starts, np.arange(len(starts)))
    return CmaState(made, seed, starts, values, unknown, np.zeros(len(starts), bool))


def _step(oracle: Oracle, state: CmaState) -> CmaState:
    made = copy.deepcopy(state.optimisers)
    active = np.flatnonzero(~state.done)
    for k in active:  # a copy begins with random numbers of its own, which no seed governs
        source = np.random.SeedSequence((state.seed, int(k), made[k].generation))
        made[k].reseed_rng(int(source.generate_state(1)[0]))
    points = {int(k): [made[k].ask() for _ in range(made[k].population_size)] for k in active}
    rows = np.concatenate([np.full(len(p), k) for k, p in points.items()])
    values = oracle.values(np.concatenate([np.array(p) for p in points.values()]), rows)
    z, best, done = state.z.copy(), state.value.copy(), state.done.copy()
    for k, asked in points.items():
        own = values[rows == k]
        made[k].tell([(x, float(v)) for x, v in zip(asked, own, strict=True)])
        first = int(np.argmin(own))
        if own[first] < best[k]:
            z[k], best[k] = asked[first], own[first]
        done[k] = made[k].should_stop()
    return state._replace(optimisers=made, z=z, value=best, done=done)


def _first(population: int | None, cost_model: CostModel, n: int) -> float:
    return 1 + (population or 4 + math.floor(3 * math.log(n)))


@functools.cache
def cma_es(sigma: float = 0.5, population: int | None = None) -> Method:
    """sigma: standard deviation of the first population, in z; population: None is 4 + 3 ln n."""
    begin = functools.partial(_begin, sigma, population)
    first = functools.partial(_first, population)
    return Method(name="cma", needs="", first=first, begin=begin, step=_step)
