"""The two-inertia drive against its equations: linear modes, steps, energy, sides."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.controllers import cascade, per_axis
from jaxstage.hardware.drives import CurrentDrive, current_drive
from jaxstage.hardware.loads import no_load
from jaxstage.hardware.sensors import ideal_sensor, motor_side
from jaxstage.metrics import contour, drive_following, following, together
from jaxstage.model.blocks import Loop
from jaxstage.model.fields import replace
from jaxstage.model.signals import Output, Scenario, Start
from jaxstage.numerics.integrate import sdirk2
from jaxstage.plants import (
    TwoInertiaState,
    explicit,
    implicit,
    on_load,
    on_motor,
    two_inertia,
)
from jaxstage.plants.two_inertia import slope
from jaxstage.references import circle, make_path, sampled, uniform_parameter
from jaxstage.simulate.rollout import simulate
from jaxstage.studies.case import Timing
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.mrac_asmc.loops import build, law, version

pytestmark = pytest.mark.long

T = values.DT
PARAMS = jax.tree.map(jnp.asarray, values.plant())
SIDES = pytest.mark.parametrize("side", [on_load, on_motor], ids=lambda side: side.name)


def none(fraction):
    return jnp.zeros(1)


def state(*five):
    names = ("motor_angle", "motor_speed", "load_angle", "load_speed", "bristle")
    return TwoInertiaState(
        **{n: jnp.asarray(x, float)[None] for n, x in zip(names, five, strict=True)}
    )


REST = state(0, 0, 0, 0, 0)
SLIDING = state(0, 1.0, 0, 1.0, 1.1e-3)


def numbers(end):
    """The five values of a state, or of many."""
    bodies = (end.motor_angle, end.motor_speed, end.load_angle, end.load_speed)
    return np.stack([np.asarray(x)[..., 0] for x in (*bodies, end.bristle)], axis=-1)


@functools.cache
def _driven(side, integration):
    plant = two_inertia(("x",), side, integration)

    def run(begin, commands, period, substeps):
        step = lambda x, u: plant.step(PARAMS, x, u[None], none, period / substeps)  # noqa: E731

        def tick(s, u):
            after = jax.lax.fori_loop(0, substeps, lambda i, x: step(x, u), s)
            return after, after

        return jax.lax.scan(tick, begin, commands)

    return jax.jit(run)


def driven(side, integration, substeps, begin, commands, period=T):
    """From a state, with commands (ticks,) held over a period each: the last state, and all."""
    return _driven(side, integration)(begin, commands, period, substeps)


# --- linear modes ----------------------------------------------------------------------------


@jax.jit
def linearised(params):
    """Jacobian of the equations of motion at rest, in the order of the state."""
    flat = lambda x: slope(on_load, params, state(*x), jnp.zeros(1), jnp.zeros(1))  # noqa: E731
    return jax.jacfwd(lambda x: jnp.concatenate(jax.tree.leaves(flat(x))))(jnp.zeros(5))


@pytest.mark.fast
def test_linear_modes():
    """Without friction: two free poles at 0, the others as printed; zeros with the motor held."""
    loose = replace(
        PARAMS.friction, bristle_stiffness=jnp.full(1, 1e-300), bristle_damping=jnp.zeros(1),
        viscous=jnp.zeros(1),
    )  # fmt: skip
    damped = linearised(replace(PARAMS, friction=loose))[:4, :4]
    poles = np.sort(np.linalg.eigvals(damped).real)
    np.testing.assert_allclose(poles[:2], [-1086.82, -387.74], atol=5e-3)
    free = linearised(replace(PARAMS, friction=loose, damping=jnp.zeros(1)))[:4, :4]
    resonance = np.abs(np.linalg.eigvals(free).imag).max() / (2 * np.pi)
    held = free[2:, 2:]  # the load alone: the zeros of torque to motor angle
    antiresonance = np.abs(np.linalg.eigvals(held).imag).max() / (2 * np.pi)
    np.testing.assert_allclose([antiresonance, resonance], [95.124, 103.316], atol=5e-4)
    a, b = poles[:2]
    np.testing.assert_allclose(-(a + b) / (2 * np.sqrt(a * b)), 1.1358, atol=5e-5)


@pytest.mark.fast
def test_a_stuck_load_is_stiff():
    assert np.linalg.eigvals(linearised(PARAMS)).real.min() == pytest.approx(-47548, abs=0.5)


# --- steps -----------------------------------------------------------------------------------

OPEN_LOOP = {
    100: (0.003600216, 0.09834068, 0.0007342799, 0.0412957, 0.0005423762),
    625: (0.4067374, -0.075876, 0.4097409, -0.01955792, 0.0003763172),
    1250: (0.08272301, 0.552241, 0.078539, 0.7681021, 0.00111824),
    2083: (0.07246254, -0.162689, 0.07341814, -0.2295741, -0.001133617),
}
COMMANDS = 0.1 * jnp.sin(4 * jnp.pi * jnp.arange(2083) * T)


@functools.cache
def open_loop(integration, substeps):
    return driven(on_load, integration, substeps, REST, COMMANDS)[1]


def test_open_loop_checkpoints():
    for ticks, expected in OPEN_LOOP.items():
        found = numbers(open_loop(explicit, 48))[ticks - 1]
        np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize(("substeps", "largest"), [(1, 3e-2), (12, 1e-3)])
def test_implicit_open_loop(substeps, largest):
    """Through six reversals; relative to the largest value of each state."""
    exact, found = numbers(open_loop(explicit, 48)), numbers(open_loop(implicit, substeps))
    assert (np.abs(found - exact).max(axis=0) / np.abs(exact).max(axis=0) < largest).all()


@SIDES
def test_second_order_away_from_reversals(side):
    """Setting off one way, with bristles that bend and a shaft that twists."""
    commands = jnp.full(5, 0.1)
    begin, _ = driven(side, explicit, 96, state(0, 0.02, 0, 0.02, 2e-4), commands)
    ends = [
        numbers(driven(side, method, n, begin, commands)[0])
        for method, n in ((explicit, 96), (implicit, 4), (implicit, 8), (implicit, 16))
    ]
    errors = [np.abs(end / ends[0] - 1) for end in ends[1:]]
    assert (0 < begin.bristle).all() and (errors[-1] < 1e-5).all()
    for coarse, fine in itertools.pairwise(errors):
        ratio = (coarse / fine)[:4]  # the bristles slip by then: nothing left to converge
        assert (3.3 < ratio).all() and (ratio < 5).all(), (coarse, fine)


@SIDES
def test_stable_at_any_step(side):
    """Where the explicit step blows up at once: one substep, and steps a thousand times longer."""
    rng = np.random.default_rng(1)
    commands = jnp.asarray(rng.uniform(-0.5, 0.5, 300))
    for period in (T, 20 * T, 1000 * T):
        _, path = driven(side, implicit, 1, REST, commands, period)
        twist = np.abs(path.motor_angle - path.load_angle).max()
        bent = np.abs(path.bristle).max() * PARAMS.friction.bristle_stiffness
        assert twist < 0.2 and bent < 10 * PARAMS.friction.static
        assert np.abs(path.motor_speed).max() < 40
    if side is on_load:
        _, path = driven(side, explicit, 6, REST, commands)
        assert not np.isfinite(np.asarray(path.load_speed)).all()


@pytest.mark.fast
def test_a_stiff_decay_needs_no_small_step():
    """x' = -1e9 (x - cos t): the two-stage step follows cos t and forgets its start."""

    def stage(base, h, fraction):
        return (base + h * 1e9 * np.cos(2.0 + fraction)) / (1 + h * 1e9)

    assert sdirk2(stage, 7.0, 1.0) == pytest.approx(np.cos(3.0), abs=1e-7)


