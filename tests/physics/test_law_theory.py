"""Laws by their theory: reaching, layers of switching, anti-windup."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxstage.controllers import cascade, per_axis, pi, sliding
from jaxstage.hardware.drives import CurrentDrive, current_drive
from jaxstage.model.blocks import keep
from jaxstage.model.fields import replace
from jaxstage.numerics.smooth import Layer, exact, implicit
from jaxstage.simulate.rollout import simulate
from jaxstage.studies.fuzzy_cmac.loops import cascade_gains, pi_gains, sliding_gains
from tests.helpers.batteries import DT, cast, table_loop, tracing
from tests.helpers.law_bench import CASES, bench


def slid_variables(sample):
    return sample.memory.surface, sample.command


def followed(sample):
    return sample.output.position - sample.setpoint.position, sample.command != sample.demand


@pytest.fixture(scope="module")
def reaching():
    """|s| (m/s) of the ideal sliding law from rest, for a gain eta and a bound D."""
    loop, scenario, path = table_loop(per_axis(sliding(exact)), metric=tracing(slid_variables))

    def surfaces(eta, bound=1.0):
        gains = sliding_gains()
        gains = replace(
            gains,
            switching_gain=np.full(2, eta),
            disturbance_bound=bound * gains.disturbance_bound,
        )
        run = simulate(loop, gains, scenario, path, 2000)
        return np.abs(run.rows[0]), eta + np.asarray(gains.disturbance_bound)

    return surfaces


@pytest.mark.parametrize("eta", [1.0, 5.0])
def test_sliding_variable_falls_at_least_at_eta(reaching, eta):
    surface, full = reaching(eta)
    bound = np.asarray(sliding_gains().disturbance_bound)
    for axis in range(2):
        s = surface[:, axis]
        outside = s[:-1] > (full + bound)[axis] * DT
        fall = (s[:-1] - s[1:])[outside] / DT
        if s[0] > 0.1:
            assert outside.sum() > 100, "nothing to reach"
        assert (fall >= 0.9 * eta).all()


def test_a_bound_below_the_friction_does_not_reach(reaching):
    """Half the bound: the friction wins, s does not fall at eta; the law above can fail."""
    surface, _ = reaching(1.0, bound=0.5)
    start = int(np.argmax(surface[0] > 0.1))
    assert (surface[:1000, start] - surface[1:1001, start]).min() / DT < 0.9


@pytest.fixture(scope="module")
def slid():
    """max |s| once reached, full switching gain, bound D, and variation of u, per axis."""
    results = {}
    for name, switch, params in (
        ("exact", exact, ()),
        ("implicit", implicit, Layer(layer=np.ones(2))),
    ):
        loop, scenario, path = table_loop(
            per_axis(sliding(switch)), metric=tracing(slid_variables), period=5.0
        )
        gains = replace(sliding_gains(), switch=params)
        surface, command = simulate(loop, gains, scenario, path, 100_000).rows
        surface = np.abs(surface)
        bound = np.asarray(gains.disturbance_bound)
        full = bound + np.asarray(gains.switching_gain)
        first = [int(np.argmax(surface[:, i] <= full[i] * DT)) for i in range(2)]
        largest = np.array([surface[first[i] :, i].max() for i in range(2)])
        varied = np.abs(np.diff(command[50_000:], axis=0)).sum(axis=0) / 5.0
        results[name] = (largest, full, bound, varied)
    return results


def test_reached_it_stays_within_one_period_of_switching(slid):
    """|s| <= (eta_D + D) Ts with sgn, and comes near; about eta_D Ts with the implicit form."""
    largest, full, bound, _ = slid["exact"]
    assert (largest <= (full + bound) * DT).all()
    assert (largest > 0.98 * (full + bound) * DT).all()
    largest, full, _, _ = slid["implicit"]
    np.testing.assert_allclose(largest, full * DT, rtol=2e-3)


def test_implicit_switching_hardly_varies_the_command(slid):
    """Total variation per second in the second lap; the four numbers are an independent model's."""
    np.testing.assert_allclose(slid["exact"][3], [2.60, 2.17], rtol=5e-3)
    np.testing.assert_allclose(slid["implicit"][3], [0.202, 0.169], rtol=5e-3)


def overshoot(law, gains, limit, offset=-0.002, count=3000):
    """Largest following error of y beyond its setpoint, from ``offset`` m, behind a weak drive."""
    loop, scenario, path = table_loop(
        per_axis(law), metric=tracing(followed), drive=current_drive()
    )
    scenario = replace(
        scenario,
        drive=CurrentDrive(limit=np.full(2, limit), delay=0.0, lag=0.0),
        start=replace(scenario.start, offset=np.array([0.0, offset])),
    )
    beyond, cut = simulate(loop, gains, scenario, path, count).rows
    assert cut.any(), "the drive never saturated"
    return float(beyond[:, 1].max())


def test_cascade_does_not_wind_up():
    """2 mm off behind a drive that can just move: no overshoot, but millimetres for a deaf law."""
    gains = cascade_gains()
    assert overshoot(cascade, gains, 0.45) < 1e-6
    assert overshoot(replace(cascade, settle=keep), gains, 0.45) > 1e-3


def windup(law, gains, count):
    """Memory after ``count`` periods with a fixed error behind a drive of 0.1 A."""
    axis, (wanted, measured) = per_axis(law), bench(CASES["far off"])

    @jax.jit
    def after(gains):
        def period(memory, _):
            demand, memory = axis.control(gains, memory, wanted, measured, DT)
            command = jnp.clip(demand, -0.1, 0.1)
            return axis.settle(gains, memory, demand, command, DT), None

        return lax.scan(period, axis.init(gains, wanted, measured), None, count)[0]

    return after(gains)


def test_cascade_integral_ends_at_the_limit():
    """Back-calculation has one fixed point: the integral alone gives the limit, b u = k_i I."""
    gains = cast(
        replace(
            cascade_gains(),
            velocity_feedforward=np.zeros(2),
            acceleration_feedforward=np.zeros(2),
            friction_feedforward=np.zeros(2),
            load_feedforward=np.zeros(2),
            integral_gain=np.full(2, 1e7),
        )
    )
    axis = gains.nominal
    limit = 0.1 * axis.force_constant / axis.mass / gains.integral_gain
    held = np.abs(windup(cascade, gains, 120).integral)
    np.testing.assert_allclose(held, limit, rtol=1e-6)
    deaf = np.abs(windup(replace(cascade, settle=keep), gains, 120).integral)
    assert (deaf > 100 * held).all()


def test_pi_settles_on_the_command_it_was_given():
    """After a cut the integral IS the command of the drive: it leaves the limit at once."""
    gains = cast(pi_gains())
    np.testing.assert_allclose(np.abs(windup(pi, gains, 5).command), 0.1, rtol=1e-12)
    assert (np.abs(windup(replace(pi, settle=keep), gains, 5).command) > 10).all()
