"""Gradients of the contour error: both modes against each other and against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from jaxstage.controllers import cmac_sliding, gaussian, per_axis
from jaxstage.gradients import FORWARD_LIMIT, grad_check, kinks, select, value_and_gradient
from jaxstage.metrics import contour
from jaxstage.numerics.smooth import SmoothWidth, creeping, smooth
from jaxstage.plants import pmsm_table
from jaxstage.sensors import Encoder, encoder

GAINS = ("c1", "r1", "sigma", "m", "eta")
ALL = (*GAINS, "gains.weights")
WEIGHT_STEP = {"gains.weights": 0.1}


def dfcmac(contour_name, smoothed, duration=1.0):
    """The published loop on a 1 s lap, or its smooth form that never changes the cell."""
    timing = js.Timing(lap_time=1.0, duration=duration, scored=0)
    case = js.build(f"dfcmac-{contour_name}", timing)
    loop = js.replace(case.loop, metric=contour, segment=100)
    gains, scenario = case.gains, case.scenario
    if smoothed:
        law = per_axis(cmac_sliding(gaussian, smooth))
        loop = js.replace(loop, plant=pmsm_table(friction=creeping), controller=law)
        gains = js.replace(
            gains,
            switch=SmoothWidth(width=jnp.full(2, 1e-2)),
            error_width=gains.error_width * 100,
            rate_width=gains.rate_width * 100,
        )
        matched = js.replace(scenario.start, velocity=jnp.ones(2))
        scenario = js.replace(scenario, start=matched)
    return loop, gains, scenario, case.path, case.window.ticks


def check(contour_name, smoothed, names, step):
    loop, gains, scenario, path, ticks = dfcmac(contour_name, smoothed)

    def objective(gains, scenario):
        return js.simulate(loop, gains, scenario, path, ticks).report.contour_rms * 1e6

    return grad_check(loop, gains, scenario, path, objective, names, step, WEIGHT_STEP)


@pytest.mark.parametrize("contour_name", ["circle", "heart"])
def test_smooth_forms(contour_name):
    """Reverse = forward to 1e-10, central differences to 1e-6, all gains and 72 weights."""
    found = check(contour_name, True, ALL, 1e-4)
    assert len(found.rows) == 10 + 72
    assert found.mode_error() < 1e-10
    assert found.difference_error() < 1e-6
    acting = [row for row in found.rows if row.name.startswith("gains.weights") and row.forward]
    assert len(acting) == 8  # one cell of four hypercubes an axis, as it was set up


@pytest.mark.parametrize("contour_name", ["circle", "heart", "star"])
def test_exact_forms(contour_name, capsys):
    """Reverse = forward to 1e-8; the share of right signs against a 1 % step is printed."""
    found = check(contour_name, False, ALL, 1e-2)
    assert found.mode_error() < 1e-8
    assert all(np.isfinite([row.forward, row.reverse]).all() for row in found.rows)
    tuned = [row for row in found.rows if not row.name.startswith("gains.weights")]
    weights = [row for row in found.rows if row.name.startswith("gains.weights")]
    reached = sum(row.forward != 0 for row in weights)
    signs = np.mean([row.forward * row.difference > 0 for row in tuned])
    with capsys.disabled():
        print(
            f"\n{contour_name}: sign agrees with a 1 % step for {signs:.0%} of 10 gains, "
            f"{found.sign_share():.0%} of all that act; {reached} of 72 weights act"
        )
    assert signs >= 0.8
    if contour_name != "circle":
        assert reached >= 8


def test_kinks_are_named_by_stage():
    loop, gains, scenario, path, _ = dfcmac("circle", False)
    names = dict(line.split(": ") for line in kinks(loop, gains, scenario, path))
    assert names == {"control": "cell, sign, within", "plant": "clamp"}


def test_a_lost_run_is_refused():
    loop, gains, scenario, path, _ = dfcmac("circle", False)
    gains = js.replace(gains, rate=jnp.full(2, 1e6))

    def objective(gains, scenario):
        return js.simulate(loop, gains, scenario, path, 2000).report.contour_rms

    with pytest.raises(ValueError, match="the run was lost"):
        grad_check(loop, gains, scenario, path, objective, ("c1",))


def test_the_gradient_passes_an_encoder():
    """Its staircase would cut the feedback; with the slope of its ramp the gradient is right."""
    case = js.build("cascade-circle", js.Timing(lap_time=1.0, duration=0.5, scored=0))
    loop = js.replace(case.loop, metric=contour, sensor=encoder)
    gains = js.replace(
        case.gains,
        position_gain=jnp.full(2, 60.0),
        velocity_gain=jnp.full(2, 400.0),
        integral_gain=jnp.full(2, 1e4),
    )
    seen = Encoder(resolution=jnp.asarray(25e-9), bandwidth=jnp.asarray(500.0))
    scenario = js.replace(case.scenario, sensor=seen)

    def objective(gains, scenario):
        run = js.simulate(loop, gains, scenario, case.path, case.window.ticks)
        return run.report.contour_rms * 1e6

    found = grad_check(loop, gains, scenario, case.path, objective, ("k_p", "k_s"), step=1e-2)
    assert found.mode_error() < 1e-8
    assert found.difference_error() < 0.02
    assert "quantise" in dict(line.split(": ") for line in found.kinks)["sense"]


def test_the_text_of_a_check_holds_every_parameter():
    found = check("circle", True, ("c1", "r1"), 1e-4)
    text = found.text()
    for row in found.rows:
        assert row.name in text
    assert "kinks" in text and "gains.slope[0]" in text


@pytest.mark.parametrize("start", ["rest", "zero error", "saturation"])
def test_no_nan_in_special_places(start):
    """Gradients at rest, at zero error, through reversals and at a saturated drive are finite."""
    loop, gains, scenario, path, _ = dfcmac("circle", False, duration=0.6)
    if start == "zero error":
        still = jax.tree.map(lambda x: x, path)
        setpoint = jax.tree.map(lambda x: jnp.zeros_like(x), path.setpoint)
        position = jnp.broadcast_to(path.setpoint.position[:1], path.setpoint.position.shape)
        tangent = jnp.broadcast_to(path.setpoint.tangent[:1], path.setpoint.tangent.shape)
        path = js.replace(still, setpoint=js.replace(setpoint, position=position, tangent=tangent))
    if start == "saturation":
        from jaxstage.drives import CurrentDrive, current_drive

        loop = js.replace(loop, drive=current_drive(2))
        drive = CurrentDrive(limit=jnp.full(2, 0.36), delay=jnp.asarray(1.0), lag=jnp.asarray(0.0))
        scenario = js.replace(scenario, drive=drive)
    chosen = select(gains, scenario, (*ALL, "plant.mass", "start.offset"))

    def objective(x):
        report = js.simulate(loop, *chosen.rebuild(x), path, 6000).report
        return report.contour_rms

    for forward in (True, False):
        value, slope = jax.jit(value_and_gradient(objective, forward))(chosen.vector)
        assert np.isfinite(value) and np.isfinite(slope).all()


def test_the_mode_follows_the_number_of_parameters():
    seen = []

    @jax.custom_jvp
    def probe(x):
        return jnp.sum(x**2)

    @probe.defjvp
    def _(primals, tangents):
        seen.append(1)
        return probe(*primals), jnp.sum(2 * primals[0] * tangents[0])

    few, many = jnp.ones(FORWARD_LIMIT), jnp.ones(FORWARD_LIMIT + 1)
    for x in (few, many):
        value, slope = value_and_gradient(probe)(x)
        np.testing.assert_allclose(slope, 2 * x)
        np.testing.assert_allclose(value, x.size)


def memory_of_gradient(ticks, segment, runs=1):
    """Bytes that the compiled reverse-mode gradient of some runs needs beside its inputs."""
    loop, gains, scenario, path, _ = dfcmac("circle", False)
    loop = js.replace(loop, segment=segment)

    def objective(slope):
        moved = js.replace(gains, slope=slope)
        return js.simulate(loop, moved, scenario, path, ticks).report.contour_rms

    slopes = jnp.ones((runs, 2))
    compiled = jax.jit(jax.vmap(jax.grad(objective))).lower(slopes).compile()
    return compiled.memory_analysis().temp_size_in_bytes


def test_gradient_memory_grows_like_the_root_of_the_run():
    plain = memory_of_gradient(10_000, 0)
    short = memory_of_gradient(10_000, 100)
    long = memory_of_gradient(160_000, 400)
    assert short < plain / 20
    assert long < 6 * short  # 16 times the ticks, 4 times the root


def test_a_long_gradient_of_64_runs_fits_in_a_gigabyte():
    assert memory_of_gradient(100_000, 316, runs=64) < 1e9
