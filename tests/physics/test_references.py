"""Timing on integer ticks, stored laps, motions computed inside the tick."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxstage.model.fields import replace
from jaxstage.references import (
    analytic,
    bowknot,
    circle,
    constant_feed,
    derivatives,
    heart,
    make_path,
    mean_feed,
    nurbs,
    nurbs_lap,
    points,
    sampled,
    star,
    uniform_parameter,
)
from jaxstage.references.nurbs import in_span
from jaxstage.references.timing import ticks

CURVES = [circle, bowknot, heart, star]


def whole(path):
    return jax.tree.map(np.asarray, path.setpoint)


@pytest.mark.parametrize("lap_time", [1.0, 5.0])
@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_knots_take_the_right_limit_in_every_lap(lap_time, precision):
    """Four laps: the tick on a knot has the velocity of the span that begins there."""
    curve, dt = star(), 1e-4
    count = round(lap_time / dt)
    with jax.enable_x64(precision == np.float64):
        path = make_path(curve, uniform_parameter(lap_time, dt), dtype=precision)
        single = jax.tree.map(lambda x: jnp.asarray(x, precision), curve)
        inner = np.unique(curve.knots)[:-1]
        at = np.concatenate(
            [np.round(inner * count).astype(np.int32) + k * count for k in range(4)]
        )
        stored = jax.vmap(sampled.sample, (None, 0))(path, at)
        made = jax.jit(jax.vmap(nurbs_lap(count, dt).sample, (None, 0)))(single, at)
    spans = np.searchsorted(curve.knots, np.tile(inner, 4), side="right") - 1
    _, first, second = in_span(curve, spans, np.tile(inner, 4))
    assert stored.velocity.dtype == made.velocity.dtype == precision
    size = np.abs(second).max() / lap_time**2
    for got in (stored, made):
        np.testing.assert_allclose(got.velocity, first / lap_time, atol=1e-6)
        np.testing.assert_allclose(got.acceleration, second / lap_time**2, atol=1e-5 * size)


def test_one_tick_before_a_knot_is_still_before_it():
    curve, count = star(), 10_000
    made = ticks(curve, uniform_parameter(1.0, 1e-4))
    for knot in np.unique(curve.knots)[1:-1]:
        k = round(knot * count)
        assert curve.knots[made.span[k] + 1] > knot == curve.knots[made.span[k]]
        assert curve.knots[made.span[k - 1] + 1] == knot


def test_knots_that_are_not_round_numbers():
    """A knot range that is no power of two, with knots on ticks only up to rounding."""
    count, last = 1000, 7.3
    inner = [0.1 * last, 0.3 * last, 0.7 * last]
    rng = np.random.default_rng(0)
    curve = nurbs(rng.normal(size=(6, 2)), [0, 0, 0, *inner, last, last, last])
    made = ticks(curve, uniform_parameter(1.0, 1e-3))
    np.testing.assert_array_equal(made.span[[99, 100, 299, 300, 699, 700]], [2, 3, 3, 4, 4, 5])
    with jax.enable_x64(False):
        sample = jax.jit(jax.vmap(nurbs_lap(count, 1e-3).sample, (None, 0)))
        got = sample(curve, np.arange(count, dtype=np.int32)).acceleration
    expected = in_span(curve, made.span, made.u)[2] * last**2
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("curve", CURVES)
def test_uniform_parameter_is_the_published_timing(curve):
    setpoint = whole(make_path(curve(), uniform_parameter(5.0, 1e-3)))
    u = np.arange(5000) / 5000
    value, first, second = jax.jit(jax.vmap(derivatives, (None, 0)))(curve(), u)
    np.testing.assert_allclose(setpoint.position, value, atol=1e-16)
    np.testing.assert_allclose(setpoint.velocity, first / 5, rtol=1e-13, atol=1e-17)
    np.testing.assert_allclose(setpoint.acceleration, second / 25, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("timing", [uniform_parameter(1.0, 1e-4), constant_feed(9000.0, 1e-4)])
@pytest.mark.parametrize("curve", [circle, star])
def test_velocity_and_acceleration_are_derivatives(curve, timing):
    path = make_path(curve(), timing)
    s, dt = whole(path), float(path.lap_time) / len(path.search.corner)
    slope = (s.position[2:] - s.position[:-2]) / (2 * dt)
    bend = (s.position[2:] - 2 * s.position[1:-1] + s.position[:-2]) / dt**2
    away = ticks(curve(), timing).span  # not across a knot
    same = (away[2:] == away[:-2]) & (away[2:] == away[1:-1])
    same[-1] = False
    np.testing.assert_allclose(slope[same], s.velocity[1:-1][same], atol=2e-6)
    np.testing.assert_allclose(bend[same], s.acceleration[1:-1][same], atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(s.tangent, axis=1), 1, rtol=1e-14)
    speed = np.linalg.norm(s.velocity, axis=1, keepdims=True)
    np.testing.assert_allclose(s.velocity, speed * s.tangent, atol=1e-15)


def test_curvature():
    s = whole(make_path(circle(), uniform_parameter(1.0, 1e-3)))
    np.testing.assert_allclose(s.curvature, 40, rtol=1e-12)
    s = whole(make_path(star(), constant_feed(3000.0, 1e-3)))
    a = np.linalg.norm(s.acceleration, axis=1)
    v = np.linalg.norm(s.velocity, axis=1)
    np.testing.assert_allclose(a, s.curvature * v * v, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("curve", CURVES)
def test_constant_feed(curve):
    dt, feed = 1e-3, 1234.5
    path = make_path(curve(), constant_feed(feed, dt))
    s, count = whole(path), len(path.search.corner)
    actual = float(mean_feed(path))
    np.testing.assert_allclose(np.linalg.norm(s.velocity, axis=1), actual, rtol=1e-12)
    assert float(path.lap_time) == count * dt
    assert abs(float(path.length) / (feed / 6e4) / dt - count) <= 0.5
    made = ticks(curve(), constant_feed(feed, dt))
    np.testing.assert_allclose(made.arc, actual * dt * np.arange(count), rtol=1e-12)
    if curve is circle:
        angle = actual * dt * np.arange(count) / 0.025
        exact = 0.025 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        np.testing.assert_allclose(s.position, exact, atol=1e-15)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_timing_refuses(bad):
    for make in (uniform_parameter, constant_feed):
        with pytest.raises(ValueError, match="must be finite and > 0"):
            make(bad, 1e-4)
        with pytest.raises(ValueError, match="dt must be finite and > 0 s"):
            make(1.0, bad)


def test_timing_refuses_what_cannot_be_sampled():
    with pytest.raises(ValueError, match="lap_time must be >= dt"):
        uniform_parameter(1e-4, 1e-3)
    with pytest.raises(ValueError, match=r"feed must be <= .* mm/min"):
        make_path(circle(), constant_feed(1e9, 1e-3))
    with pytest.raises(ValueError, match="window must be in"):
        make_path(circle(), uniform_parameter(1.0, 1e-3), window=0.3)


@pytest.mark.fast
@pytest.mark.parametrize("size", [1e-320, 1e-12, 1e-3])
def test_a_lap_of_too_many_ticks_is_refused_by_the_name_of_its_setting(size):
    """Before anything is made: up to more ticks than a float can count."""
    with pytest.raises(ValueError, match=r"^feed = .* mm/min gives a lap of .* s at dt = 1e-09 s"):
        make_path(circle(), constant_feed(size, 1e-9))
    lap_time = min(1 / size, 1e308)
    with pytest.raises(ValueError, match=r"^lap_time = .* s gives .* must be <= .* s at this dt$"):
        uniform_parameter(lap_time, 1e-9)


def test_path_is_made_in_double_whatever_the_precision_of_jax():
    wide = make_path(heart(), uniform_parameter(1.0, 1e-3))
    with jax.enable_x64(False):
        narrow = make_path(heart(), uniform_parameter(1.0, 1e-3))
        assert {x.dtype.name for x in jax.tree.leaves(narrow)} == {"float32", "int32", "bool"}
    for a, b in zip(jax.tree.leaves(wide), jax.tree.leaves(narrow), strict=True):
        np.testing.assert_array_equal(np.asarray(a, b.dtype), b)


def test_laps_repeat_and_nothing_is_promoted():
    with jax.numpy_dtype_promotion("strict"), jax.numpy_rank_promotion("raise"):
        path = make_path(star(), uniform_parameter(1.0, 1e-2), dtype=np.float32)
        sample = jax.jit(sampled.sample)
        for k in (0, 37, 99):
            jax.tree.map(np.testing.assert_array_equal, sample(path, k), sample(path, k + 300))
        curve = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), star())
        tool, k = jnp.zeros(2, jnp.float32), jnp.int32(37)
        line = analytic("circle", ring, 1e-3)
        for reference, params in (
            (sampled, path), (nurbs_lap(100, 1e-2), curve), (line, jnp.float32(0.1))
        ):  # fmt: skip
            out = jax.eval_shape(reference.sample, params, k)
            out = out, jax.eval_shape(reference.nearest, params, k, tool)
            assert {leaf.dtype.name for leaf in jax.tree.leaves(out)} == {"float32"}


def test_open_curve():
    curve = nurbs([(0, 0), (1, 0), (1, 1)], (0, 0, 0, 1, 1, 1))
    path = make_path(curve, uniform_parameter(1.0, 1e-2))
    assert not path.closed
    assert make_path(circle(), uniform_parameter(1.0, 1e-2)).closed
    np.testing.assert_array_equal(path.setpoint.position[0], (0, 0))


def test_tangent_where_the_parametric_velocity_is_zero():
    """Doubled end points: C' = 0 at both ends, and the curve is a straight line."""
    curve = nurbs([(0, 0), (0, 0), (3, 4), (3, 4)], (0, 0, 0, 0.5, 1, 1, 1))
    for timing in (uniform_parameter(1.0, 1e-2), constant_feed(3e4, 1e-2)):
        s = whole(make_path(curve, timing))
        np.testing.assert_allclose(s.tangent, np.tile([0.6, 0.8], (len(s.tangent), 1)), atol=1e-12)
        np.testing.assert_allclose(s.curvature, 0, atol=1e-9)
        assert np.isfinite(s.acceleration).all()
    made = jax.jit(nurbs_lap(100, 1e-2).sample)(curve, 0)
    np.testing.assert_allclose(made.tangent, [0.6, 0.8], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(made.velocity), 0, atol=1e-15)


