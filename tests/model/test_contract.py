"""The signatures carry another machine: three axes on a helix, an encoder, dead time, lag, limits,
a load inside the integrator, an observer beside a contour law."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.controllers import (
    Offset,
    cross_coupled,
    disturbance_observer,
    offset_setpoint,
    per_axis,
    pid_contour,
    plus,
    sliding,
)
from jaxstage.hardware.drives import current_drive
from jaxstage.metrics import following, together, tracking
from jaxstage.model.fields import replace
from jaxstage.numerics.smooth import smooth
from jaxstage.plants import pmlsm_stage
from jaxstage.references import make_path, nurbs, sampled, uniform_parameter
from jaxstage.simulate.rollout import _simulate, simulate
from tests.helpers.batteries import Lead, ahead, tracing
from tests.helpers.three_axes import DT, HELIX, LAW, PATH, currents, gains, loop, scenario, watched


def test_everything_at_once_is_finite_and_on_the_path():
    run = simulate(loop(together(tracking, following)), gains(), scenario(), PATH, 1500)
    assert run.final.left_path_at == run.final.non_finite_at == -1
    assert run.report["following"].following_rms.shape == (3,)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(run.report))
    assert run.report["tracking"].ate < 2e-4


# --- delay, lag, saturation ------------------------------------------------------------------


def test_delay_is_data():
    """Four delays in one compilation; the command reaches the plant that many periods later."""
    traced = []
    fixed = loop(tracing(currents))

    @jax.jit
    def run(delay):
        traced.append(1)
        one = scenario()
        one = replace(one, drive=replace(one.drive, delay=delay))
        return simulate(fixed, gains(), one, PATH, 100).rows

    _, command, applied = jax.vmap(run)(jnp.arange(4.0))
    assert len(traced) == 1
    for delay in range(4):
        np.testing.assert_array_equal(applied[delay, :delay], 0)
        np.testing.assert_array_equal(applied[delay, delay:], command[delay, : 100 - delay])
        alone = run(jnp.asarray(float(delay)))
        np.testing.assert_allclose(alone[2], applied[delay], rtol=1e-7, atol=1e-9)
    assert np.abs(command[0] - command[3]).max() > 1e-3, "the loop never felt the delay"


def test_limit_then_delay_then_lag():
    limit, lag = 0.6, 1e-3
    rows = simulate(loop(tracing(watched)), gains(), scenario(limit, 2.0, lag), PATH, 200).rows
    demand, command, applied = map(np.asarray, rows[0])
    assert (np.abs(demand) > limit).any()
    np.testing.assert_array_equal(command, np.clip(demand, -limit, limit))
    late = np.concatenate([np.zeros((2, 3)), command[:-2]])
    lagged, left = np.zeros(3), np.exp(-DT / lag)
    for k in range(200):
        expected = late[k] + (1 - left) * lag / DT * (lagged - late[k])
        np.testing.assert_allclose(applied[k], expected, atol=1e-13)
        lagged = late[k] + left * (lagged - late[k])


# --- start, offset, paths --------------------------------------------------------------------


@pytest.mark.fast
def test_start_offset_and_matched_velocity():
    scene = scenario(resolution=0.0)
    scene = replace(scene, start=replace(scene.start, velocity=np.array([0.0, 1.0, 0.5])))
    _, output, seen = simulate(loop(tracing(watched)), gains(), scene, PATH, 200).rows
    r = np.array([0.05, 0, 0]) + np.array([-1e-4, 0, -5e-5])
    v = np.array([0, 0.05 * 4 * np.pi, 0.01]) * [0, 1, 0.5]
    np.testing.assert_allclose(output.position[0], r, atol=1e-15)
    np.testing.assert_allclose(output.velocity[0], v, atol=1e-15)
    # the encoder knows the velocity at the start; from then on it differences
    np.testing.assert_allclose(seen.velocity[0], v, atol=1e-15)
    np.testing.assert_allclose(seen.velocity[1:], np.diff(output.position, axis=0) / DT, atol=1e-11)


def _distance(sample):
    return sample.setpoint.position, sample.output.position


def test_offset_setpoint_moves_the_tool_not_the_metric():
    """A law that leads by tau r' puts the tool there; the sliding surface lets it in with 1/c."""
    law = offset_setpoint(LAW, "lead", ahead)
    base = loop(tracing(_distance), law, substeps=1)
    slow, time, count = PATH | {"rate": jnp.asarray(1.0)}, 5e-3, 4000
    (r0, x0), (r1, x1) = (
        simulate(base, Offset(law=gains(0.0), offset=Lead(time=t)), scenario(), slow, count).rows
        for t in (0.0, time)
    )
    np.testing.assert_array_equal(r0, r1)
    velocity = np.gradient(np.asarray(r0), DT, axis=0)
    moved, expected = np.asarray(x1 - x0), np.zeros((count, 3))
    slope = np.asarray(gains().law.law.slope)
    for k in range(1, count):  # (x - r)' = c (tau r' - (x - r))
        pull = slope * (time * velocity[k - 1] - expected[k - 1])
        expected[k] = expected[k - 1] + DT * pull
    np.testing.assert_allclose(moved[2000:], expected[2000:], atol=0.02 * np.abs(expected).max())
    assert np.abs(moved[-1] - time * velocity[-1]).max() < 0.1 * time * np.abs(velocity).max()


