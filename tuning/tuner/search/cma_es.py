"""CMA-ES (covariance matrix adaptation evolution strategy): without gradients.

It is the baseline, the fallback where gradients cannot be trusted, and the search after a descent.
Source: Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772, as in the package cmaes.
"""

import copy
import functools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tuning.tuner.search.cost_model import CostModel
from tuning.tuner.search.method import Method, Oracle

if TYPE_CHECKING:
    from cmaes import CMA


class CmaState(NamedTuple):
    """One evolution strategy a start.

    Attributes:
        optimisers: mean, covariance and step size of each start, never changed in place.
        seed: of all random numbers.
        z: best points so far, (k, n).
        value: J there, (k,).
        gradient_norm: NaN, (k,).
        done: where a strategy has converged, (k,).
    """

    optimisers: tuple["CMA", ...]
    seed: int
    z: np.ndarray
    value: np.ndarray
    gradient_norm: np.ndarray
    done: np.ndarray


def _begin(
    sigma: float, population: int | None, oracle: Oracle, starts: np.ndarray, seed: int
) -> CmaState:
    from cmaes import CMA

    optimisers = tuple(
        CMA(mean=z.copy(), sigma=sigma, seed=seed + k, population_size=population)
        for k, z in enumerate(starts)
    )
    unknown = np.full(len(starts), np.nan)
    values = oracle.values(starts, np.arange(len(starts)))
    return CmaState(optimisers, seed, starts, values, unknown, np.zeros(len(starts), bool))


def _step(oracle: Oracle, state: CmaState) -> CmaState:
    """One generation of every start that has not converged."""
    optimisers = copy.deepcopy(state.optimisers)
    active = np.flatnonzero(~state.done)
    for k in active:  # a copy begins with random numbers of its own, which no seed governs
        source = np.random.SeedSequence((state.seed, int(k), optimisers[k].generation))
        optimisers[k].reseed_rng(int(source.generate_state(1)[0]))
    points = {
        int(k): [optimisers[k].ask() for _ in range(optimisers[k].population_size)] for k in active
    }
    rows = np.concatenate([np.full(len(p), k) for k, p in points.items()])
    values = oracle.values(np.concatenate([np.array(p) for p in points.values()]), rows)
    z, best, done = state.z.copy(), state.value.copy(), state.done.copy()
    for k, population in points.items():
        own = values[rows == k]
        optimisers[k].tell([(x, float(v)) for x, v in zip(population, own, strict=True)])
        first = int(np.argmin(own))
        if own[first] < best[k]:
            z[k], best[k] = population[first], own[first]
        done[k] = optimisers[k].should_stop()
    return state._replace(optimisers=optimisers, z=z, value=best, done=done)


def _first(population: int | None, cost_model: CostModel, n: int) -> float:
    return 1 + (population or 4 + math.floor(3 * math.log(n)))


@functools.cache
def cma_es(sigma: float = 0.5, population: int | None = None) -> Method:
    """CMA-ES from every start.

    Args:
        sigma: standard deviation of the first population, in z.
        population: points of a generation; None is 4 + 3 ln n.
    """
    begin = functools.partial(_begin, sigma, population)
    first = functools.partial(_first, population)
    return Method(name="cma", needs="", first=first, begin=begin, step=_step)