@pytest.mark.parametrize("curve", [circle, heart])
def test_nurbs_lap_equals_the_stored_lap(curve):
    count = 1000
    path = make_path(curve(), uniform_parameter(1.0, 1e-3))
    made = jax.jit(jax.vmap(nurbs_lap(count, 1e-3).sample, (None, 0)))(curve(), np.arange(count))
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-11), made, path.setpoint
    )


def test_each_run_of_a_batch_may_have_its_own_curve():
    base, scale = star(), np.array([1.0, 1.5, 0.3])
    same = jax.tree.map(lambda x: np.stack([x] * 3), base)
    many = replace(same, control_points=same.control_points * scale[:, None, None])
    got = jax.jit(jax.vmap(nurbs_lap(50, 0.1).sample, (0, None)))(many, 7)
    one = jax.jit(nurbs_lap(50, 0.1).sample)(base, 7)
    np.testing.assert_allclose(got.velocity, np.outer(scale, one.velocity), rtol=1e-13)
    np.testing.assert_allclose(got.tangent, np.stack([one.tangent] * 3), rtol=1e-12)


def ring(radius, time):
    return radius * jnp.stack([jnp.cos(time), jnp.sin(time)])


def swing(params, time):
    return jnp.stack([params["a"] * jnp.sin(params["w"] * time), params["b"] * time**2])


