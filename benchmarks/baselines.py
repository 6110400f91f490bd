"""Everyday baselines: numpy over the batch in a Python loop, one run by scipy's solver."""

import time
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from .cases import DT, Work, parameter_rows, path_rows

LAYERS = np.arange(4)[:, None]
SMOOTH_SPEED, SMOOTH_SURFACE = 1e-3, 1e-3  # m/s, in place of sgn v and sgn s


class DfcmacLaw(NamedTuple):
    """Parameters of the DFCMAC loop, one number per run and axis."""

    slope: np.ndarray
    rate: np.ndarray
    credit: np.ndarray
    eta: np.ndarray
    error_width: np.ndarray
    rate_width: np.ndarray
    ratio: np.ndarray
    gain: np.ndarray
    force: np.ndarray
    mass: np.ndarray
    damping: np.ndarray
    coulomb: np.ndarray
    static: np.ndarray
    stribeck: np.ndarray
    load: np.ndarray
    play: np.ndarray


def _law(work: Work) -> DfcmacLaw:
    rows = parameter_rows(work)
    return DfcmacLaw(*rows.reshape(len(rows) // 2, -1))


def _features(law: DfcmacLaw, error: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Active cell of each layer and its strength, (4, runs x axes)."""
    z = np.clip(np.stack([error / law.error_width, rate / law.rate_width]) + 4.5, 0, 9)
    cell = np.minimum(z.astype(np.int32), 8)[:, None]
    block = (cell + 3 - LAYERS) // 4
    away = (z[:, None] - (4 * block + LAYERS - 1)).astype(z.dtype)
    strength = np.exp(-(law.ratio**2) * (away[0] ** 2 + away[1] ** 2))
    return 9 * LAYERS + 3 * block[0] + block[1], strength


def _limit(law: DfcmacLaw, velocity: np.ndarray) -> np.ndarray:
    fading = np.exp(-((velocity / law.stribeck) ** 2))
    return (law.coulomb + (law.static - law.coulomb) * fading) / law.mass


def numpy_rollout(work: Work) -> np.ndarray:
    """ATE of every run in m; runs and axes side by side in one long vector."""
    law, path = _law(work), path_rows(work)
    count, lane = law.slope.size, np.arange(law.slope.size)
    axis = lane // work.lanes
    x, v = path[0, axis], np.zeros(count, path.dtype)
    weights = np.zeros((36, count), path.dtype)
    step = path.dtype.type(DT)
    total = np.zeros(work.lanes, path.dtype)
    current = np.zeros_like(v)
    for row in path:
        error, rate = row[axis] - x, row[2 + axis] - v
        total += np.sqrt((error.reshape(2, -1) ** 2).sum(0))
        surface = -(law.slope * error + rate)
        cells, strength = _features(law, error, rate)
        active = weights[cells, lane]
        active -= 2 * step * law.rate * law.credit * law.gain * surface * strength
        weights[cells, lane] = active
        u = (strength * active).sum(0) - law.eta / law.gain * np.sign(surface)
        current = u - np.clip(u - current, -law.play, law.play)
        free = v + step * (law.force * current - law.load) / law.mass
        limit = step * _limit(law, v)
        v = (free - np.clip(free, -limit, limit)) / (1 + step * law.damping / law.mass)
        x = x + step * v
    return total / work.ticks


def numpy_rate(work: Work) -> tuple[float, np.ndarray]:
    """Lane-steps per second of `numpy_rollout`, and its result."""
    begin = time.perf_counter()
    result = numpy_rollout(work)
    return work.lane_steps / (time.perf_counter() - begin), result


def scipy_rate(work: Work, duration: float) -> tuple[float, int]:
    """Control periods per second of solve_ivp (RK45), and its evaluations of the derivative.

    The continuous closed loop: the law acts all the time, without play; friction and switch are
    smooth. (The implicit solvers are slower by far: the law's cells make the derivative jump.)
    """
    law, path = _law(work), path_rows(work)

    def derivative(t: float, state: np.ndarray) -> np.ndarray:
        x, v = state[:2], state[2:4]
        weights = state[4:].reshape(36, 2)
        row = path[min(int(t / DT), len(path) - 1)]
        ahead = t - int(t / DT) * DT
        error = row[:2] + ahead * row[2:4] - x
        rate = row[2:4] + ahead * row[4:6] - v
        surface = -(law.slope * error + rate)
        cells, strength = _features(law, error, rate)
        slope = np.zeros_like(weights)
        slope[cells, [0, 1]] = -2 * law.rate * law.credit * law.gain * surface * strength
        switched = law.eta / law.gain * np.tanh(surface / SMOOTH_SURFACE)
        u = (strength * weights[cells, [0, 1]]).sum(0) - switched
        push = (law.force * u - law.load - law.damping * v) / law.mass
        friction = _limit(law, v) * np.tanh(v / SMOOTH_SPEED)
        return np.concatenate([v, push - friction, slope.ravel()])

    state = np.concatenate([path[0, :2], np.zeros(74)])
    begin = time.perf_counter()
    answer = solve_ivp(derivative, (0, duration), state, "RK45", rtol=1e-3, atol=1e-7)
    spent = time.perf_counter() - begin
    if not answer.success:
        raise RuntimeError(answer.message)
    return duration / DT / spent, answer.nfev
