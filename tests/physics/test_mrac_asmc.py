"""Adaptive sliding mode, model-reference control and what they are measured with, by theory."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.controllers import (
    cascade,
    difference,
    forward,
    model_reference,
    moving,
    per_axis,
    position_feedforward,
    position_input,
    sliding,
)
from jaxstage.controllers.adaptive_sliding import adaptive_sliding, sampled_gain, switch
from jaxstage.hardware.sensors import Encoder, encoder, ideal_sensor, motor_side
from jaxstage.metrics import drive, drive_following, quadrant_glitch, record, together
from jaxstage.metrics.spectrum import amplitude_spectrum, chattering_amplitude
from jaxstage.model.fields import replace
from jaxstage.model.signals import Output
from jaxstage.numerics.smooth import SmoothWidth, smooth
from jaxstage.plants import on_motor
from jaxstage.references import step, stepping, swing, swinging
from jaxstage.simulate.rollout import replay
from jaxstage.studies.case import Timing, with_metric
from jaxstage.studies.experiment import simulate_all
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.mrac_asmc.loops import build, law, oscillation, version
from jaxstage.studies.mrac_asmc.traces import adaptive_law, gains_of, stepped
from tests.helpers.batteries import seen, setpoint

pytestmark = pytest.mark.long

T, S = values.DT, values.RATIO
J, J1 = 3.362e-4, 2.85e-4


def one(tree):
    """Gains of one axis as scalars."""
    return jax.tree.map(lambda x: jnp.asarray(x)[0], tree)


def axis(r, v, a, y, w):
    """Setpoint and measurement of one axis, all scalars, from numbers in rad."""
    wanted, measured = setpoint([r / S], [v / S], [a / S]), seen([y / S], [w / S])
    strip = lambda tree: jax.tree.map(lambda x: x[0] if x.ndim else x, tree)  # noqa: E731
    return strip(wanted), strip(measured)


# --- adaptive sliding mode -------------------------------------------------------------------


@pytest.mark.fast
def test_switch_values():
    assert switch(jnp.asarray(50.0), jnp.asarray(0.03)) == pytest.approx(0.63514895, abs=5e-9)
    assert switch(jnp.asarray(1000.0), jnp.asarray(-1e9)) == -1
    a, s = jnp.asarray(7.0), jnp.asarray([-0.3, 0.0, 0.2])
    np.testing.assert_allclose(switch(a, s), 2 / (1 + np.exp(-7.0 * s)) - 1, rtol=1e-14)


@pytest.mark.fast
@pytest.mark.parametrize(
    ("input_sign", "signs"),
    [
        (forward, (1, 1)),
        (position_input, (1, -1)),
        (moving, (-1, -1)),
        (difference, (0, 1)),
    ],
    ids=lambda x: getattr(x, "name", ""),
)
def test_adaptive_law_by_hand(input_sign, signs):
    """Two samples in the paper's units; the sign may need the command of this very sample."""
    rule, gains = adaptive_sliding(input_sign), one(values.sim2())
    c, eps, a = 30.0, 230.0, 50.0
    samples = ((0.3, -1.1, -2.0, 0.29, -1.2, 0.04), (0.2995, -1.1005, -2.0, 0.289, -1.0, -0.5))
    memory = rule.init(gains, *axis(*samples[0][:5]))
    for (r, v, acc, y, w, command), q in zip(samples, signs, strict=True):
        demand, memory = rule.control(gains, memory, *axis(r, v, acc, y, w), T)
        e, ed = r - y, v - w
        s = c * e + ed
        phi = np.tanh(a * s / 2)
        np.testing.assert_allclose(demand, J * (acc + c * ed + eps * phi), rtol=1e-10)
        memory = rule.settle(gains, memory, demand, jnp.asarray(command), T)
        c, eps, a = c + T * 3000 * s * ed, eps + T * 500 * e * q * phi, a + T * 10 * e * q * s
        np.testing.assert_allclose(memory.slope, c, rtol=1e-12)
        np.testing.assert_allclose(memory.switching_gain * S, eps, rtol=1e-12)
        np.testing.assert_allclose(memory.sharpness / S, a, rtol=1e-12)


