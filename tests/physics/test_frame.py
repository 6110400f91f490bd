"""Frame and constant feed of curves that stand still somewhere: C' = 0 where control points
coincide."""

import jax
import numpy as np
import pytest

from jaxstage.references import constant_feed, make_path, nurbs, uniform_parameter
from jaxstage.references.arc import moving_spans
from jaxstage.references.frame import host_frame
from jaxstage.simulate.rollout import simulate
from jaxstage.studies import Timing, build

FEED, V = 1200.0, 0.02  # mm/min, m/s
BEZIER = [0, 0, 0, 0, 1, 1, 1, 1]
MIDDLE = [0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1]


def curve(points, knots, weights=None):
    """A curve of points in mm."""
    order = len(knots) - len(points) - 1
    return nurbs(np.array(points, float) * 1e-3, knots, weights, degree=order)


LINES = {
    "start": curve([(0, 0), (0, 0), (20, 0), (40, 0)], BEZIER),
    "end": curve([(0, 0), (20, 0), (40, 0), (40, 0)], BEZIER),
    "both": curve([(0, 0), (0, 0), (3, 4), (3, 4)], BEZIER),
    "slanted": curve([(1, 2), (1, 2), (20, 15), (39, 28)], BEZIER),
    "three times": curve([(0, 0), (0, 0), (0, 0), (40, 26)], BEZIER),
    "quadratic": curve([(0, 0), (0, 0), (20, 13)], [0, 0, 0, 1, 1, 1]),
    "weights": curve([(0, 0), (0, 0), (20, 13), (40, 26)], BEZIER, [1, 2, 0.5, 3]),
    "middle": curve([(x, 0) for x in (0, 10, 20, 20, 20, 30, 40)], MIDDLE),
    "middle, slanted": curve([(9 * x, 3 * x) for x in (0, 1, 2, 2, 2, 3, 4)], MIDDLE),
    "middle, off the ticks": curve([(9 * x, 3 * x) for x in (0, 1, 3, 3, 3, 4, 4.5)], MIDDLE),
    "inside a span": curve([(0, 0), (20, 7), (0, 0), (20, 7)], BEZIER),
}


def whole(path):
    return jax.tree.map(np.asarray, path.setpoint)


@pytest.mark.fast
@pytest.mark.parametrize("name", LINES)
@pytest.mark.parametrize("dt", [1e-2, 1e-3, 1e-4])
def test_a_straight_line_keeps_its_feed_where_the_curve_stands_still(name, dt):
    line = LINES[name]
    path = make_path(line, constant_feed(FEED, dt))
    s, speed = whole(path), float(path.length / path.lap_time)
    along = line.control_points[-1] - line.control_points[0]
    along = along / np.linalg.norm(along)
    assert speed == pytest.approx(V, rel=dt)
    np.testing.assert_allclose(s.velocity, np.tile(speed * along, (len(s.velocity), 1)), atol=1e-12)
    np.testing.assert_allclose(s.acceleration, 0, atol=1e-10)
    np.testing.assert_allclose(s.tangent, np.tile(along, (len(s.tangent), 1)), atol=1e-11)
    np.testing.assert_allclose(s.curvature, 0, atol=1e-6)


@pytest.mark.fast
def test_the_line_of_forty_millimetres():
    s = whole(make_path(LINES["start"], constant_feed(FEED, 1e-4)))
    assert len(s.velocity) == 20_000
    np.testing.assert_allclose(np.linalg.norm(s.velocity, axis=1), V, atol=1e-9)
    np.testing.assert_allclose(s.acceleration, 0, atol=1e-6)
    np.testing.assert_allclose(s.position[:, 0], V * 1e-4 * np.arange(20_000), atol=1e-15)


@pytest.mark.fast
def test_uniform_parameter_stands_still_there():
    s = whole(make_path(LINES["start"], uniform_parameter(2.0, 1e-3)))
    np.testing.assert_array_equal(s.velocity[0], 0)
    np.testing.assert_allclose(s.acceleration[0], (0.12 / 4, 0), rtol=1e-13)  # C'' = 120 mm