def test_analytic_motion():
    params = {"a": 0.02, "w": 3.0, "b": 0.1}
    s = jax.tree.map(np.asarray, jax.jit(analytic("swing", swing, 1e-3).sample)(params, 400))
    t, w = 0.4, 3.0
    np.testing.assert_allclose(s.position, [0.02 * np.sin(w * t), 0.1 * t * t], rtol=1e-14)
    np.testing.assert_allclose(s.velocity, [0.06 * np.cos(w * t), 0.2 * t], rtol=1e-14)
    np.testing.assert_allclose(s.acceleration, [-0.18 * np.sin(w * t), 0.2], rtol=1e-14)
    v, a = s.velocity, s.acceleration
    speed = np.hypot(*v)
    assert s.curvature == pytest.approx(abs(v[0] * a[1] - v[1] * a[0]) / speed**3, rel=1e-12)
    np.testing.assert_allclose(s.tangent, v / speed, rtol=1e-14)


def test_analytic_motion_at_rest():
    def frame(params):
        s = analytic("swing", swing, 1e-3).sample(params, 0)
        return s.curvature + s.tangent[1], s

    start = {"a": 0.0, "w": 3.0, "b": 0.1}  # from rest, along y
    slope, s = jax.jit(jax.grad(frame, has_aux=True))(start)
    np.testing.assert_array_equal(s.tangent, [0, 1])
    assert s.curvature == 0
    assert all(np.isfinite(g) for g in jax.tree.leaves(slope))


