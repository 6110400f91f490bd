"""First-order methods of optax, for those who know the step that suits their loop."""

import functools
from typing import Any, NamedTuple

import numpy as np
import optax

from tuning.tuner.search.cost_model import CostModel
from tuning.tuner.search.method import Method, Oracle


class FirstOrderState(NamedTuple):
    """memory: of the optimiser. point: where it is; z, value: the best so far."""

    memory: Any
    point: np.ndarray
    gradient: np.ndarray
    z: np.ndarray
    value: np.ndarray
    gradient_norm: np.ndarray
    done: np.ndarray


def _sound(gradient: np.ndarray) -> np.ndarray:
    """The gradient, 0 for a start where it is not finite."""
    finite = np.isfinite(gradient).all(axis=1, keepdims=True)
    return np.where(finite, gradient, 0.0)


def _begin(
    optimiser: optax.GradientTransformation, oracle: Oracle, starts: np.ndarray, seed: int
) -> FirstOrderState:
    found = oracle.value_and_grad(starts, np.arange(len(starts)))
    norm = np.linalg.norm(found.gradient, axis=1)
    return FirstOrderState(
        memory=optimiser.init(starts),
        point=starts,
        gradient=_sound(found.gradient),
        z=starts,
        value=found.objective,
        gradient_norm=norm,
        done=np.zeros(len(starts), bool),
    )


def _step(
    optimiser: optax.GradientTransformation, oracle: Oracle, state: FirstOrderState
) -> FirstOrderState:
    moves, memory = optimiser.update(state.gradient, state.memory, state.point)
    point = np.asarray(optax.apply_updates(state.point, moves), float)
    found = oracle.value_and_grad(point, np.arange(len(point)))
    better = found.objective < state.value
    return FirstOrderState(
        memory=memory,
        point=point,
        gradient=_sound(found.gradient),
        z=np.where(better[:, None], point, state.z),
        value=np.where(better, found.objective, state.value),
        gradient_norm=np.linalg.norm(found.gradient, axis=1),
        done=state.done,
    )


def _first(cost_model: CostModel, n: int) -> float:
    return 2 * cost_model.gradient


@functools.cache
def first_order(make: Any = optax.adam, rate: float = 0.1) -> Method:
    """make(rate) -> an optimiser of optax."""
    optimiser = make(rate)
    return Method(
        name=f"{make.__name__}",
        needs="slopes",
        first=_first,
        begin=functools.partial(_begin, optimiser),
        step=functools.partial(_step, optimiser),
    )