def test_a_curved_path_from_a_doubled_point():
    """C = (60 u^2 - 20 u^3, 30 u^3) mm, its arc length from a dense table. The curvature grows
    without limit towards the doubled point, where the direction is that of C''."""
    path = make_path(curve([(0, 0), (0, 0), (20, 0), (40, 30)], BEZIER), constant_feed(FEED, 1e-4))
    s, speed = whole(path), float(path.length / path.lap_time)
    u = np.linspace(0, 1, 400_001)
    rate = u * np.hypot(0.12 - 0.06 * u, 0.09 * u)  # |C'|
    middle = (u[1:] + u[:-1]) / 2
    inner = middle * np.hypot(0.12 - 0.06 * middle, 0.09 * middle)
    arc = np.append(0, np.cumsum(rate[1:] + 4 * inner + rate[:-1])) * (u[1] - u[0]) / 6
    assert float(path.length) == pytest.approx(arc[-1], rel=1e-13)
    at = np.sqrt(np.interp(speed * 1e-4 * np.arange(len(s.velocity)), arc, u**2))
    over = np.stack([0.12 - 0.06 * at, 0.09 * at], axis=1)  # C'/u
    size = np.linalg.norm(over, axis=1, keepdims=True)
    np.testing.assert_allclose(s.velocity, speed * over / size, atol=1e-9)
    np.testing.assert_array_equal(s.tangent[0], (1, 0))
    assert s.curvature[0] == 0 and not s.acceleration[0].any()
    # C' x C'' = u^2 (0.12 * 0.09), and n is t turned to the left
    curvature = 0.0108 / size[1:, 0] ** 3 / at[1:]
    normal = (over / size)[1:, ::-1] * (-1, 1)
    np.testing.assert_allclose(s.curvature[1:], curvature, rtol=1e-7)
    np.testing.assert_allclose(
        s.acceleration[1:], speed**2 * curvature[:, None] * normal, rtol=1e-6, atol=1e-8
    )


@pytest.mark.fast
@pytest.mark.parametrize("reverse", [False, True])
def test_the_curvature_has_a_limit_at_a_doubled_point(reverse):
    """C = (60 u^2, 10 u^4) mm + x alone: y = 10 (x/60)^2 mm, curvature 2 * 10/60^2 1/mm."""
    points, knots = [(0, 0), (0, 0), (10, 0), (30, 0), (60, 10)], [0] * 5 + [1] * 5
    doubled = curve(points[::-1] if reverse else points, knots)
    place, side, forward = (1.0, -1, -1) if reverse else (0.0, 1, 1)
    span = moving_spans(doubled)
    frame = host_frame(doubled, span, np.array([place]), side)
    np.testing.assert_allclose(frame.tangent, [(forward, 0)], atol=1e-14)
    np.testing.assert_allclose(frame.bend, [(0, 2e4 / 3600)], rtol=1e-12, atol=1e-10)
    assert frame.near_zero.all()
    if not reverse:
        s = whole(make_path(doubled, constant_feed(FEED, 1e-4)))
        np.testing.assert_allclose(s.acceleration[0], (0, V**2 * 2e4 / 3600), rtol=1e-4, atol=1e-12)


@pytest.mark.fast
@pytest.mark.parametrize("distance", [1e-12, 1e-9, 1e-7, 1e-5, 1e-3, 0.02])
def test_places_beside_a_doubled_point(distance):
    """y = 10 (x/60)^2 mm again: its curvature in closed form, as near as one likes."""
    doubled = curve([(0, 0), (0, 0), (10, 0), (30, 0), (60, 10)], [0] * 5 + [1] * 5)
    frame = host_frame(doubled, moving_spans(doubled), np.array([distance]))
    slope = 20 * (60e-3 * distance**2) / 3600e-3  # dy/dx at x = 60 u^2 mm
    exact = 2e4 / 3600 / (1 + slope**2) ** 1.5
    np.testing.assert_allclose(frame.curvature, exact, rtol=1e-10)
    np.testing.assert_allclose(frame.tangent, [(1, slope) / np.hypot(1, slope)], atol=1e-14)


@pytest.mark.parametrize("name", ["start", "end", "middle"])
def test_a_cascade_follows_a_line_that_stands_still_as_a_curve(name):
    """The same run as along the line of single points, over the place of the multiple point."""
    case = build("cascade-circle", Timing(scored=0))
    single = curve([(0, 0), (40, 0)], [0, 0, 1, 1])
    paths = [make_path(line, constant_feed(FEED, case.loop.dt)) for line in (LINES[name], single)]
    run, plain = (simulate(case.loop, case.gains, case.scenario, p, 11_000) for p in paths)
    assert run.final.left_path_at == plain.final.left_path_at == -1
    assert run.final.non_finite_at == plain.final.non_finite_at == -1
    for got, exact in zip(*map(jax.tree.leaves, (run.report, plain.report)), strict=True):
        np.testing.assert_allclose(got, exact, rtol=1e-6, atol=1e-9)