def test_equal_arguments_give_the_identical_definition():
    assert analytic("swing", swing, 1e-3) is analytic("swing", swing, 1e-3)
    assert nurbs_lap(100, 1e-3) is nurbs_lap(100, 1e-3)
    assert nurbs_lap(100, 1e-3) != nurbs_lap(101, 1e-3)
    with pytest.raises(ValueError, match="ticks_per_lap must be >= 1"):
        nurbs_lap(0, 1e-3)


def test_sampling_is_differentiable_in_the_curve():
    lap = nurbs_lap(100, 1e-2)
    velocity = jax.jit(lambda v: lap.sample(replace(star(), control_points=v), 33).velocity)
    check_grads(velocity, (star().control_points,), order=1, rtol=1e-6)


def test_host_points_follow_the_path():
    path = make_path(bowknot(), constant_feed(5000.0, 1e-3))
    u = ticks(bowknot(), constant_feed(5000.0, 1e-3)).u
    np.testing.assert_allclose(path.setpoint.position, points(bowknot(), u), atol=1e-16)


@pytest.mark.fast
@pytest.mark.parametrize("place", [0, 1, 2, 3])
@pytest.mark.parametrize("closed", [False, True])
def test_two_equal_points_in_a_row_leave_the_polyline_as_it_is(place, closed):
    """A triangle of 40, 30 and 50 mm, or a U: exact length, the same setpoints, nearest points."""
    corners = [(0, 0), (0.04, 0), (0.04, 0.03), (0.0, 0.0 if closed else 0.03)]
    twice = [*corners[: place + 1], *corners[place:]]
    line = lambda points: nurbs(points, [0, *range(len(points)), len(points) - 1], degree=1)  # noqa: E731
    for timing in (constant_feed(1200, 1e-3), uniform_parameter(1.0, 1e-3)):
        plain, path = make_path(line(corners), timing), make_path(line(twice), timing)
        exact = np.linalg.norm(np.diff(np.array(corners), axis=0), axis=1).sum()
        np.testing.assert_allclose(path.length, exact, rtol=1e-14)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(path))
        np.testing.assert_allclose(np.linalg.norm(path.setpoint.tangent, axis=1), 1, rtol=1e-12)
        if timing is constant_feed(1200, 1e-3):
            np.testing.assert_allclose(path.setpoint.position, plain.setpoint.position, atol=1e-15)
            np.testing.assert_allclose(path.setpoint.velocity, plain.setpoint.velocity, atol=1e-12)
            tool = plain.setpoint.position[700] + 1e-4
            for kept in (plain, path):
                near = sampled.nearest(kept, jnp.asarray(700), tool)
                assert near.distance > 0
            np.testing.assert_allclose(
                near.point, sampled.nearest(plain, jnp.asarray(700), tool).point, atol=1e-14
            )