@pytest.mark.fast
def test_what_adapts_stays_in_its_range():
    """Far too fast rates take each to one end or the other, by the signs of s e' and e s."""
    gains = one(values.asmc(caps=True))
    fast = replace(gains, slope_rate=jnp.asarray(1e20), sharpness_rate=jnp.asarray(1e25))
    rule = adaptive_sliding()
    for error, rate, slope, sharpness in (
        (1e-3, 0.1, 300.0, 60.0), (1e-2, -0.1, 1.0, 60.0), (1e-3, -0.6, 300.0, 1e-3)
    ):  # fmt: skip
        where = axis(0.3, -1.1, 0.0, 0.3 - error, -1.1 - rate)
        demand, memory = rule.control(fast, rule.init(fast, *where), *where, T)
        memory = rule.settle(fast, memory, demand, demand, T)
        assert memory.slope == slope
        assert memory.sharpness / S == pytest.approx(sharpness, rel=1e-12)


@pytest.mark.fast
def test_not_adapting_it_is_the_sigmoid_law():
    """`sliding` with the `smooth` switch of width 2/a is equation (12)."""
    fixed = one(values.sigmoid())
    other = one(values.sliding_mode(230, SmoothWidth(width=values.value(2 / (50 * S)))))
    other = replace(other, slope=fixed.slope)
    where = axis(0.3, -1.1, -2.0, 0.2999, -1.104)
    adaptive, sigmoid = adaptive_sliding(), sliding(smooth)
    demands = [
        rule.control(gains, rule.init(gains, *where), *where, T)[0]
        for rule, gains in ((adaptive, fixed), (sigmoid, other))
    ]
    np.testing.assert_allclose(*demands, rtol=1e-12)


@pytest.mark.fast
def test_sampled_gain_and_its_note():
    assert sampled_gain(250.0, 230.0, 50.0, T) == pytest.approx(2.76 + 0.12)
    timing = Timing(lap_time=4.0, dt=T, duration=2 * T, scored=0)
    ends = lambda value: {"sampled_gain_end": {"x": value}}  # noqa: E731
    (note,) = oscillation(build(law("asmc-mrac"), version(""), timing), ends(2.9))
    assert "2.88" in note and "1.695" in note and "1042 Hz" in note
    assert oscillation(build(law("cascade"), version(""), timing), {}) == ()
    half = replace(timing, dt=T / 2, duration=T)
    assert oscillation(build(law("asmc-mrac"), version(""), half), ends(1.45)) == ()


@pytest.mark.fast
def test_the_note_looks_at_the_end_of_the_run_too():
    """The first simulation starts below the limit of 1.695; ten times that is run away."""
    case = build(law("sim1"), version(""), Timing(lap_time=4.0, dt=T, duration=2 * T, scored=0))
    for lost in ({}, {"sampled_gain_end": None}, {"sampled_gain_end": {"x": None}}):
        assert oscillation(case, lost) == ()
    assert oscillation(case, {"sampled_gain_end": {"x": 1.69}}) == ()
    (note,) = oscillation(case, {"sampled_gain_end": {"x": 16.9}})
    assert "0.0264 at the start and 16.9 at the end" in note
    ended = {"sampled_gain_end": {"x": 17.0}, "sharpness_end_s_per_m": {"x": 2.55e7}}
    _, away = oscillation(case, ended | {"drive_following_max_um": {"x": 488.0}})
    assert "run away" in away and "a from 5e+03 to 2.55e+07 s/m" in away and "488 um" in away


