"""L-BFGS (limited-memory quasi-Newton) with a batched line search: for many parameters.

    p = -H g,  H from the last pairs (s, y) of moves and gradient changes     (two-loop recursion)
    J(z + a p) <= J(z) + ENOUGH a g^T p                                       (Armijo condition)

The gradient comes from reverse mode. The full step is tried with its gradient at once, as it is
usually taken; else shorter ones are tried in one batch of plain evaluations. A trial step that is
lost or not finite is only a bad one.
Source of the recursion: Nocedal, Math. Comp. 35 (1980).
"""

import copy
import functools
from typing import NamedTuple

import numpy as np

from tuning.tuner.search.cost_model import CostModel
from tuning.tuner.search.method import Method, Oracle

#: what a step must give of the first-order promise (Armijo)
ENOUGH = 1e-4
#: lengths of the first steps along the gradient, in z; fractions of a later step that failed
FIRST = (2.0, 0.7, 0.2, 0.05)
FRACTIONS = (0.5, 0.2, 0.05, 0.01)
#: below this relative gain over `PATIENCE` steps a start is at its end
SMALLEST_GAIN = 1e-5
PATIENCE = 5


class LbfgsState(NamedTuple):
    """Quasi-Newton iterates.

    Attributes:
        z: points reached, (k, n).
        value: J there, (k,).
        gradient: dJ/dz there, (k, n).
        pairs: of each start (moves s, gradient changes y), (pairs, n) each, newest last.
        recent: J of the last `PATIENCE` steps, (k, PATIENCE).
        gradient_norm: (k,).
        done: (k,).
    """

    z: np.ndarray
    value: np.ndarray
    gradient: np.ndarray
    pairs: tuple[tuple[np.ndarray, np.ndarray], ...]
    recent: np.ndarray
    gradient_norm: np.ndarray
    done: np.ndarray


class Config(NamedTuple):
    """memory: pairs that are kept. radius: longest step, in z."""

    memory: int
    radius: float


def direction(gradient: np.ndarray, moves: np.ndarray, changes: np.ndarray) -> np.ndarray:
    """Quasi-Newton direction -H g by the two-loop recursion.

    Args:
        gradient: g, (n,).
        moves: s of each pair, (pairs, n), newest last.
        changes: y of each pair, (pairs, n).
    """
    q = gradient.copy()
    factors = []
    for s, y in zip(moves[::-1], changes[::-1], strict=True):
        a = (s @ q) / (s @ y)
        q = q - a * y
        factors.append(a)
    if len(moves):
        q = q * (moves[-1] @ changes[-1]) / (changes[-1] @ changes[-1])
    for s, y, a in zip(moves, changes, factors[::-1], strict=True):
        q = q + s * (a - (y @ q) / (s @ y))
    return -q


def _begin(oracle: Oracle, starts: np.ndarray, seed: int) -> LbfgsState:
    here = oracle.value_and_grad(starts, np.arange(len(starts)))
    norm = np.linalg.norm(here.gradient, axis=1)
    none = np.zeros((0, starts.shape[1]))
    pairs, recent = ((none, none),) * len(starts), np.full((len(starts), PATIENCE), np.inf)
    done = ~np.isfinite(norm) | (norm == 0)
    return LbfgsState(starts, here.objective, here.gradient, pairs, recent, norm, done)


def _step(config: Config, oracle: Oracle, state: LbfgsState) -> LbfgsState:
    """Full steps first; shorter ones, in one batch, for the starts whose full step was refused."""
    active = np.flatnonzero(~state.done)
    steps = {k: _full_step(state, k, config.radius) for k in map(int, active)}
    remembering = {k: step for k, step in steps.items() if len(state.pairs[k][0])}
    state, taken = _try(config, oracle, state, remembering)
    left = [k for k in steps if not taken.get(k, False)]
    if not left:
        return state
    state, taken = _try(config, oracle, state, _shorter(oracle, state, {k: steps[k] for k in left}))
    for k in left:
        if not taken.get(k, False):
            state = _forget(state, k)
    return state


def _full_step(state: LbfgsState, k: int, radius: float) -> np.ndarray:
    """The quasi-Newton step of a start, at most ``radius`` long."""
    p = direction(state.gradient[k], *state.pairs[k])
    if not state.gradient[k] @ p < 0:
        p = -state.gradient[k]
    length = float(np.linalg.norm(p))
    return p if length <= radius else p * (radius / length)


