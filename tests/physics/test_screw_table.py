"""The screw table against its equations: constants, friction, motor, energy ledger, bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.model.fields import replace
from jaxstage.model.signals import Output
from jaxstage.model.validate import check_leaves
from jaxstage.plants import RigidState, screw_table
from jaxstage.plants.parts.friction import friction_force
from jaxstage.plants.screw_table import force_constant, inertia, viscosity
from jaxstage.studies.adaptive_smc import values

H = 2.5e-4
PLANT = screw_table()


def on_device(tree):
    return jax.tree.map(jnp.asarray, tree)


FREE, FITTED = on_device(values.frictionless()), on_device(values.fitted_friction())


def two(x, y=None):
    return jnp.array([x, x if y is None else y], float)


def no_force(fraction):
    return jnp.zeros(2)


def at(position=0.0, velocity=0.0):
    x, v = two(position), two(velocity)
    return PLANT.init(FREE, Output(position=x, velocity=v, drive_position=x, drive_velocity=v))


def motor(table, **changes):
    return replace(table, motor=replace(table.motor, **{k: two(v) for k, v in changes.items()}))


# --- constants -------------------------------------------------------------------------------


@pytest.mark.fast
def test_constants():
    np.testing.assert_allclose(inertia(FREE), [78964.84, 78959.34], rtol=1e-7)
    np.testing.assert_allclose(viscosity(FREE), [592012.4, 630432.4], rtol=1e-7)
    np.testing.assert_allclose(force_constant(FREE), 628.3185, rtol=1e-7)
    ratio = viscosity(FREE) / inertia(FREE)
    np.testing.assert_allclose(ratio, [7.497165, 7.984267], rtol=1e-7)
    coarse = replace(FREE, pitch=two(10e-3))
    np.testing.assert_allclose(inertia(coarse), [19747.21, 19741.71], rtol=3e-7)
    np.testing.assert_allclose(viscosity(coarse), [224863.1, 263283.1], rtol=3e-7)
    np.testing.assert_allclose(values.inertia(), inertia(FREE), rtol=1e-15)
    np.testing.assert_allclose(values.viscosity(), viscosity(FREE), rtol=1e-15)
    np.testing.assert_allclose(values.force_per_volt(), 2 * force_constant(FREE), rtol=1e-15)


@pytest.mark.fast
def test_friction():
    """d / J = fc tanh(v/vs) [1 + (fst - 1) exp(-(v/v_st)^2)]."""
    for v in (-3e-3, -1e-4, -2e-6, 0.0, 5e-5, 2e-4, 1e-2):
        got = friction_force(FITTED.friction, two(v)) / inertia(FITTED)
        fading = np.exp(-((v / 2e-4) ** 2)) * (np.array([36.0, 16.0]) - 1)
        expected = np.array([8.0e-4, 1.7e-3]) * np.tanh(v / 5e-5) * (1 + fading)
        np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-18)


# --- motion ----------------------------------------------------------------------------------


@jax.jit
def march(table, state, volts, load, h, count, damage):
    """State after ``count`` steps of h s, supplied work and residual of the ledger, (axes,) J.

    volts: amplitude, rate and phase of the command. damage: factors on mechanical, dissipated and
    load power, (3,).
    """
    amplitude, rate, phase = volts

    def step(k, carry):
        state, supplied, residual = carry
        command = amplitude * jnp.sin(rate * k * h + phase)
        after = PLANT.step(table, state, command, lambda fraction: load, h)
        power = PLANT.power(table, state, after, command, lambda fraction: load, h)
        gained = PLANT.stored(table, after) - PLANT.stored(table, state)
        mechanical, dissipated, loaded = damage[:, None] * jnp.stack(
            [power.mechanical, power.dissipated, power.load]
        )
        return (
            after,
            supplied + h * jnp.abs(power.copper + power.mechanical),
            residual + h * (mechanical - dissipated - loaded) - gained,
        )

    return jax.lax.fori_loop(0, count, step, (state, jnp.zeros(2), jnp.zeros(2)))


def held(volts):
    return volts, 0.0, two(np.pi / 2)


def test_step_from_rest():
    """Without dry friction J v' + B v = K g_a u - F_b - F has the exponential as its solution."""
    volts, load = two(3.0, -2.0), two(500.0)
    table = replace(FREE, bias=two(200.0, -100.0))
    state, _, _ = march(table, at(), held(volts), load, H, 40, jnp.ones(3))
    push = values.force_per_volt() * volts - table.bias - load
    rate, mass = viscosity(FREE) / inertia(FREE), inertia(FREE)
    gone = -jnp.expm1(-rate * 40 * H)
    np.testing.assert_allclose(state.velocity, push / mass / rate * gone, rtol=1e-12)
    travel = push / mass / rate * (40 * H - gone / rate)
    np.testing.assert_allclose(state.position, travel, rtol=1e-11)


SOFT = replace(
    FITTED, ripple=two(400.0), bias=two(15e3),
    friction=replace(FITTED.friction, width=two(2e-3), stribeck=two(5e-3)),
)  # fmt: skip
SWING = (two(40.0), 3.0, two(0.0, 1.0))


def unbalanced(count, damage):
    """Residual of the ledger over 2 s with reversals, in shares of the supply."""
    _, supplied, residual = march(SOFT, at(), SWING, two(300.0), 2.0 / count, count, damage)
    return np.abs(residual / supplied)


def test_ledger_closes_to_the_fourth_order():
    residuals = np.array([unbalanced(count, jnp.ones(3)) for count in (400, 800, 1600)])
    ratios = residuals[:-1] / residuals[1:]
    assert (ratios > 13).all() and (ratios < 20).all(), ratios
    assert residuals[-1].max() < 1e-6