def test_the_sampled_limit_is_where_the_loop_begins_to_oscillate():
    """A motor alone: e' moves by -T J/J1 (c e' + k s), k = eps a/2, and e by its mean, so that
    (z - 1)^2 + g (z - 1) + h (z + 1) = 0, g = T (k + c) J/J1, h = T^2 k c/2 J/J1: z = -1 at g = 2,
    which is 2 J1/J. 1 % below it the command decays, 1 % above it grows."""
    limit, cases, factors = 2 * J1 / J, {}, {}
    for name, share in (("below", 0.99), ("above", 1.01)):
        a = 2 * (share * limit - 250 * T) / (230 * T)
        assert sampled_gain(250.0, 230.0, a, T) == pytest.approx(share * limit)
        case = stepped(adaptive_law(), gains_of(values.sigmoid(a)), version(""), 1e-13, 400 * T)
        g, h = 2 * share, T**2 * 230 * a / 2 * 250 / 2 * J / J1
        factors[name] = np.abs(np.roots([1, g + h - 2, 1 - g + h])).max()
        plant = replace(
            case.scenario.plant, stiffness=jnp.full(1, 1e-12), damping=jnp.zeros(1)
        )  # the load hangs on nothing and rests
        cases[name] = case._replace(scenario=replace(case.scenario, plant=plant))
    for name, run in simulate_all(cases).items():
        command = np.asarray(run.rows["command"])[100:, 0]
        assert (command[1:] * command[:-1] < 0).all()
        growth = abs(command[-1] / command[0]) ** (1 / (len(command) - 1))
        assert growth == pytest.approx(factors[name], abs=1e-6)
        assert (growth > 1) == (name == "above")


# --- model-reference control -----------------------------------------------------------------


@functools.cache
def on_a_rigid_axis():
    """MRAC around a given u_c on a rigid axis: velocity error of the model and weights, from the
    true terms (viscous, dry, constant) and a factor on the rates."""
    ticks, dt, width = 50_000, 2e-5, 0.05 / S
    given = replace(cascade, control=lambda gains, memory, wanted, measured, h: (gains, memory))
    rule, gains = model_reference(given), one(values.inner(values.cascade_gains()))
    wanted, measured = axis(0, 0, 0, 0, 0)

    def run(true, factor):
        rates = jax.tree.map(lambda x: x * factor, gains.rates)

        def tick(carry, k):
            v, memory = carry
            asked = J * 200 * jnp.sin(40 * k * dt)
            here = replace(measured, velocity=v)
            law = replace(gains, law=asked, rates=rates)
            u, kept = rule.control(law, memory, wanted, here, dt)
            drag = true[0] * v + true[1] * jnp.tanh(v / width) + true[2]
            return (v + dt * (u / (J * S) - drag), kept), (v - memory.model, memory.weights)

        begin = rule.init(replace(gains, law=jnp.zeros(())), wanted, measured)
        return jax.lax.scan(tick, (jnp.zeros(()), begin), jnp.arange(ticks))[1]

    return jax.jit(run), gains


@pytest.mark.fast
@pytest.mark.parametrize("true", [(3.0, 0.02, 0.01), (0.0, 0.0, 0.01)])
def test_model_reference_lyapunov_function_falls(true):
    """V = e_m^2/2 + sum (W - W*)^2/(2 g) never rises, and e_m is smaller than without."""
    run, gains = on_a_rigid_axis()
    error, weights = run(jnp.asarray(true), 1.0)
    rates = gains.rates
    v = np.asarray(error) ** 2 / 2
    for found, value, rate in (
        (weights.viscous, true[0], rates.viscous), (weights.dry, true[1], rates.dry),
        (weights.constant, true[2], rates.constant),
    ):  # fmt: skip
        v = v + (np.asarray(found) - value) ** 2 / (2 * float(rate))
    assert (np.diff(v) < 1e-6 * v[0]).all() and v[-1] < 0.1 * v[0]
    free, _ = run(jnp.asarray(true), 0.0)
    assert np.abs(error[-5000:]).max() < 0.3 * np.abs(free[-5000:]).max()