def test_gradients_are_finite_and_right():
    """At rest, in a reversal and sliding; by the torque, the parameters and the start."""
    plant = two_inertia()

    def end(torque, params, begin):
        s = plant.step(params, begin, torque, none, T)
        return s.motor_speed[0] + 1e2 * s.bristle[0]

    found = jax.jit(jax.value_and_grad(end, argnums=(0, 1, 2)))
    for begin in (REST, state(0, 1e-9, 0, -1e-9, 5e-4), SLIDING):
        for torque in (0.0, 0.1):
            result = found(jnp.full(1, torque), PARAMS, begin)
            assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(result))
    _, (by_torque, by_params, _) = found(jnp.full(1, 0.1), PARAMS, SLIDING)
    up, down = (found(jnp.full(1, 0.1 + h), PARAMS, SLIDING)[0] for h in (1e-6, -1e-6))
    np.testing.assert_allclose(by_torque[0], (up - down) / 2e-6, rtol=1e-6)
    up, down = (
        found(
            jnp.full(1, 0.1),
            replace(PARAMS, friction=replace(PARAMS.friction, coulomb=jnp.full(1, 0.0091 + h))),
            SLIDING,
        )[0]
        for h in (1e-6, -1e-6)
    )
    np.testing.assert_allclose(by_params.friction.coulomb[0], (up - down) / 2e-6, rtol=1e-5)


