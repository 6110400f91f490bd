"""Random search around the start: the baseline that any method must beat."""

import functools
from typing import NamedTuple

import numpy as np

from tuning.tuner.search.cost_model import CostModel
from tuning.tuner.search.method import Method, Oracle


class RandomState(NamedTuple):
    """The best of the points drawn so far.

    Attributes:
        starts: centres of the draws, (k, n).
        seed: of the draws.
        drawn: points of each start so far.
        z: best points, (k, n).
        value: J there, (k,).
        gradient_norm: NaN, (k,).
        done: never, (k,).
    """

    starts: np.ndarray
    seed: int
    drawn: int
    z: np.ndarray
    value: np.ndarray
    gradient_norm: np.ndarray
    done: np.ndarray


def _begin(oracle: Oracle, starts: np.ndarray, seed: int) -> RandomState:
    k = len(starts)
    values = oracle.values(starts, np.arange(k))
    return RandomState(starts, seed, 0, starts, values, np.full(k, np.nan), np.zeros(k, bool))


def _step(sigma: float, batch: int, oracle: Oracle, state: RandomState) -> RandomState:
    k, n = state.starts.shape
    source = np.random.default_rng((state.seed, state.drawn))
    points = state.starts[:, None] + sigma * source.standard_normal((k, batch, n))
    values = oracle.values(points.reshape(-1, n), np.repeat(np.arange(k), batch)).reshape(k, batch)
    best, each = np.argmin(values, axis=1), np.arange(k)
    better = values[each, best] < state.value
    return state._replace(
        drawn=state.drawn + batch,
        z=np.where(better[:, None], points[each, best], state.z),
        value=np.where(better, values[each, best], state.value),
    )


def _first(batch: int, cost_model: CostModel, n: int) -> float:
    return 1 + batch


@functools.cache
def random_search(sigma: float = 1.0, batch: int = 16) -> Method:
    """Normally distributed points around every start.

    Args:
        sigma: standard deviation, in z.
        batch: points of a step.
    """
    first, step = functools.partial(_first, batch), functools.partial(_step, sigma, batch)
    return Method(name="random", needs="", first=first, begin=_begin, step=step)
