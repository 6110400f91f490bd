"""Gradients of the contour error: both modes against each other and against differences."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from jaxstage.controllers import cmac_sliding, gaussian, per_axis, sliding
from jaxstage.hardware.drives import CurrentDrive, current_drive
from jaxstage.hardware.sensors import Encoder, encoder
from jaxstage.metrics import contour, tracking
from jaxstage.numerics.smooth import SmoothWidth, creeping, smooth
from jaxstage.plants import pmsm_table
from jaxstage.simulate.gradients import (
    FORWARD_LIMIT,
    DerivativeRow,
    GradCheck,
    grad_check,
    kinks,
    select,
    value_and_gradient,
)
from tests.helpers.batteries import stacked

pytestmark = pytest.mark.long

GAINS = ("c1", "r1", "sigma", "m", "eta")
ALL = (*GAINS, "gains.weights")
#: the weights are 0
WEIGHT_STEP = 0.1


@functools.cache
def dfcmac(contour_name, smoothed):
    """The published loop on a 1 s lap, or its smooth form that never changes the cell."""
    timing = js.Timing(lap_time=1.0, duration=1.0, scored=0)
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


SMOOTH, EXACT = ("circle", "heart"), ("circle", "heart", "star")


@functools.cache
def checks(smoothed, names, step, stepped, segment):
    """What `grad_check` gives, on several contours in one program; differences for the first
    ``stepped`` parameters only."""
    loop, gains, scenario, _, ticks = dfcmac("circle", smoothed)
    loop = js.replace(loop, segment=segment, engine=js.scan)
    chosen = select(gains, scenario, ALL)
    x = chosen.vector
    scale = np.where(x != 0, np.abs(x), WEIGHT_STEP)
    moves = np.diag(step * scale)[:stepped]

    @jax.jit
    @jax.vmap
    def derivatives(path):
        def objective(x):
            run = js.simulate(loop, *chosen.rebuild(x), path, ticks)
            return run.report.contour_rms * 1e6

        value, reverse = value_and_gradient(objective, forward=False)(x)
        _, forward = value_and_gradient(objective, forward=True)(x)
        ends = jax.vmap(objective)(x[None] + np.concatenate([moves, -moves]))
        difference = (ends[:stepped] - ends[stepped:]) / (2 * step * scale[:stepped])
        return value, reverse, forward, difference

    lanes = derivatives(stacked([dfcmac(name, False)[3] for name in names]))
    found = {}
    for i, name in enumerate(names):
        value, reverse, forward, difference = (np.asarray(lane)[i] for lane in lanes)
        difference = np.pad(difference, (0, x.size - stepped), constant_values=np.nan)
        rows = map(DerivativeRow, chosen.names, x, reverse, forward, difference)
        found[name] = GradCheck(value, step, tuple(rows), ())
    return found


@pytest.mark.parametrize("contour_name", SMOOTH)
def test_smooth_forms(contour_name):
    """Reverse = forward to 1e-10, central differences to 1e-6, all gains and 72 weights."""
    found = checks(True, SMOOTH, 1e-4, 10 + 72, segment=100)[contour_name]
    assert len(found.rows) == 10 + 72
    assert found.mode_error() < 1e-10
    assert found.difference_error() < 1e-6
    acting = [row for row in found.rows if row.name.startswith("gains.weights") and row.forward]
    assert len(acting) == 8  # one cell of four hypercubes an axis, as it was set up


@pytest.mark.parametrize("contour_name", EXACT)
def test_exact_forms(contour_name, capsys):
    """Reverse = forward to 1e-8; the share of right signs against a 1 % step is printed."""
    found = checks(False, EXACT, 1e-2, 10, segment=0)[contour_name]
    assert found.mode_error() < 1e-8
    assert all(np.isfinite([row.forward, row.reverse]).all() for row in found.rows)
    tuned = [row for row in found.rows if not row.name.startswith("gains.weights")]
    weights = [row for row in found.rows if row.name.startswith("gains.weights")]
    reached = sum(row.forward != 0 for row in weights)
    signs = np.mean([row.forward * row.difference > 0 for row in tuned])
    with capsys.disabled():
        print(
            f"\n{contour_name}: sign agrees with a 1 % step for {signs:.0%} of 10 gains; "
            f"{reached} of 72 weights act"
        )
    assert signs >= 0.8
    if contour_name != "circle":
        assert reached >= 8


def test_kinks_are_named_by_stage():
    loop, gains, scenario, path, _ = dfcmac("circle", False)
    names = dict(line.split(": ") for line in kinks(loop, gains, scenario, path))
    assert names == {"control": "cell, sign, within", "plant": "clamp"}


def quick(name, metric, duration=0.1, **changes):
    """A loop over a part of a lap, and its inputs."""
    case = js.build(name, js.Timing(lap_time=1.0, duration=duration, scored=0))
    loop = js.replace(case.loop, metric=metric, **changes)
    return loop, case.gains, case.scenario, case.path, case.window.ticks


def test_a_lost_run_is_refused():
    loop, gains, scenario, path, ticks = quick("pi-circle", tracking)
    start = js.replace(scenario.start, offset=jnp.full(2, 2 * loop.path_limit))
    scenario = js.replace(scenario, start=start)

    def objective(gains, scenario):
        return js.simulate(loop, gains, scenario, path, ticks).report.ate

    with pytest.raises(ValueError, match="the run was lost"):
        grad_check(loop, gains, scenario, path, objective, ("c1",))


def test_the_gradient_passes_an_encoder():
    """Its staircase would cut the feedback; with the slope of its ramp the gradient is right."""
    loop, gains, scenario, path, ticks = quick("cascade-circle", contour, 0.5, sensor=encoder)
    gains = js.replace(
        gains,
        position_gain=jnp.full(2, 60.0),
        velocity_gain=jnp.full(2, 400.0),
        integral_gain=jnp.full(2, 1e4),
    )
    seen = Encoder(resolution=jnp.asarray(25e-9), bandwidth=jnp.asarray(500.0))
    scenario = js.replace(scenario, sensor=seen)

    def objective(gains, scenario):
        run = js.simulate(loop, gains, scenario, path, ticks)
        return run.report.contour_rms * 1e6

    found = grad_check(loop, gains, scenario, path, objective, ("k_p", "k_s"), step=1e-2)
    assert found.mode_error() < 1e-8
    assert found.difference_error() < 0.02
    assert "quantise" in dict(line.split(": ") for line in found.kinks)["sense"]


def test_a_check_steps_by_scales_and_its_text_holds_every_parameter():
    """A smooth loop; the offset at the start is 0 and steps by the scale it is given."""
    law, plant = per_axis(sliding(smooth)), pmsm_table(friction=creeping)
    loop, gains, scenario, path, ticks = quick(
        "sliding-circle", tracking, controller=law, plant=plant
    )
    gains = js.replace(gains, switch=SmoothWidth(width=jnp.full(2, 1e-2)))

    def objective(gains, scenario):
        return js.simulate(loop, gains, scenario, path, ticks).report.ate * 1e6

    names, scales = ("c1", "start.offset"), {"start.offset": 1e-3}
    found = grad_check(loop, gains, scenario, path, objective, names, 1e-4, scales)
    assert len(found.rows) == 4 and all(row.forward != 0 for row in found.rows)
    assert found.mode_error() < 1e-10
    assert found.difference_error() < 1e-6
    text = found.text()
    for row in found.rows:
        assert row.name in text
    assert "kinks" in text and "gains.slope[0]" in text


@functools.cache
def everywhere():
    """Both modes over the exact loop behind a drive, as a function of start and path."""
    loop, gains, scenario, _, _ = dfcmac("circle", False)
    loop = js.replace(loop, drive=current_drive(2))

    @jax.jit
    def slopes(drive, path):
        chosen = select(gains, js.replace(scenario, drive=drive), MOVING)

        def objective(x):
            return js.simulate(loop, *chosen.rebuild(x), path, 6000).report.contour_rms

        return [value_and_gradient(objective, mode)(chosen.vector) for mode in (True, False)]

    return slopes


MOVING = (*ALL, "plant.mass", "start.offset")
IDEAL = CurrentDrive(limit=np.full(2, np.inf), delay=np.array(0.0), lag=np.array(0.0))
WEAK = CurrentDrive(limit=np.full(2, 0.36), delay=np.array(1.0), lag=np.array(0.0))


@pytest.mark.parametrize("start", ["rest", "zero error", "saturation"])
def test_no_nan_in_special_places(start):
    """Gradients at rest, at zero error, through reversals and at a saturated drive are finite."""
    path = dfcmac("circle", False)[3]
    if start == "zero error":
        setpoint = jax.tree.map(jnp.zeros_like, path.setpoint)
        position = jnp.broadcast_to(path.setpoint.position[:1], path.setpoint.position.shape)
        tangent = jnp.broadcast_to(path.setpoint.tangent[:1], path.setpoint.tangent.shape)
        path = js.replace(path, setpoint=js.replace(setpoint, position=position, tangent=tangent))
    drive = WEAK if start == "saturation" else IDEAL
    for value, slope in everywhere()(drive, path):
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


def memory_of_gradient(loop, gains, scenario, path, ticks, segment, runs=1):
    """Bytes that the reverse-mode gradient of some runs needs beside its inputs, as a scan."""
    loop = js.replace(loop, segment=segment, engine=js.scan)

    def objective(slope):
        moved = js.replace(gains, slope=slope)
        report = js.simulate(loop, moved, scenario, path, ticks).report
        return report.ate if loop.metric is tracking else report.contour_rms

    slopes = jnp.ones((runs, 2))
    compiled = jax.jit(jax.vmap(jax.grad(objective))).lower(slopes).compile()
    return compiled.memory_analysis().temp_size_in_bytes


def test_gradient_memory_grows_like_the_root_of_the_run():
    inputs = quick("pi-circle", tracking)[:4]
    plain = memory_of_gradient(*inputs, 10_000, 0)
    short = memory_of_gradient(*inputs, 10_000, 100)
    long = memory_of_gradient(*inputs, 160_000, 400)
    assert short < plain / 20
    assert long < 6 * short  # 16 times the ticks, 4 times the root


def test_a_long_gradient_of_64_runs_fits_in_a_gigabyte():
    inputs = dfcmac("circle", False)[:4]
    assert memory_of_gradient(*inputs, 100_000, 316, runs=64) < 1e9