# --- energy, sides, axes ---------------------------------------------------------------------


TERMS = ("mechanical", "dissipated", "load")


def ledger(side, substeps):
    """Residual of the energy balance of a run with reversals, relative to the work of the motor;
    then with each term of the balance one percent off."""
    plant, h = two_inertia(("x",), side), T / substeps
    push = lambda fraction: jnp.full(1, 20.0)  # noqa: E731
    weights = 1 + 0.01 * np.vstack([np.zeros(3), np.eye(3)])

    def substep(carry, u):
        s, terms, worked = carry
        after = plant.step(PARAMS, s, u[None], push, h)
        power = plant.power(PARAMS, s, after, u[None], push, h)
        terms += h * jnp.concatenate([getattr(power, name) for name in TERMS])
        return (after, terms, worked + h * jnp.abs(power.mechanical[0])), None

    commands = jnp.repeat(0.15 * jnp.sin(0.05 * jnp.arange(400)), substeps)
    run = jax.jit(lambda: jax.lax.scan(substep, (REST, jnp.zeros(3), 0.0), commands)[0])
    end, terms, worked = run()
    signed = weights * np.asarray(terms) * np.array([1.0, -1.0, -1.0])
    gained = plant.stored(PARAMS, end)[0] - plant.stored(PARAMS, REST)[0]
    return np.abs(signed.sum(axis=1) - gained) / float(worked)


@SIDES
def test_energy_ledger_closes_and_notices_one_percent(side):
    coarse, fine = ledger(side, 24), ledger(side, 48)
    assert fine[0] < 1e-6 and coarse[0] / fine[0] > 3
    assert all(damaged > 1e-5 for damaged in fine[1:]), fine


@pytest.mark.fast
def test_copper_and_drawn_power():
    plant = two_inertia()
    begin = SLIDING
    for torque in (0.1, -0.1):
        u = jnp.full(1, torque)
        power = plant.power(PARAMS, begin, plant.step(PARAMS, begin, u, none, T), u, none, T)
        np.testing.assert_allclose(power.copper, 8.0 * torque**2)
        np.testing.assert_allclose(power.mechanical, torque * 1.0, rtol=0.2)
        expected = np.maximum(power.copper + power.mechanical, 0)
        np.testing.assert_allclose(power.drawn, expected, rtol=1e-14)


@pytest.mark.fast
def test_the_rubbing_side_is_the_one_that_feels_friction():
    begin = SLIDING
    for side, rubbing, free in (
        (on_load, "load_speed", "motor_speed"),
        (on_motor, "motor_speed", "load_speed"),
    ):
        found = slope(side, PARAMS, begin, jnp.zeros(1), jnp.zeros(1))
        assert getattr(found, rubbing)[0] < -10 and getattr(found, free)[0] == 0


@pytest.mark.fast
def test_an_external_force_is_a_torque_on_the_load():
    """1 N on a tool with 1000 rad/m is 1 mN m; twice the force at the end of the step is seen."""
    found = slope(on_motor, PARAMS, REST, jnp.zeros(1), jnp.ones(1))
    np.testing.assert_allclose(found.load_speed, -1e-3 / PARAMS.load_inertia)
    plant, h = two_inertia(side=on_motor), 1e-6
    rising = plant.step(PARAMS, REST, jnp.zeros(1), lambda f: 2 * f * jnp.ones(1), h)
    steady = plant.step(PARAMS, REST, jnp.zeros(1), lambda f: jnp.ones(1), h)
    np.testing.assert_allclose(rising.load_speed, steady.load_speed, rtol=1e-3)