@pytest.mark.fast
def test_model_reference_without_rates_is_transparent_and_with_them_is_not():
    inner = adaptive_sliding()
    where = axis(0.3, -1.1, -2.0, 0.2999, -1.104)
    plain, _ = inner.control(one(values.asmc()), inner.init(one(values.asmc()), *where), *where, T)
    rule = model_reference(inner)
    demands = {}
    for active in (False, True):
        gains = one(values.inner(values.asmc(), active))
        memory = rule.init(gains, *where)
        memory = replace(memory, model=memory.model + 1e-3)
        for _ in range(2):
            demands[active], memory = rule.control(gains, memory, *where, T)
    np.testing.assert_allclose(demands[False], plain, rtol=1e-15)
    assert abs(demands[True] / plain - 1) > 1e-3


@pytest.mark.fast
def test_model_reference_goes_around_one_axis_or_several():
    """Inside `per_axis` and outside of it it is the same; the totals reach the law."""
    gains = jax.tree.map(
        lambda x: jnp.stack([x[0], 1.1 * x[0]]), values.inner(values.cascade_gains())
    )
    wanted, measured = setpoint([0.02, -0.01], [0.1, -0.2]), seen([0.019, -0.01], [0.11, -0.18])
    found = []
    for rule in (per_axis(model_reference(cascade)), model_reference(per_axis(cascade))):
        memory = rule.init(gains, wanted, measured)
        for _ in range(3):
            demand, memory = rule.control(gains, memory, wanted, measured, T)
            memory = rule.settle(gains, memory, demand, 0.5 * demand, T)
        found.append((demand, memory))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-13), *found)
    whole = per_axis(cascade)
    kept = whole.control(gains.law, whole.init(gains.law, wanted, measured), wanted, measured, T)[1]
    assert (np.abs(found[0][1].law.integral / (3 * kept.integral) - 1) > 1e-3).all()


@pytest.mark.fast
def test_position_feedforward_shifts_the_position_along_the_velocity():
    rule, gains = (
        position_feedforward(per_axis(cascade)),
        values.ahead(values.cascade_gains(), 2e-6),
    )
    gains = jax.tree.map(jnp.asarray, gains)
    plain = per_axis(cascade)
    measured = seen([1e-3], [0.0])
    for velocity, shift in ((-0.1, -2e-6), (0.0, 0.0), (0.2, 2e-6)):
        wanted = setpoint([1e-3], [velocity], [0.5])
        moved = setpoint([1e-3 + shift], [velocity], [0.5])
        demand, _ = rule.control(gains, rule.init(gains, wanted, measured), wanted, measured, T)
        same, _ = plain.control(
            gains.law, plain.init(gains.law, moved, measured), moved, measured, T
        )
        np.testing.assert_allclose(demand, same, rtol=1e-12)


# --- sensor, references ----------------------------------------------------------------------


@pytest.mark.fast
def test_motor_side_puts_the_motor_in_the_place_of_the_tool():
    """Through the encoder too: 0.5 um steps, half up, and a velocity that starts true."""
    truth = [
        Output(
            position=jnp.full(1, -9e-3), velocity=jnp.full(1, -9.0),
            drive_position=jnp.full(1, x * 1e-6), drive_velocity=jnp.full(1, 0.25),
        )
        for x in (1.2, 1.25, 2.6)
    ]  # fmt: skip
    key = jax.random.key(0)
    exact, _ = motor_side(ideal_sensor).read((), (), key, truth[0], T)
    assert exact.position == exact.drive_position == truth[0].drive_position
    assert exact.velocity == exact.drive_velocity == 0.25
    rule = motor_side(encoder)
    params = Encoder(resolution=jnp.asarray(5e-7), bandwidth=jnp.asarray(200.0))
    memory, speed = rule.init(params, truth[0]), 0.25
    places = (1.0e-6, 1.5e-6, 2.5e-6)
    for k, output in enumerate(truth):
        read, memory = rule.read(params, memory, key, output, T)
        np.testing.assert_allclose(read.position, places[k], rtol=1e-12)
        if k:
            difference = (places[k] - places[k - 1]) / T
            speed += (1 - np.exp(-2 * np.pi * 200 * T)) * (difference - speed)
        np.testing.assert_allclose(read.velocity, speed, rtol=1e-12)
    assert motor_side(encoder) is rule