def _shorter(
    oracle: Oracle, state: LbfgsState, steps: dict[int, np.ndarray]
) -> dict[int, np.ndarray]:
    """Of each start the best fraction of its step that meets the Armijo condition, if any."""
    scaled = {k: _fractions(state, k, step)[:, None] * step for k, step in steps.items()}
    points = np.concatenate([state.z[k] + rows for k, rows in scaled.items()])
    values = oracle.values(points, np.repeat(list(steps), len(FRACTIONS))).reshape(len(steps), -1)
    best: dict[int, np.ndarray] = {}
    for k, row in zip(steps, values, strict=True):
        slope = scaled[k] @ state.gradient[k]
        good = np.isfinite(row) & (row <= state.value[k] + ENOUGH * slope)
        if good.any():
            best[k] = scaled[k][np.argmin(np.where(good, row, np.inf))]
    return best


def _fractions(state: LbfgsState, k: int, step: np.ndarray) -> np.ndarray:
    """What of the step is tried instead: at the start, fixed lengths."""
    if len(state.pairs[k][0]):
        return np.array(FRACTIONS)
    return np.array(FIRST) / np.linalg.norm(step)


def _try(
    config: Config, oracle: Oracle, state: LbfgsState, steps: dict[int, np.ndarray]
) -> tuple[LbfgsState, dict[int, bool]]:
    """Steps of some starts, taken where they help and the gradient is finite, and which were."""
    taken: dict[int, bool] = {}
    if not steps:
        return state, taken
    rows = np.array(list(steps), int)
    trial = oracle.value_and_grad(state.z[rows] + np.array(list(steps.values())), rows)
    for i, (k, step) in enumerate(steps.items()):
        limit = state.value[k] + ENOUGH * (state.gradient[k] @ step)
        finite = np.isfinite(trial.objective[i]) and np.isfinite(trial.gradient[i]).all()
        taken[k] = bool(finite and trial.objective[i] <= limit)
        if taken[k]:
            reached = float(trial.objective[i]), trial.gradient[i]
            state = _moved(config.memory, state, k, step, reached)
    return state, taken


def _moved(
    memory: int, state: LbfgsState, k: int, p: np.ndarray, reached: tuple[float, np.ndarray]
) -> LbfgsState:
    """The state after step p of start k. reached: J and dJ/dz at its end."""
    value, gradient = reached
    moves, changes = state.pairs[k]
    y = gradient - state.gradient[k]
    if p @ y > 1e-10 * np.linalg.norm(p) * np.linalg.norm(y):
        moves = np.concatenate([moves, p[None]])[-memory:]
        changes = np.concatenate([changes, y[None]])[-memory:]
    pairs = tuple((moves, changes) if i == k else pair for i, pair in enumerate(state.pairs))
    new = copy.deepcopy(state)._replace(pairs=pairs)
    new.z[k], new.value[k], new.gradient[k] = state.z[k] + p, value, gradient
    new.gradient_norm[k] = np.linalg.norm(gradient)
    new.done[k] = new.recent[k, 0] - value < SMALLEST_GAIN * abs(value)
    new.recent[k] = np.append(new.recent[k, 1:], value)
    return new


def _forget(state: LbfgsState, k: int) -> LbfgsState:
    """No step helped: forget the pairs and try along the gradient; without pairs it is the end."""
    none = np.zeros((0, state.z.shape[1]))
    pairs = tuple((none, none) if i == k else pair for i, pair in enumerate(state.pairs))
    done = state.done.copy()
    done[k] = not len(state.pairs[k][0])
    return state._replace(pairs=pairs, done=done)


def _first(cost_model: CostModel, n: int) -> float:
    return cost_model.gradient + len(FIRST)


@functools.cache
def lbfgs(memory: int = 20, radius: float = 2.0) -> Method:
    """L-BFGS from every start.

    Args:
        memory: pairs that are kept.
        radius: longest step, in z.
    """
    step = functools.partial(_step, Config(memory, radius))
    return Method(name="lbfgs", needs="gradient", first=_first, begin=_begin, step=step)
