"""L-BFGS with a line search of its own: for many parameters.

The gradient comes from reverse mode. A full step is tried with its gradient at once, as it is
usually taken; else shorter ones are tried in one batch of plain evaluations. A trial that is lost
or not finite is only a bad trial.
Source of the recursion: Nocedal, Math. Comp. 35 (1980).
"""

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
    """z, gradient: (k, n); pairs: of each start, newest last, (moves, gradient changes) each
    (pairs, n); recent: values of the last steps, (k, PATIENCE); value, gradient_norm, done: (k,).
    """

    z: np.ndarray
    value: np.ndarray
    gradient: np.ndarray
    pairs: tuple[tuple[np.ndarray, np.ndarray], ...]
    recent: np.ndarray
    gradient_norm: np.ndarray
    done: np.ndarray


def direction(gradient: np.ndarray, moves: np.ndarray, changes: np.ndarray) -> np.ndarray:
    """-H g by the two-loop recursion. moves, changes: (pairs, n), newest last."""
    q = gradient.copy()
    kept = []
    for s, y in zip(moves[::-1], changes[::-1], strict=True):
        a = (s @ q) / (s @ y)
        q = q - a * y
        kept.append(a)
    if len(moves):
        q = q * (moves[-1] @ changes[-1]) / (changes[-1] @ changes[-1])
    for s, y, a in zip(moves, changes, kept[::-1], strict=True):
        q = q + s * (a - (y @ q) / (s @ y))
    return -q


def _begin(oracle: Oracle, starts: np.ndarray, seed: int) -> LbfgsState:
    found = oracle.value_and_grad(starts, np.arange(len(starts)))
    norm = np.linalg.norm(found.gradient, axis=1)
    none = np.zeros((0, starts.shape[1]))
    return LbfgsState(
        z=starts,
        value=found.objective,
        gradient=found.gradient,
        pairs=((none, none),) * len(starts),
        recent=np.full((len(starts), PATIENCE), np.inf),
        gradient_norm=norm,
        done=~np.isfinite(norm) | (norm == 0),
    )


def _step(memory: int, radius: float, oracle: Oracle, state: LbfgsState) -> LbfgsState:
    active = np.flatnonzero(~state.done)
    steps = {k: _direction(state, k, radius) for k in map(int, active)}
    full = np.array([k for k in steps if len(state.pairs[k][0])], int)
    taken: dict[int, bool] = {}
    if len(full):
        state, taken = _tried(memory, oracle, state, full, np.array([steps[k] for k in full]))
    left = [k for k in steps if not taken.get(k, False)]
    if not left:
        return state
    scaled = {k: _fractions(state, k, steps[k])[:, None] * steps[k] for k in left}
    points = np.concatenate([state.z[k] + scaled[k] for k in left])
    values = oracle.values(points, np.repeat(left, len(FRACTIONS))).reshape(len(left), -1)
    short: dict[int, np.ndarray] = {}
    for k, row in zip(left, values, strict=True):
        slope = scaled[k] @ state.gradient[k]
        good = np.isfinite(row) & (row <= state.value[k] + ENOUGH * slope)
        if good.any():
            short[k] = scaled[k][np.argmin(np.where(good, row, np.inf))]
    taken = {}
    if short:
        rows = np.array(list(short), int)
        state, taken = _tried(memory, oracle, state, rows, np.array(list(short.values())))
    for k in left:
        if not taken.get(k, False):
            state = _failed(state, k)
    return state


def _direction(state: LbfgsState, k: int, radius: float) -> np.ndarray:
    """The full step of a start, at most ``radius`` long."""
    p = direction(state.gradient[k], *state.pairs[k])
    if not state.gradient[k] @ p < 0:
        p = -state.gradient[k]
    length = float(np.linalg.norm(p))
    return p if length <= radius else p * (radius / length)


def _fractions(state: LbfgsState, k: int, step: np.ndarray) -> np.ndarray:
    """What of the step is tried instead: at the start, fixed lengths."""
    if len(state.pairs[k][0]):
        return np.array(FRACTIONS)
    return np.array(FIRST) / np.linalg.norm(step)


def _tried(
    memory: int, oracle: Oracle, state: LbfgsState, rows: np.ndarray, steps: np.ndarray
) -> tuple[LbfgsState, dict[int, bool]]:
    """Steps (rows, n) of some starts, taken where they help and the gradient is finite."""
    trial = oracle.value_and_grad(state.z[rows] + steps, rows)
    taken = {}
    for i, k in enumerate(map(int, rows)):
        limit = state.value[k] + ENOUGH * (state.gradient[k] @ steps[i])
        sound = np.isfinite(trial.objective[i]) and np.isfinite(trial.gradient[i]).all()
        taken[k] = bool(sound and trial.objective[i] <= limit)
        if taken[k]:
            state = _taken(memory, state, k, steps[i], float(trial.objective[i]), trial.gradient[i])
    return state, taken


def _taken(
    memory: int, state: LbfgsState, k: int, p: np.ndarray, value: float, gradient: np.ndarray
) -> LbfgsState:
    moves, changes = state.pairs[k]
    y = gradient - state.gradient[k]
    if p @ y > 1e-10 * np.linalg.norm(p) * np.linalg.norm(y):
        moves = np.concatenate([moves, p[None]])[-memory:]
        changes = np.concatenate([changes, y[None]])[-memory:]
    z, values, value_and_grad = state.z.copy(), state.value.copy(), state.gradient.copy()
    recent, done = state.recent.copy(), state.done.copy()
    norm = state.gradient_norm.copy()
    z[k], values[k], value_and_grad[k] = z[k] + p, value, gradient
    norm[k] = np.linalg.norm(gradient)
    done[k] = recent[k, 0] - value < SMALLEST_GAIN * abs(value)
    recent[k] = np.append(recent[k, 1:], value)
    pairs = tuple((moves, changes) if i == k else pair for i, pair in enumerate(state.pairs))
    return LbfgsState(z, values, value_and_grad, pairs, recent, norm, done)


def _failed(state: LbfgsState, k: int) -> LbfgsState:
    """No step helped: forget what is remembered and try along the gradient; then it is the end."""
    none = np.zeros((0, state.z.shape[1]))
    pairs = tuple((none, none) if i == k else pair for i, pair in enumerate(state.pairs))
    done = state.done.copy()
    done[k] = not len(state.pairs[k][0])
    return state._replace(pairs=pairs, done=done)


def _first_units(cost_model: CostModel, n: int) -> float:
    return cost_model.gradient + len(FIRST)


@functools.cache
def lbfgs(memory: int = 20, radius: float = 2.0) -> Method:
    """memory: pairs that are kept; radius: longest step, in z."""
    return Method(
        name="lbfgs",
        needs="slopes",
        first=_first_units,
        begin=_begin,
        step=functools.partial(_step, memory, radius),
    )
