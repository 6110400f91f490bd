"""The contour error against dense brute force: corners, closure, both precisions, gradients."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline

from jaxstage.numerics.geometry import (
    dot,
    norm,
    normal_part,
    projection_step,
    signed_side,
    unit,
)
from jaxstage.references import (
    analytic,
    bowknot,
    circle,
    constant_feed,
    heart,
    make_path,
    nurbs,
    nurbs_lap,
    sampled,
    star,
    uniform_parameter,
)
from jaxstage.references.nurbs import degree
from tests.helpers.batteries import one_size

pytestmark = pytest.mark.long

CURVES = {f.__name__: f for f in (circle, bowknot, heart, star)}
NM = 1e-9


@functools.cache
def dense_curve(name):
    """A published curve, and its `polyline`."""
    return CURVES[name](), polyline(CURVES[name]())


def polyline(curve, segments=800_000):
    """Dense points of a curve and the arc length at each, by scipy."""
    w = curve.weights[:, None]
    spline = BSpline(curve.knots, np.hstack([curve.control_points * w, w]), degree(curve))
    u = np.union1d(np.linspace(curve.knots[0], curve.knots[-1], segments + 1), curve.knots)
    h = spline(u)
    p = h[:, :-1] / h[:, -1:]
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1)))
    return u, p, arc


def brute(p, arc, commanded, tool, closed=True, window=0.01):
    """Distance of one point to the polyline within the window of commanded arc length."""
    best, length = np.inf, arc[-1]
    for lap in (-1, 0, 1) if closed else (0,):
        a = max(np.searchsorted(arc + lap * length, commanded - window * length) - 1, 0)
        b = np.searchsorted(arc + lap * length, commanded + window * length) + 1
        if len(p[a:b]) < 2:
            continue
        d, far = np.diff(p[a:b], axis=0), tool - p[a:b][:-1]
        f = np.clip((far * d).sum(1) / np.maximum((d * d).sum(1), 1e-300), 0, 1)
        best = min(best, np.linalg.norm(far - f[:, None] * d, axis=1).min())
    return best


def trials(curve, count, corners, size=3e-4, seed=0):
    """Ticks over the whole lap and around the given phases; tools up to ``size`` m off."""
    rng = np.random.default_rng(seed)
    reach = max(count // 80, 1)
    near = [(round(c * count) + rng.integers(-reach, reach + 1, 25)) % count for c in corners]
    tick = np.concatenate([rng.integers(0, count, 60), *near]).astype(np.int32)
    away = rng.normal(size=(len(tick), curve.control_points.shape[1]))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    return tick, away * rng.uniform(0, size, (len(tick), 1)) * (rng.random((len(tick), 1)) < 0.9)


near = jax.jit(jax.vmap(sampled.nearest, (None, 0, 0)))


def distances(path, tick, tool):
    return near(path, np.asarray(tick, np.int32), tool).distance


#: phases of knots: corners, seams, and where nothing happens
KNOTS = {
    "circle": (0, 0.5, 0.7), "bowknot": (0, 0.25, 0.5), "heart": (0, 0.5, 0.7),
    "star": (0, 0.1, 0.8),
}  # fmt: skip
#: curves without and with corners; the tables of a pair are given one size, to compile once
PAIRS = (("circle", "bowknot"), ("heart", "star"))


@functools.cache
def pair_of_laps(names, timing):
    return one_size([make_path(CURVES[name](), timing(name)) for name in names])


def lap(name, timing):
    """A lap of a published curve; timing: from its name to a timing."""
    (names,) = (pair for pair in PAIRS if name in pair)
    return pair_of_laps(names, timing)[names.index(name)]


def coarse(name):
    return uniform_parameter(1.0, 1e-3)


def fine(name):
    return uniform_parameter(5.0, 1e-4)


def even(name):
    """1000 ticks at constant feed."""
    return constant_feed(6e4 * dense_curve(name)[1][2][-1], 1e-3)


@pytest.fixture(scope="module", params=CURVES)
def dense(request):
    """Name, curve, polyline, and a coarse lap of 1000 ticks."""
    return request.param, *dense_curve(request.param), lap(request.param, coarse)


def test_nearest_equals_brute_force(dense):
    """To 0.1 nm in double and 10 nm in single precision, at fine and coarse sampling."""
    name, _, (u, p, arc), path = dense
    for path, known in (
        (lap(name, fine), u), (lap(name, even), arc / arc[-1]), (lap(name, coarse), u)
    ):  # fmt: skip
        count = len(path.search.corner)
        tick, away = trials(CURVES[name](), count, KNOTS[name])
        tool = np.asarray(path.setpoint.position)[tick] + away
        at = np.interp(tick / count, known, arc)
        expected = np.array([brute(p, arc, s, x) for s, x in zip(at, tool, strict=True)])
        np.testing.assert_allclose(distances(path, tick, tool), expected, atol=0.1 * NM)
        assert float(path.table_error) < 1e-11
    single = jax.tree.map(lambda x: x.astype(np.float32) if x.dtype == np.float64 else x, path)
    got = distances(single, tick, tool.astype(np.float32))
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, expected, atol=10 * NM)


def test_large_errors_in_the_window(dense):
    """1 mm off, where the nearest point may be at the end of the window."""
    name, curve, (u, p, arc), path = dense
    tick, away = trials(curve, 1000, KNOTS[name], size=1e-3, seed=1)
    tool = np.asarray(path.setpoint.position)[tick] + away
    at = np.interp(tick / 1000, u, arc)
    expected = np.array([brute(p, arc, s, x) for s, x in zip(at, tool, strict=True)])
    np.testing.assert_allclose(distances(path, tick, tool), expected, atol=1 * NM)


@pytest.mark.parametrize("name", ["bowknot", "star"])
def test_nurbs_lap_equals_brute_force(name):
    curve, (u, p, arc) = dense_curve(name)
    tick, away = trials(curve, 1000, KNOTS[name], seed=2)
    made = nurbs_lap(1000, 1e-3)

    @jax.jit
    @jax.vmap
    def both(tick, away):
        tool = made.sample(curve, tick).position + away
        return tool, made.nearest(curve, tick, tool)

    tool, got = jax.tree.map(np.asarray, both(tick, away))
    at = np.interp(tick / 1000, u, arc)
    expected = np.array([brute(p, arc, s, x) for s, x in zip(at, tool, strict=True)])
    np.testing.assert_allclose(got.distance, expected, atol=0.1 * NM)
    behind = (got.arc - at + arc[-1] / 2) % arc[-1] - arc[-1] / 2
    assert np.abs(behind).max() < 4e-4


def test_point_arc_and_distance_belong_together(dense):
    name, curve, (_, p, arc), path = dense
    tick, away = trials(curve, 1000, KNOTS[name], seed=3)
    tool = np.asarray(path.setpoint.position)[tick] + away
    got = jax.tree.map(np.asarray, near(path, tick, tool))
    np.testing.assert_allclose(np.linalg.norm(got.point - tool, axis=1), got.distance, atol=1e-15)
    there = np.stack([np.interp(got.arc % arc[-1], arc, x) for x in p.T], axis=1)
    np.testing.assert_allclose(there, got.point, atol=2 * NM)


def test_circle_has_a_closed_form():
    """Everywhere on the circle, the closure included: | |p| - r |."""
    path = make_path(circle(), uniform_parameter(1.0, 1e-2))
    tick = np.arange(100, dtype=np.int32)
    for off, lag in ((1e-4, 3e-4), (-2e-4, -5e-4), (0.0, 1e-3)):
        angle = np.arctan2(*np.asarray(path.setpoint.position).T[::-1]) + lag / 0.025
        tool = (0.025 + off) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        np.testing.assert_allclose(distances(path, tick, tool), abs(off), atol=0.1 * NM)


@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_both_sides_of_a_corner(precision):
    """A square: outside the corner the distance to it, inside to the nearer of the two sides."""
    square = nurbs(
        np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]) * 0.06, (0, 0, 1, 2, 3, 4, 4), degree=1
    )
    path = make_path(square, uniform_parameter(4.0, 1e-2), dtype=precision)
    away = [(3e-4, -4e-4), (3e-4, 2e-4), (-1e-4, -2e-4), (-1e-4, 3e-4), (-3e-4, 1e-4), (0, 0)]
    expected = [5e-4, 3e-4, 2e-4, 1e-4, 1e-4, 0]
    for tick in (99, 100, 101):
        tool = (np.array([0.06, 0.0]) + np.array(away)).astype(precision)
        got = distances(path, np.full(6, tick), tool)
        np.testing.assert_allclose(got, expected, atol=10 * NM)
    tick = np.array([0, 1, 398, 399, 400, 800])  # around the closure: below the first side
    tool = np.tile(np.array([1e-4, -1e-4], precision), (6, 1))
    np.testing.assert_allclose(distances(path, tick, tool), 1e-4, atol=10 * NM)


def test_many_corners_in_one_window():
    rng = np.random.default_rng(4)
    angle = np.linspace(0, 2 * np.pi, 151)
    corners = (
        0.03 * np.stack([np.cos(angle), np.sin(angle)], axis=1) * rng.uniform(0.98, 1.02, (151, 1))
    )
    corners[-1] = corners[0]
    curve = nurbs(corners, np.concatenate([[0], np.arange(151), [150]]), degree=1)
    path = make_path(curve, constant_feed(5000.0, 1e-2))
    assert path.search.base.shape[1] >= 4
    count = len(path.search.corner)
    _, p, arc = polyline(curve, 150)
    tick, away = trials(curve, count, [0.0])
    tool = np.asarray(path.setpoint.position)[tick] + away
    expected = [brute(p, arc, arc[-1] * k / count, x) for k, x in zip(tick, tool, strict=True)]
    wide = np.array([brute(p, arc, arc[-1] * k / count, x, window=0.0101) for k, x in
                     zip(tick, tool, strict=True)])  # fmt: skip
    # the polyline's own window ends on its vertices, so only what both windows agree on counts
    same = np.abs(wide - expected) < 1e-15
    assert same.mean() > 0.9
    np.testing.assert_allclose(distances(path, tick, tool)[same], wide[same], atol=0.1 * NM)


@pytest.mark.parametrize("axes", [3])
def test_open_curve_in_space(axes):
    rng = np.random.default_rng(6)
    curve = nurbs(np.cumsum(rng.normal(size=(7, axes)), axis=0) * 0.01,
                  (0, 0, 0, 0, 1, 1, 2, 3, 3, 3, 3), rng.uniform(0.5, 2, 7), 3)  # fmt: skip
    path = make_path(curve, uniform_parameter(2.0, 1e-3))
    assert not path.closed
    u, p, arc = polyline(curve)
    tick, away = trials(curve, 2000, (0, 1 / 3, 2 / 3), size=1.5e-4)
    tool = np.asarray(path.setpoint.position)[tick] + away
    at = np.interp(3 * tick / 2000, u, arc)
    expected = [brute(p, arc, s, x, closed=False) for s, x in zip(at, tool, strict=True)]
    np.testing.assert_allclose(distances(path, tick, tool), expected, atol=0.2 * NM)
    lap = jax.jit(jax.vmap(nurbs_lap(2000, 1e-3).nearest, (None, 0, 0)))(curve, tick, tool)
    np.testing.assert_allclose(lap.distance, expected, atol=0.2 * NM)


def test_one_axis():
    """There and back on a line: 0 on it, the overshoot beyond its ends."""
    curve = nurbs([(0.0,), (0.1,), (0.0,)], (0, 0, 0.5, 1, 1), degree=1)
    path = make_path(curve, uniform_parameter(1.0, 1e-3))
    tick = np.array([250, 498, 500, 502, 999, 1000])
    tool = np.array([[0.0501], [0.1003], [0.1003], [0.0999], [-1e-4], [-1e-4]])
    expected = [0, 3e-4, 3e-4, 0, 1e-4, 1e-4]
    np.testing.assert_allclose(distances(path, tick, tool), expected, atol=0.1 * NM)
    assert np.isfinite(reverse(tool, path, tick)).all()


@functools.cache
def sparse_star():
    """A lap of 100 ticks."""
    return make_path(star(), uniform_parameter(1.0, 1e-2))


def test_distance_is_never_below_the_distance_to_the_whole_curve():
    path = sparse_star()
    _, p, _ = polyline(star(), 200_000)
    tick = np.arange(100, dtype=np.int32)
    tool = np.asarray(path.setpoint.position) + np.random.default_rng(0).normal(0, 0.01, (100, 2))
    whole = np.array([np.linalg.norm(p - x, axis=1).min() for x in tool])
    got = distances(path, tick, tool)
    assert np.all(got >= whole - 1e-7)
    assert np.all(got <= np.linalg.norm(tool - path.setpoint.position, axis=1) + 1e-12)


def distance(tool, path, tick):
    return sampled.nearest(path, tick, tool).distance


reverse, forward = (
    jax.jit(jax.vmap(transform(distance), (0, None, 0))) for transform in (jax.grad, jax.jacfwd)
)


def test_gradient_is_the_unit_normal(dense):
    """Envelope theorem: d distance / d tool = (tool - nearest point)/distance, corners included."""
    name, curve, _, path = dense
    tick, away = trials(curve, 1000, KNOTS[name], seed=5)
    tool = np.asarray(path.setpoint.position)[tick] + away
    found = near(path, tick, tool)
    for slope in (reverse, forward) if name == "heart" else (reverse,):
        got = slope(tool, path, tick)
        clear = np.asarray(found.distance) > 1e-6
        normal = (tool - np.asarray(found.point)) / np.asarray(found.distance)[:, None]
        np.testing.assert_allclose(got[clear], normal[clear], atol=1e-4)
        assert np.isfinite(got).all()


def test_gradient_of_the_nearest_point():
    """On the circle dc/dp = (r/|p|) t t^T."""
    path = make_path(circle(), uniform_parameter(1.0, 1e-3))
    tool = jnp.array([0.0249, 0.0003])
    t = np.array([-tool[1], tool[0]]) / np.hypot(*tool)
    got = jax.jit(jax.jacrev(lambda x: sampled.nearest(path, 0, x).point))(tool)
    np.testing.assert_allclose(got, 0.025 / np.hypot(*tool) * np.outer(t, t), atol=1e-5)


def test_gradient_on_the_curve_is_zero_and_finite():
    path = make_path(circle(), uniform_parameter(1.0, 1e-3))
    slope = jax.jit(jax.grad(lambda x: sampled.nearest(path, 0, x).distance))
    got = slope(path.setpoint.position[0])
    np.testing.assert_array_equal(got, 0)


def test_not_a_number_stays_in_its_lane():
    tool = np.tile([0.0, 0.06], (100, 1))
    tool[0, 0] = np.nan
    got = distances(sparse_star(), np.zeros(100, np.int32), tool)
    assert np.isnan(got[0])
    np.testing.assert_allclose(got[1:], 0, atol=1e-12)


def test_smooth_ticks_stay_cheap_under_vmap():
    """The choice depends on path and tick alone: it stays a branch when tools are batched."""
    batched = jax.vmap(sampled.nearest, (None, None, 0))
    assert " cond[" in str(jax.make_jaxpr(batched)(sparse_star(), jnp.int32(3), jnp.ones((5, 2))))
    smooth = make_path(circle(), uniform_parameter(1.0, 1e-2))
    assert " cond[" not in str(jax.make_jaxpr(batched)(smooth, jnp.int32(3), jnp.ones((5, 2))))


def ring(radius, time):
    return radius * jnp.stack([jnp.cos(time), jnp.sin(time), 0 * time])


def test_analytic_nearest():
    move = analytic("ring", ring, 1e-2)
    find = jax.jit(move.nearest)
    for lag, off in ((-0.02, 1e-3), (0.01, -3e-3), (0.0, 0.0)):
        angle = 0.5 + lag
        tool = (0.05 + off) * jnp.array([np.cos(angle), np.sin(angle), 0.0])
        got = find(jnp.float64(0.05), 50, tool)
        assert got.distance == pytest.approx(abs(off), abs=1e-15)
        assert got.arc == pytest.approx(0.05 * lag, abs=1e-15)
        np.testing.assert_allclose(got.point, ring(0.05, angle), atol=1e-15)
    grad = jax.jit(jax.grad(lambda r: move.nearest(r, 50, jnp.array([0.03, 0.0, 0.0])).distance))
    assert grad(jnp.float64(0.02)) == pytest.approx(-1)


def test_vectors():
    zero, (x, y) = jnp.zeros(3), jnp.eye(2)
    e, t = jnp.array([3.0, 4.0]), jnp.array([0.6, 0.8])

    @jax.jit
    def found():
        rest = normal_part(x, t)
        return {
            "norm": (norm(zero), jax.grad(norm)(zero)),
            "unit": jax.jacfwd(lambda v: unit(v, zero))(zero),
            "along": normal_part(e, t),
            "rest": (dot(rest, t), norm(rest)),
            "sides": (signed_side(y, x), signed_side(-y, x), signed_side(x, x)),
            "projection": projection_step(x, 0 * x, y),
        }

    got = found()
    assert got["norm"][0] == 0
    np.testing.assert_array_equal(got["norm"][1], zero)
    np.testing.assert_array_equal(got["unit"], np.zeros((3, 3)))
    np.testing.assert_allclose(got["along"], 0, atol=1e-15)
    assert got["rest"] == pytest.approx((0, 0.8), abs=1e-16)
    assert got["sides"] == (1, -1, 0)
    assert got["projection"] == 0