@pytest.mark.fast
def test_swing_and_step():
    reference, path = swinging(T), jax.tree.map(jnp.asarray, swing(1e-3, 4.0))
    t, w = 1234 * T, np.pi / 2
    found = reference.sample(path, jnp.asarray(1234))
    np.testing.assert_allclose(found.position, 1e-3 * (1 + np.cos(w * t)), rtol=1e-14)
    np.testing.assert_allclose(found.velocity, -1e-3 * w * np.sin(w * t), rtol=1e-13)
    np.testing.assert_allclose(found.acceleration, -1e-3 * w**2 * np.cos(w * t), rtol=1e-13)
    assert reference.sample(path, jnp.asarray(0)).velocity == 0
    held = stepping(T).sample(jax.tree.map(jnp.asarray, step(5e-4)), jnp.asarray(7))
    assert held.position == 5e-4 and held.velocity == 0 and held.acceleration == 0
    for wrong in ((0.0, 4.0), (1e-3, 0.0), (np.nan, 4.0), (1e-3, np.inf), (-1.0, 1.0)):
        with pytest.raises(ValueError, match="must be finite and > 0"):
            swing(*wrong)
    with pytest.raises(ValueError, match="height must be finite"):
        step(np.nan)


# --- metrics ---------------------------------------------------------------------------------


@pytest.mark.fast
def test_amplitude_of_a_sine():
    """The amplitude in its own bin, half of it beside; the largest above a frequency."""
    dt, count = 1e-3, 2000
    t = dt * jnp.arange(count)
    values_ = 3.0 + 2.0 * jnp.sin(2 * jnp.pi * 10 * t) + 0.5 * jnp.cos(2 * jnp.pi * 80 * t)
    frequency, amplitude = amplitude_spectrum(values_, dt)
    np.testing.assert_allclose(frequency[:3], [0, 0.5, 1.0])
    np.testing.assert_allclose(amplitude[19:22], [1.0, 2.0, 1.0], rtol=1e-10)
    np.testing.assert_allclose(amplitude[160], 0.5, rtol=1e-10)
    both = jnp.stack([values_, 2 * values_], axis=1)
    np.testing.assert_allclose(chattering_amplitude(both, dt), [0.5, 1.0], rtol=1e-10)
    np.testing.assert_allclose(chattering_amplitude(both, dt, 5.0), [2.0, 4.0], rtol=1e-10)


def test_drive_metrics_are_those_of_the_motor():
    """Online figures of a run against its record, and against the tool's metrics there."""
    timing = Timing(lap_time=0.4, dt=T, substeps=2, duration=0.5, scored=0)
    case = build(law("cascade"), version("-motor"), timing)
    assert "motor" in case.loop.plant.name and on_motor.name == "motor"
    both = together(drive_following, quadrant_glitch(0.05, drive), quadrant_glitch(0.05))
    run = with_metric(case, together(both, record)).simulate()
    rows, report = run.rows["record"], run.report["together"]
    error = np.asarray(rows.setpoint.position - rows.output.drive_position)
    figures = report["drive_following"]
    np.testing.assert_allclose(figures.drive_following_rms, np.sqrt((error**2).mean(axis=0)))
    np.testing.assert_allclose(figures.drive_following_mean, np.abs(error).mean(axis=0))
    np.testing.assert_allclose(figures.drive_following_max, np.abs(error).max(axis=0))
    np.testing.assert_allclose(figures.drive_following_variance, error.var(axis=0), rtol=1e-9)
    on_tool = replace(rows, output=replace(rows.output, position=rows.output.drive_position))
    same, _ = replay(quadrant_glitch(0.05), on_tool, T)
    glitch = report["drive_quadrant_glitch"]
    np.testing.assert_allclose(glitch.drive_glitch_max, same.glitch_max, rtol=1e-12)
    np.testing.assert_array_equal(glitch.drive_reversals, same.reversals)
    assert glitch.drive_glitch_max != report["quadrant_glitch"].glitch_max