@pytest.mark.parametrize("term", [0, 1, 2], ids=["mechanical", "dissipated", "load"])
def test_ledger_notices_one_percent(term):
    assert (unbalanced(800, jnp.ones(3).at[term].set(1.01)) > 1e-4).all()


def test_ripple_is_no_loss():
    """Without friction and damping the table swings in the potential of the ripple for ever."""
    quiet = motor(replace(FREE, damping=two(0.0), ripple=two(5e4)), damping=0.0)
    begin = RigidState(position=two(1e-3), velocity=two(0.0))
    end, _, _ = march(quiet, begin, held(two(0.0)), two(0.0), 1e-3, 400, jnp.ones(3))
    assert (jnp.abs(end.position - begin.position) > 1e-4).all()
    np.testing.assert_allclose(PLANT.stored(quiet, end), PLANT.stored(quiet, begin), rtol=1e-7)


# --- motor -----------------------------------------------------------------------------------


def one_step(table, speed, volts):
    state = at(velocity=speed)
    after = PLANT.step(table, state, two(volts), no_force, H)
    return after, PLANT.power(table, state, after, two(volts), no_force, H)


@pytest.mark.fast
def test_copper_and_mechanical_power():
    after, power = one_step(FREE, 0.02, 4.0)
    np.testing.assert_allclose(power.copper, 0.4 * 8.0**2)
    assert (after.velocity != 0.02).all()
    np.testing.assert_allclose(power.mechanical, 628.3185307 * 8.0 * after.position / H, rtol=1e-9)
    np.testing.assert_allclose(power.drawn, power.copper + power.mechanical, rtol=1e-15)


@pytest.mark.fast
def test_supply_limits_the_current():
    """V_s = R i + k_t w: at 2 pi 0.02 / p = 25.13 rad/s the back-EMF is 12.57 V."""
    emf = 0.5 * 2 * np.pi * 0.02 / 5e-3
    for supply, volts, current in (
        (24.0, 20.0, (24 - emf) / 0.4),
        (24.0, -20.0, -40.0),  # the EMF helps: R i + k_t w = -3.4 V is within the supply
        (10.0, 0.0, (10 - emf) / 0.4),  # generating: the current cannot be held at 0
        (np.inf, 20.0, 40.0),
    ):
        table = motor(FREE, supply_voltage=supply)
        after, power = one_step(table, 0.02, volts)
        np.testing.assert_allclose(power.copper, 0.4 * current**2, rtol=1e-12, atol=1e-20)
        free = motor(FREE, supply_voltage=np.inf)
        same, _ = one_step(free, 0.02, current / 2)
        np.testing.assert_allclose(after.velocity, same.velocity, rtol=1e-14)
    superconductor, power = one_step(motor(FREE, resistance=0.0, supply_voltage=1.0), 0.02, 20.0)
    assert (power.copper == 0).all() and np.isfinite(superconductor.velocity).all()


@pytest.mark.fast
@pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
def test_regeneration(share):
    """Braking: credited (1), lost (0), or taken back in part; the motor itself is the same."""
    table = motor(FREE, regeneration=share)
    _, power = one_step(table, 0.02, -4.0)
    electrical = power.copper + power.mechanical
    assert (electrical < 0).all()
    np.testing.assert_allclose(power.drawn, share * electrical, rtol=0, atol=1e-4)
    _, driving = one_step(table, 0.02, 4.0)
    np.testing.assert_allclose(driving.drawn, driving.copper + driving.mechanical, rtol=1e-15)


def test_gradient_at_rest():
    """At rest without command the step has a finite slope, also where every limit is 0 or inf."""

    def speed(volts, table):
        return jnp.sum(PLANT.step(table, at(), two(1.0) * volts, no_force, H).velocity)

    both = jax.jit(jax.value_and_grad(speed))
    for table in (FREE, FITTED, motor(FREE, resistance=0.0)):
        slope = (both(1e-3, table)[0] - both(-1e-3, table)[0]) / 2e-3
        np.testing.assert_allclose(both(0.0, table)[1], slope, rtol=1e-4)


# --- bad input -------------------------------------------------------------------------------

BAD = [
    ("mass", 0.0), ("mass", np.nan), ("damping", -1.0), ("pitch", 0.0), ("pitch", np.inf),
    ("ripple", -1.0), ("bias", np.nan), ("motor.torque_constant", 0.0), ("motor.resistance", -1.0),
    ("motor.inertia", -1.0), ("motor.damping", -1.0), ("motor.amplifier_gain", 0.0),
    ("motor.supply_voltage", 0.0), ("motor.regeneration", 1.1), ("friction.coulomb", -1.0),
    ("friction.static", 1.0), ("friction.stribeck", 0.0), ("friction.width", 0.0),
]  # fmt: skip


@pytest.mark.fast
@pytest.mark.parametrize(("name", "value"), BAD, ids=[f"{n}={v}" for n, v in BAD])
def test_bad_input_is_refused(name, value):
    """friction.static = 1 N is below the Coulomb friction: F_s / F_c < 1."""
    shared = jax.tree.map(lambda _: -1, FITTED)
    check_leaves(PLANT, FITTED, "plant", shared)
    holder, _, field = name.rpartition(".")
    worse = jnp.array([getattr(getattr(FITTED, holder) if holder else FITTED, field)[0], value])
    inner = replace(getattr(FITTED, holder), **{field: worse}) if holder else worse
    bad = replace(FITTED, **{holder or field: inner})
    with pytest.raises(ValueError, match=rf"plant\.{name} \(y\)"):
        check_leaves(PLANT, bad, "plant", shared)
