"""The CMAC as a part: cells, receptive fields, association matrix, training."""

import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxstage.controllers.parts.cmac import (
    BLOCKS,
    LAYERS,
    Gaussian,
    association_matrix,
    coordinate,
    crisp,
    features,
    gaussian,
    train,
)

PUBLISHED = Gaussian(spacing=jnp.asarray(0.5), width=jnp.asarray(1.0))
WIDTHS = (jnp.asarray(0.5), jnp.asarray(5.0))


def active(receptive, params, first, second):
    z = [coordinate(jnp.asarray(float(x)), w) for x, w in zip((first, second), WIDTHS, strict=True)]
    (layer, b1, b2), xi = features(receptive, params, *z)
    return [int(c) for c in BLOCKS**2 * layer + BLOCKS * b1 + b2], np.asarray(xi)


CASES = [
    ((0, 0), [4, 13, 22, 31], [0.324652467358, 0.882496902585, 0.882496902585, 0.324652467358]),
    ((0.3, -4), [7, 13, 22, 30], [0.358796465406, 0.722527353642, 0.653769785130, 0.396531419075]),
    ((-1.1, 12), [5, 14, 19, 28], [0.882496902585, 0.358796465406, 0.265802959089, 0.798516218759]),
    ((9, -99), [6, 15, 24, 33], [0.286504796860, 0.778800783071, 0.778800783071, 0.286504796860]),
]


@pytest.mark.fast
@pytest.mark.parametrize(("inputs", "cells", "strength"), CASES)
def test_active_cells_and_strengths(inputs, cells, strength):
    got, xi = active(gaussian, PUBLISHED, *inputs)
    assert got == cells
    np.testing.assert_allclose(xi, strength, atol=5e-13)
    assert active(crisp, (), *inputs)[0] == cells
    np.testing.assert_array_equal(active(crisp, (), *inputs)[1], 1.0)


def test_centre_strength():
    xi = active(gaussian, PUBLISHED, 0, 0)[1]
    np.testing.assert_allclose(np.sum(xi**2), 1.768400015267, atol=5e-13)


def test_association_matrix():
    matrix = association_matrix()
    assert matrix.shape == (81, 36)
    np.testing.assert_array_equal(matrix.sum(axis=1), LAYERS)
    assert np.linalg.matrix_rank(matrix) == 33
    assert list(np.flatnonzero(matrix[9 * 2 + 2]) + 1) == [
        5,
        14,
        19,
        28,
    ]  # the paper's state (3, 3)
    assert np.flatnonzero(matrix[9 * 0 + 1])[0] + 1 == 2  # state (1, 2) begins with hypercube 2


def test_features_agree_with_the_association_matrix():
    matrix = association_matrix()
    for q1 in range(9):
        for q2 in range(9):
            z1, z2 = jnp.asarray(q1 + 0.5), jnp.asarray(q2 + 0.5)
            (layer, b1, b2), _ = features(crisp, (), z1, z2)
            cells = np.asarray(BLOCKS**2 * layer + BLOCKS * b1 + b2)
            assert sorted(cells) == list(np.flatnonzero(matrix[9 * q1 + q2]))


def test_only_the_ratio_of_spacing_and_width_acts():
    twice = Gaussian(spacing=jnp.asarray(1.0), width=jnp.asarray(2.0))
    np.testing.assert_allclose(
        active(gaussian, twice, 0.3, -4)[1], active(gaussian, PUBLISHED, 0.3, -4)[1], rtol=1e-14
    )


def test_one_training_step_removes_the_whole_error_at_rate_one():
    row = jnp.asarray(association_matrix()[40])
    weights = train(jnp.zeros(36), row, jnp.asarray(2.0), jnp.asarray(1.0))
    np.testing.assert_allclose(row @ weights, 2.0, rtol=1e-14)


def test_training_learns_a_function():
    """Sweeps over all 81 states converge to the least-squares fit of a smooth surface."""
    matrix = association_matrix()
    q = (np.arange(9) - 4) / 4
    target = (np.sin(2 * q)[:, None] + 0.5 * np.cos(3 * q)[None, :]).ravel()

    def sweep(weights, _):
        one = lambda w, pair: (train(w, *pair, jnp.asarray(0.3)), None)  # noqa: E731
        return lax.scan(one, weights, (jnp.asarray(matrix), jnp.asarray(target)))

    weights, _ = lax.scan(sweep, jnp.zeros(36), None, length=300)
    best = matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
    rms = np.sqrt(np.mean((matrix @ weights - target) ** 2))
    assert rms < 1.3 * np.sqrt(np.mean((best - target) ** 2)) + 1e-3
    assert rms < 0.1 * np.std(target)
