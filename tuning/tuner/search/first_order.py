"""First-order methods of optax (Adam, ...), for those who know the step that suits their loop."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import optax

from tuning.tuner.search.cost_model import CostModel
from tuning.tuner.search.method import Method, Oracle


class FirstOrderState(NamedTuple):
    """Iterates of an optax optimiser.

    Attributes:
        memory: of the optimiser, such as moments.
        point: iterates, (k, n).
        gradient: dJ/dz there, 0 where it is not finite, (k, n).
        z: best points so far, (k, n).
        value: J there, (k,).
        gradient_norm: of the iterates, (k,).
        done: never, (k,).
    """

    memory: optax.OptState
    point: np.ndarray
    gradient: np.ndarray
    z: np.ndarray
    value: np.ndarray
    gradient_norm: np.ndarray
    done: np.ndarray


def _finite_or_zero(gradient: np.ndarray) -> np.ndarray:
    """The gradient, 0 for a start where it is not finite."""
    finite = np.isfinite(gradient).all(axis=1, keepdims=True)
    return np.where(finite, gradient, 0.0)


def _begin(
    optimiser: optax.GradientTransformation, oracle: Oracle, starts: np.ndarray, seed: int
) -> FirstOrderState:
    here = oracle.value_and_grad(starts, np.arange(len(starts)))
    norm = np.linalg.norm(here.gradient, axis=1)
    gradient, none = _finite_or_zero(here.gradient), np.zeros(len(starts), bool)
    memory = optimiser.init(starts)
    return FirstOrderState(memory, starts, gradient, starts, here.objective, norm, none)


def _step(
    optimiser: optax.GradientTransformation, oracle: Oracle, state: FirstOrderState
) -> FirstOrderState:
    moves, memory = optimiser.update(state.gradient, state.memory, state.point)
    point = np.asarray(optax.apply_updates(state.point, moves), float)
    here = oracle.value_and_grad(point, np.arange(len(point)))
    better = here.objective < state.value
    return state._replace(
        memory=memory,
        point=point,
        gradient=_finite_or_zero(here.gradient),
        z=np.where(better[:, None], point, state.z),
        value=np.where(better, here.objective, state.value),
        gradient_norm=np.linalg.norm(here.gradient, axis=1),
    )


def _first(cost_model: CostModel, n: int) -> float:
    return 2 * cost_model.gradient


@functools.cache
def first_order(
    make: Callable[[float], optax.GradientTransformation] = optax.adam, rate: float = 0.1
) -> Method:
    """An optimiser of optax from every start.

    Args:
        make: learning rate -> optimiser.
        rate: learning rate, in z.
    """
    optimiser = make(rate)
    begin, step = functools.partial(_begin, optimiser), functools.partial(_step, optimiser)
    return Method(name=make.__name__, needs="gradient", first=_first, begin=begin, step=step)
