"""The methods on functions whose minimum is known, without simulation."""

import copy
from itertools import pairwise

import numpy as np
import pytest

from tuning.tuner.problem.problem import GaussNewtonModel, ValueAndGrad
from tuning.tuner.search.cma_es import cma_es
from tuning.tuner.search.first_order import first_order
from tuning.tuner.search.lbfgs import direction, lbfgs
from tuning.tuner.search.levenberg_marquardt import damped_step, levenberg_marquardt, promised
from tuning.tuner.search.method import Oracle
from tuning.tuner.search.random_search import random_search

pytestmark = pytest.mark.fast


def residuals(z):
    """Rosenbrock in ten dimensions as least squares; (m, 18)."""
    return np.concatenate([10 * (z[:, 1:] - z[:, :-1] ** 2), 1 - z[:, :-1]], axis=1)


def jacobian(z):
    """(m, 18, 10)."""
    m, n = z.shape
    found = np.zeros((m, 2 * (n - 1), n))
    for i in range(n - 1):
        found[:, i, i + 1] = 10
        found[:, i, i] = -20 * z[:, i]
        found[:, n - 1 + i, i] = -1
    return found


def oracle(spoil=lambda z, value: value, asked=None):
    """spoil(z, values) may make some values infinite or NaN. asked: counts questions."""
    asked = {} if asked is None else asked

    def count(name, z):
        asked[name] = asked.get(name, 0) + len(z)

    def value(z):
        return spoil(z, np.sum(residuals(z) ** 2, axis=1))

    def values(z, rows):
        count("values", z)
        return value(z)

    def slope(z):
        return 2 * np.einsum("mri,mr->mi", jacobian(z), residuals(z))

    def value_and_grad(z, rows):
        count("slopes", z)
        gradient = np.where(np.isfinite(value(z))[:, None], slope(z), np.nan)
        return ValueAndGrad(value(z), gradient, np.zeros(len(z)))

    def gauss_newton_model(z, rows):
        count("curvatures", z)
        j = jacobian(z)
        gradient = np.where(np.isfinite(value(z))[:, None], slope(z), np.nan)
        matrix = 2 * np.einsum("mri,mrj->mij", j, j)
        return GaussNewtonModel(value(z), gradient, matrix, np.zeros(len(z)), gradient[:, None])

    return Oracle(values, value_and_grad, gauss_newton_model)


STARTS = np.stack([np.full(10, -0.5), np.linspace(-1, 1, 10)])


def searched(method, steps, asks=None, starts=STARTS):
    asks = asks or oracle()
    states = [method.begin(asks, starts, 0)]
    for _ in range(steps):
        if np.all(states[-1].done):
            break
        states.append(method.step(asks, states[-1]))
    return states


@pytest.mark.parametrize(
    ("method", "steps", "reached"),
    [(levenberg_marquardt(), 60, 1e-8), (lbfgs(), 150, 1e-6), (cma_es(), 600, 1e-6)],
    ids=lambda x: getattr(x, "name", ""),
)
def test_the_minimum_is_found(method, steps, reached):
    last = searched(method, steps)[-1]
    found = last.value < reached
    assert found[0] and np.all(found | (np.abs(last.value - 3.99) < 0.01)), "or the other minimum"
    np.testing.assert_allclose(last.z[found], 1.0, atol=0.01)


@pytest.mark.parametrize(
    "method",
    [levenberg_marquardt(), lbfgs(), first_order(), cma_es(), random_search()],
    ids=lambda m: m.name,
)
def test_steps_are_pure_and_never_worse(method):
    states = searched(method, 12)
    assert all(np.all(b.value <= a.value) for a, b in pairwise(states))
    np.testing.assert_allclose(states[-1].value, oracle().values(states[-1].z, np.arange(2)))
    kept = copy.deepcopy(states[3])
    again = [method.step(oracle(), states[3]) for _ in range(2)]
    assert np.array_equal(again[0].z, again[1].z) and np.array_equal(states[4].z, again[0].z)
    for name in ("z", "value", "done"):
        assert np.array_equal(getattr(kept, name), getattr(states[3], name)), "changed in place"
    other = searched(method, 12)[-1]
    assert np.array_equal(other.z, states[-1].z), "the seed decides"


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e6])
@pytest.mark.parametrize("method", [levenberg_marquardt(), lbfgs()], ids=lambda m: m.name)
def test_what_is_lost_is_only_a_bad_trial(method, bad):
    """All around the path to the minimum lies a region without values."""

    def spoil(z, value):
        return np.where(np.max(np.abs(z), axis=1) > 1.02, bad, value)

    last = searched(method, 300, oracle(spoil))[-1]
    assert np.all(np.isfinite(last.z)) and np.all(last.value < 0.1)


def test_a_start_without_gradient_is_at_its_end():
    def spoil(z, value):
        return np.where(z[:, 0] < -0.6, np.nan, value)

    for method in (levenberg_marquardt(), lbfgs()):
        first = method.begin(oracle(spoil), STARTS, 0)
        assert first.done.tolist() == [False, True]
        assert searched(method, 100, oracle(spoil))[-1].value[0] < 1.0


def test_damped_steps_are_those_of_the_trust_region():
    source = np.random.default_rng(1)
    a = source.normal(size=(6, 6))
    matrix, gradient = a @ a.T, source.normal(size=6)
    newton = -np.linalg.solve(matrix, gradient)
    np.testing.assert_allclose(damped_step(matrix, gradient, 1e6), newton, rtol=1e-6)
    short = damped_step(matrix, gradient, 0.1)
    assert np.linalg.norm(short) == pytest.approx(0.1)
    tries = source.normal(size=(20000, 6))
    tries *= 0.1 / np.linalg.norm(tries, axis=1, keepdims=True)
    best = max(promised(matrix, gradient, step) for step in tries)
    assert promised(matrix, gradient, short) >= best > 0
    flat = damped_step(np.zeros((3, 3)), np.array([0.0, 3.0, 4.0]), 0.5)
    np.testing.assert_allclose(flat, [0.0, -0.3, -0.4], atol=1e-6)


def test_the_recursion_inverts_a_quadratic():
    """With as many pairs as dimensions, L-BFGS gives the Newton step of a quadratic."""
    source = np.random.default_rng(2)
    a = source.normal(size=(4, 4))
    matrix = a @ a.T + np.eye(4)
    moves = []
    for v in source.normal(size=(4, 4)):  # conjugate, as exact line searches would make them
        for s in moves:
            v = v - s * (s @ matrix @ v) / (s @ matrix @ s)
        moves.append(v)
    moves = np.array(moves)
    gradient = source.normal(size=4)
    np.testing.assert_allclose(
        direction(gradient, moves, moves @ matrix), -np.linalg.solve(matrix, gradient), rtol=1e-8
    )


def test_gradients_cost_less_than_no_gradients():
    """To 1e-3 of the start, with a gradient for four values and a Jacobian for six."""
    spent = {}
    for method, price in ((levenberg_marquardt(), 6), (lbfgs(), 4), (cma_es(), 0)):
        asked = {}
        asks = oracle(asked=asked)
        state = method.begin(asks, STARTS[:1], 0)
        target = 1e-3 * float(state.value[0])
        while state.value[0] > target:
            state = method.step(asks, state)
        spent[method.name] = asked.get("values", 0) + price * (
            asked.get("slopes", 0) + asked.get("curvatures", 0)
        )
    assert spent["lm"] < spent["cma"] / 3 and spent["lbfgs"] < spent["cma"] / 3, spent
