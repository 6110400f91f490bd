"""LuGre friction against its equations: printed values, steady sliding, the implicit step."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.plants.parts.lugre import (
    bristle_rate,
    dissipated,
    friction_torque,
    implicit_step,
    level,
)
from jaxstage.studies.mrac_asmc import values

pytestmark = pytest.mark.fast

FRICTION = jax.tree.map(jnp.asarray, values.plant().friction)


def test_friction_values():
    p = FRICTION
    found = [float(level(p, jnp.full(1, v))[0]) for v in (0.0, 1e-3, 0.007353, np.pi / 2)]
    np.testing.assert_allclose(found, [0.04263, 0.042015539, 0.021434998, 0.0091], atol=5e-10)
    v, z = jnp.full(1, -0.01), jnp.full(1, 5e-4)
    np.testing.assert_allclose(bristle_rate(p, v, z), -0.01279225, atol=5e-9)
    np.testing.assert_allclose(friction_torque(p, v, z), -0.026235743, atol=5e-10)


def test_steady_sliding():
    """z = s/sigma_0 sgn v, F = s sgn v + sigma_2 v, and all of F v is heat."""
    p = FRICTION
    v = jnp.asarray([-0.5])
    z = -level(p, v) / p.bristle_stiffness
    torque = friction_torque(p, v, z)
    np.testing.assert_allclose(bristle_rate(p, v, z), 0, atol=1e-16)
    np.testing.assert_allclose(torque, -level(p, v) + p.viscous * v, rtol=1e-14)
    np.testing.assert_allclose(dissipated(p, v, z), torque * v, rtol=1e-14)


def test_implicit_friction_solves_its_equations():
    """With s taken at the speed found; and at rest without a push nothing moves."""
    p, rng = FRICTION, np.random.default_rng(0)
    guess = jnp.asarray(rng.normal(size=200) * 10.0 ** rng.uniform(-4, 2, 200))
    z = jnp.asarray(rng.uniform(-1, 1, 200)) * level(p, guess) / p.bristle_stiffness
    inertia, push = 5e-5, jnp.asarray(rng.normal(size=200)) * 1e-3

    @jax.jit
    def solved(dt):
        again = lambda _, speed: implicit_step(p, inertia, push, z, speed, dt)[0]  # noqa: E731
        speed = jax.lax.fori_loop(0, 30, again, guess)
        speed, bristle = implicit_step(p, inertia, push, z, speed, dt)
        left = inertia * speed + dt * friction_torque(p, speed, bristle) - push
        return speed, bristle - z - dt * bristle_rate(p, speed, bristle), left

    for dt in (1e-6, 1e-4, 1e-2):
        speed, bristle_left, momentum_left = solved(dt)
        settled = np.abs(speed) > 3 * p.stribeck  # there the passes over s have converged
        assert settled.sum() > 40
        np.testing.assert_allclose(bristle_left[settled], 0, atol=1e-13)
        np.testing.assert_allclose(momentum_left[settled], 0, atol=1e-12)
    still = implicit_step(p, inertia, jnp.zeros(1), jnp.zeros(1), jnp.zeros(1), 1e-4)
    assert still[0] == 0 and still[1] == 0