def test_a_curve_in_space():
    """A stored 3-D NURBS lap: the same loop, another reference."""
    curve = nurbs(
        [(0, 0, 0), (0.02, 0, 0.01), (0.02, 0.02, 0), (0, 0.02, -0.01), (0, 0, 0)],
        (0, 0, 0, 1 / 3, 2 / 3, 1, 1, 1),
    )
    path = make_path(curve, uniform_parameter(0.2, DT))
    run = simulate(loop(reference=sampled), gains(), scenario(), path, 1000)
    assert run.final.left_path_at == -1
    assert 0 < run.report.ate < 5e-4


# --- end to end under the transforms ---------------------------------------------------------


def test_jit_vmap_grad_through_everything():
    """By gains, plant, lag, sensor and path at once: finite, forward equal to reverse, equal to
    differences along the gains."""
    base = loop(reference=HELIX, segment=20)

    def score(numbers, scene, path):
        run = simulate(base, numbers, scene, path, 60)
        return 1e6 * run.report.ate

    scene = scenario(delay=2.0, lag=5e-4, resolution=0.0, amplitude=2.0)
    numbers = jax.tree.map(jnp.asarray, gains())
    moving = (scene.plant, scene.load, scene.drive.lag, scene.sensor.bandwidth)

    def of(numbers, moving, path):
        plant, load, lag, bandwidth = moving
        changed = replace(
            scene, plant=plant, load=load, drive=replace(scene.drive, lag=lag),
            sensor=replace(scene.sensor, bandwidth=bandwidth),
        )  # fmt: skip
        return score(numbers, changed, path)

    moving = jax.tree.map(jnp.asarray, (*moving[:3], 2000.0))
    args = (numbers, moving, PATH)

    @jax.jit
    def both(args, direction):
        return jax.grad(lambda a: of(*a))(args), jax.jvp(lambda a: of(*a), (args,), (direction,))

    direction = jax.tree.map(lambda x: 0.01 * x, args)
    reverse, (_, forward) = both(args, direction)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(reverse))
    pairs = zip(jax.tree.leaves(reverse), jax.tree.leaves(direction), strict=True)
    np.testing.assert_allclose(sum(np.vdot(a, b) for a, b in pairs), forward, rtol=1e-8)
    h = 1e-4
    up, down = (
        both(jax.tree.map(lambda x, d, s=s: x + s * d, args, direction), direction)[1][0]
        for s in (h, -h)
    )
    np.testing.assert_allclose((up - down) / (2 * h), forward, rtol=1e-5)


def test_a_population_is_vmap_over_gains_and_loads():
    base = loop()
    stiff = jnp.asarray([500.0, 1000.0])
    loads = jnp.asarray([[20.0, 15, 10], [-5.0, 0, 5]])

    def score(k, bias):
        scene = scenario()
        scene = replace(scene, load=replace(scene.load, bias=bias))
        return simulate(base, gains(k), scene, PATH, 100).report.ate

    many = jax.jit(jax.vmap(score))(stiff, loads)
    single = [float(score(k, b)) for k, b in zip(stiff, loads, strict=True)]
    np.testing.assert_allclose(many, single, rtol=1e-8)
    assert many[0] != many[1]


def test_equal_loops_share_one_compilation():
    sizes = []
    for _ in range(2):
        law = cross_coupled(
            plus(per_axis(sliding(smooth)), per_axis(disturbance_observer)), pid_contour()
        )
        again = loop(controller=law, drive=current_drive(3), plant=pmlsm_stage(), dt=DT)
        simulate(again, gains(), scenario(), PATH, 100)
        sizes.append(_simulate._cache_size())
    assert sizes[0] == sizes[1] > 0