@pytest.mark.fast
def test_output_is_in_tool_units():
    plant = two_inertia()
    asked = Output(
        position=jnp.full(1, 1e-3), velocity=jnp.full(1, 2e-3),
        drive_position=jnp.full(1, 3e-3), drive_velocity=jnp.full(1, 4e-3),
    )  # fmt: skip
    begin = plant.init(PARAMS, asked)
    np.testing.assert_allclose(numbers(begin), [3.0, 4.0, 1.0, 2.0, 0.0], rtol=1e-15)
    jax.tree.map(np.testing.assert_allclose, plant.observe(PARAMS, begin), asked)


def test_contour_error_of_load_and_motor():
    """Two axes on a circle of 5 mm radius in 4 s, closed on the motors: the tool lags the motors
    by the twist of its shaft, which is friction over stiffness."""
    small = replace(circle(), control_points=circle().control_points / 5)
    path = make_path(small, uniform_parameter(4.0, T))
    both = lambda tree: jax.tree.map(lambda x: jnp.full(2, x[0]), tree)  # noqa: E731
    loop = Loop(
        plant=two_inertia(("x", "y")), controller=per_axis(cascade), reference=sampled,
        load=no_load, sensor=motor_side(ideal_sensor), drive=current_drive(1),
        metric=together(contour, following, drive_following), dt=T, substeps=12,
    )  # fmt: skip
    scenario = Scenario(
        plant=both(values.plant()), load=(), sensor=(),
        drive=CurrentDrive(limit=jnp.full(2, 5.0), delay=0.0, lag=0.0),
        start=Start(offset=jnp.zeros(2), velocity=jnp.ones(2)), key=jax.random.key(0),
    )  # fmt: skip
    ticks = path.search.corner.shape[0]
    report = simulate(loop, both(values.cascade_gains()), scenario, path, ticks).report
    tool = report["following"].following_mean
    motor = report["drive_following"].drive_following_mean
    friction = PARAMS.friction.coulomb + PARAMS.friction.viscous * 2 / np.pi * 7.85
    twist = friction / PARAMS.stiffness / PARAMS.ratio
    np.testing.assert_allclose(tool - motor, jnp.full(2, twist[0]), rtol=0.3)
    assert report["contour"].contour_max > 0.5 * twist[0]


# --- what is refused -------------------------------------------------------------------------


@pytest.mark.fast
@pytest.mark.parametrize(
    "name",
    [
        "motor_inertia", "load_inertia", "stiffness", "ratio", "friction.coulomb",
        "friction.stribeck", "friction.bristle_stiffness",
    ],
)  # fmt: skip
def test_impossible_drives_are_refused(name):
    refused_with(name, 0.0)
    refused_with(name, np.nan)


@pytest.mark.fast
@pytest.mark.parametrize(
    "name", ["damping", "copper_loss", "friction.bristle_damping", "friction.viscous"]
)
def test_negative_losses_are_refused(name):
    refused_with(name, -1e-9)
    refused_with(name, np.inf)


@pytest.mark.fast
def test_break_away_friction_is_at_least_that_of_sliding():
    refused_with("friction.static", 0.009)


def refused_with(name, value):
    """A published loop is refused before it runs, with the name of the value."""
    timing = Timing(lap_time=values.PERIOD, dt=T, duration=2 * T, scored=0)
    case = build(law("cascade"), version(""), timing)
    *outer, field = name.split(".")
    plant = case.scenario.plant
    inner = replace(getattr(plant, outer[0]) if outer else plant, **{field: jnp.full(1, value)})
    plant = replace(plant, **{outer[0]: inner}) if outer else inner
    scenario = replace(case.scenario, plant=plant)
    with pytest.raises(ValueError, match=f"plant.{name}"):
        simulate(case.loop, case.gains, scenario, case.path, 2)
