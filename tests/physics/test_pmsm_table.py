"""The table against its equations: friction, sticking, backlash, energy ledger."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.model.fields import replace
from jaxstage.model.signals import Output
from jaxstage.numerics.integrate import rk4
from jaxstage.numerics.smooth import play
from jaxstage.plants import friction_force, pmsm_table
from jaxstage.studies.fuzzy_cmac.loops import plant as published

H = 1e-4
PLANT = pmsm_table()
PARAMS = jax.tree.map(jnp.asarray, published())


def no_force(fraction):
    return jnp.zeros(2)


def at(position=0.0, velocity=0.0):
    x, v = jnp.full(2, position), jnp.full(2, velocity)
    return PLANT.init(PARAMS, Output(position=x, velocity=v, drive_position=x, drive_velocity=v))


def steps(state, current, count, h=H, params=PARAMS):
    applied = jnp.full(2, current)
    path = []
    for _ in range(count):
        state = PLANT.step(params, state, applied, no_force, h)
        path.append(state)
    return path


@pytest.mark.fast
def test_friction_values():
    v = jnp.array([-1.0, -0.05, 0.05, 10.0])
    got = [friction_force(PARAMS, jnp.full(2, x))[0] for x in v]
    expected = [-0.239104485037, -0.239997750028, 0.239997750028, 0.183109149705]
    np.testing.assert_allclose(got, expected, atol=5e-13)
    assert friction_force(PARAMS, jnp.zeros(2))[0] == 0
    y = [friction_force(PARAMS, jnp.full(2, x))[1] for x in (0.05, 5.0)]
    np.testing.assert_allclose(y, [0.199995000250, 0.168393972059], atol=5e-13)


@pytest.mark.fast
def test_first_steps_from_rest():
    path = steps(at(), 0.5, 5)
    expected = [
        0.004651162790698, 0.009286873860163, 0.013907185828116, 0.018512151126649,
        0.023101822000954,
    ]  # fmt: skip
    np.testing.assert_allclose([s.velocity[0] for s in path], expected, atol=5e-16)
    np.testing.assert_allclose(path[-1].position[0], 6.945919560658e-06, atol=5e-19)


def test_one_second():
    advance = lambda s, _: (PLANT.step(PARAMS, s, jnp.full(2, 0.5), no_force, H), None)  # noqa: E731
    end, _ = jax.lax.scan(advance, at(), None, length=10_000)
    np.testing.assert_allclose(end.position[0], 1.3745549549, atol=5e-11)
    np.testing.assert_allclose(end.velocity[0], 1.4179136333, atol=5e-11)


def test_sticks_exactly_until_break_away():
    assert steps(at(), 0.3541, 50)[-1].velocity[0] == 0.0
    assert steps(at(), 0.3541, 50)[-1].position[0] == 0.0
    np.testing.assert_allclose(
        steps(at(), 0.3542, 1)[0].velocity[0], 1.063122923589e-06, atol=5e-19
    )


def test_comes_to_rest_and_stays():
    path = steps(at(velocity=0.02), 0.0, 400)
    stopped = [i for i, s in enumerate(path) if s.velocity[0] == 0.0]
    assert stopped and stopped == list(range(stopped[0], 400))


def test_play():
    half, state, seen = jnp.asarray(0.1), jnp.asarray(0.0), []
    for u in (0, 0.05, 0.2, 0.3, 0.25, 0.15, 0.05, -0.2):
        state = play(state, jnp.asarray(u), half)
        seen.append(float(state))
    np.testing.assert_allclose(seen, [0, 0, 0.1, 0.2, 0.2, 0.2, 0.15, -0.1], atol=1e-15)


def test_play_without_width_is_transparent():
    assert play(jnp.asarray(3.0), jnp.asarray(-0.7), jnp.asarray(0.0)) == -0.7


def test_first_order_in_the_step():
    """While sliding one way the implicit step converges to the ODE at first order."""

    def end(h):
        return steps(at(velocity=0.5), 0.6, round(0.02 / h), h)[-1].position[0]

    p = PARAMS

    def derivative(x, _):
        v = x[1]
        dry = p.coulomb[0] + (p.static[0] - p.coulomb[0]) * jnp.exp(-((v / p.stribeck[0]) ** 2))
        force = p.force_constant[0] * 0.6 - p.load[0] - dry - p.damping[0] * v
        return jnp.array([v, force / p.mass[0]])

    x = jnp.array([0.0, 0.5])
    for _ in range(200):
        x = rk4(derivative, x, 1e-4)
    errors = [abs(end(h) - x[0]) for h in (4e-4, 2e-4, 1e-4)]
    ratios = [errors[0] / errors[1], errors[1] / errors[2]]
    assert all(1.9 < r < 2.1 for r in ratios), ratios


def ledger(params, load_force=0.0, damage=None):
    """Residual of the ledger over a run with reversals, relative to the energy supplied."""
    force = lambda fraction: jnp.full(2, load_force)  # noqa: E731
    state, residual, supplied = at(), jnp.zeros(2), jnp.zeros(2)
    for k in range(400):
        applied = 0.9 * jnp.sin(0.05 * k + jnp.array([0.0, 1.0]))
        after = PLANT.step(params, state, applied, force, H)
        power = PLANT.power(params, state, after, applied, force, H)
        if damage:
            power = replace(power, **{damage: 1.01 * getattr(power, damage)})
        gained = PLANT.stored(params, after) - PLANT.stored(params, state)
        residual += H * (power.mechanical - power.dissipated - power.load) - gained
        supplied += H * jnp.abs(power.copper + power.mechanical)
        state = after
    return float(jnp.max(jnp.abs(residual / supplied)))


@pytest.mark.parametrize("backlash", [0.0, 0.05])
def test_energy_ledger_closes(backlash):
    params = replace(PARAMS, backlash=jnp.full(2, backlash))
    assert ledger(params, load_force=0.03) < 1e-12


@pytest.mark.parametrize("term", ["mechanical", "dissipated", "load"])
def test_energy_ledger_notices_one_percent(term):
    assert ledger(PARAMS, load_force=0.03, damage=term) > 1e-7


def test_copper_and_drawn_power():
    state = at(velocity=0.3)
    braking = jnp.full(2, -0.2)
    after = PLANT.step(PARAMS, state, braking, no_force, H)
    power = PLANT.power(PARAMS, state, after, braking, no_force, H)
    mean = (state.velocity + after.velocity) / 2
    np.testing.assert_allclose(power.copper, 2.0 * 0.2**2)
    np.testing.assert_allclose(power.mechanical, 0.96 * -0.2 * mean)
    expected = np.maximum(power.copper + power.mechanical, 0)
    np.testing.assert_allclose(power.drawn, expected)
    fast = at(velocity=3.0)
    after = PLANT.step(PARAMS, fast, braking, no_force, H)
    assert (PLANT.power(PARAMS, fast, after, braking, no_force, H).drawn == 0).all()


def test_no_backlash_and_no_friction_are_transparent_to_a_gradient():
    """Also exactly at rest with no command, where clip would share the tie between branches."""
    zero = jnp.asarray(0.0)
    assert jax.grad(lambda u: play(zero, u, zero))(0.0) == 1.0
    params = replace(PARAMS, static=jnp.zeros(2), coulomb=jnp.zeros(2), load=jnp.zeros(2))

    def speed(current):
        applied = jnp.full(2, current)
        return PLANT.step(params, at(), applied, no_force, H).velocity[0]

    slope = (speed(1e-3) - speed(-1e-3)) / 2e-3
    np.testing.assert_allclose(jax.grad(speed)(0.0), slope, rtol=1e-9)
