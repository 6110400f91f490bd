"""NURBS: the published points, the laws of the basis, two independent oracles, refusals."""

import geomdl.NURBS
import geomdl.operations
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.interpolate import BSpline

from jaxstage.references import bowknot, circle, heart, star
from jaxstage.references.arc import arc_at, arc_table, parameter_at
from jaxstage.references.nurbs import degree, derivatives, evaluate, is_closed, nurbs, points

CURVES = {f.__name__: f for f in (circle, bowknot, heart, star)}


along = jax.jit(jax.vmap(derivatives, (None, 0)))


def all_derivatives(curve, u):
    """C, C', C'' at some parameters, in a round number of rows: compiled once a kind of curve."""
    u = np.asarray(u)
    rows = along(curve, np.pad(u, (0, -u.size % 80), mode="edge"))
    return [np.asarray(x)[: u.size] for x in rows]


def random_curve(seed, order, axes, rational=True):
    rng = np.random.default_rng(seed)
    inner = np.sort(rng.uniform(-1.5, 2.5, 4))
    inner = np.sort(np.append(inner, [inner[1]] * (order - 1)))  # one of full multiplicity
    knots = np.concatenate([[-2.0] * (order + 1), inner, [3.0] * (order + 1)])
    count = len(knots) - order - 1
    weights = rng.uniform(0.3, 3, count) if rational else None
    return nurbs(rng.normal(size=(count, axes)), knots, weights, order)


def scipy_curve(curve):
    """C, C', C'' by scipy, in homogeneous coordinates and the quotient rule."""
    w = curve.weights[:, None]
    spline = BSpline(curve.knots, np.hstack([curve.control_points * w, w]), degree(curve))

    def values(u):
        a, b, c = (spline(u, k) for k in range(3))
        p = a[:, :-1] / a[:, -1:]
        v = (b[:, :-1] - b[:, -1:] * p) / a[:, -1:]
        return p, v, (c[:, :-1] - 2 * b[:, -1:] * v - c[:, -1:] * p) / a[:, -1:]

    return values


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("circle", [2.2058823529, 1.1764705882, 0.9615384615, 2.3076923077,
                    -2.2058823529, -1.1764705882, 2.2058823529, -1.1764705882]),
        ("bowknot", [-1.2244897959, -0.9183673469, -1.4754098361, -0.4918032787,
                     1.2244897959, -0.9183673469, 1.2244897959, 0.9183673469]),
        ("heart", [-1.84, 1.52, -2.56, 2.88, 1.36, 4.176, 1.84, 0.96]),
        ("star", [-1.5, 4, -3, 3, 2.25, 1, 0.625, 5.5]),
    ],
)  # fmt: skip
def test_published_points(name, expected):
    u = [0.1, 0.2, 0.6, 0.9]
    got = all_derivatives(CURVES[name](), u)[0]
    np.testing.assert_allclose(100 * got.ravel(), expected, atol=6e-11)
    np.testing.assert_allclose(points(CURVES[name](), u), got, atol=1e-16)


def test_circle_is_exact():
    got = all_derivatives(circle(), np.linspace(0, 1, 4001))[0]
    assert np.abs(np.hypot(*got.T) / 0.025 - 1).max() < 1e-15


@pytest.mark.parametrize(
    ("name", "length", "start", "end"),
    [
        ("circle", 15.70796, (0, 10), (0, 10)),
        ("bowknot", 10.33462, (-30, -30), (-30, -30)),
        ("heart", 15.26842, (-24, 16), (-24, -8)),
        ("star", 20.54554, (-10, 0), (-5, 0)),
    ],
)
def test_length_and_ends(name, length, start, end):
    curve = CURVES[name]()
    assert arc_table(curve).arc[-1] * 100 == pytest.approx(length, abs=5e-6)
    first = all_derivatives(curve, [0.0, 1.0])[1]
    np.testing.assert_allclose(100 * first, [start, end], atol=1e-12)
    assert is_closed(curve)


def test_bounding_boxes():
    u = np.linspace(0, 1, 100_001)
    box = {n: (100 * points(f(), u).min(0), 100 * points(f(), u).max(0)) for n, f in CURVES.items()}
    np.testing.assert_allclose(box["bowknot"][1][1], 0.918861, atol=1e-6)
    np.testing.assert_allclose(box["bowknot"][0][1], -0.918861, atol=1e-6)
    np.testing.assert_allclose(box["heart"], [(-2.571429, 0), (2.571429, 4.275862)], atol=1e-6)
    np.testing.assert_allclose(box["star"], [(-3.285714, 0.428571), (3.285714, 6)], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "left", "right", "angle"),
    [
        ("heart", 0.5, 0.5, 69.984), ("heart", 1.0, 0.0, 52.125),
        ("star", 0.1, 0.1, 63.435), ("star", 0.8, 0.8, 63.435),
        ("star", 1.0, 0.0, 0.0), ("star", 0.3, 0.3, 0.0),
        ("circle", 0.5, 0.5, 0.0), ("circle", 1.0, 0.0, 0.0),
        ("bowknot", 0.5, 0.5, 0.0), ("bowknot", 1.0, 0.0, 0.0),
    ],
)  # fmt: skip
def test_tangent_jumps(name, left, right, angle):
    a, b = all_derivatives(CURVES[name](), [np.nextafter(left, 0) if left < 1 else 1.0, right])[1]
    got = np.degrees(np.arctan2(abs(a[0] * b[1] - a[1] * b[0]), a @ b))
    assert got == pytest.approx(angle, abs=5e-4)


@pytest.mark.parametrize("order", [1, 2, 3, 5])
@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("rational", [False, True])
def test_agrees_with_scipy(order, axes, rational):
    curve = random_curve(10 * order + axes, order, axes, rational)
    inner = curve.knots[order + 1 : -order - 1]
    u = np.concatenate([np.random.default_rng(1).uniform(-2, 3, 60), inner, [-2, 3]])
    for got, expected in zip(all_derivatives(curve, u), scipy_curve(curve)(u), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-10, atol=1e-10 * abs(expected).max())


@pytest.mark.parametrize("order", [2, 3])
def test_agrees_with_geomdl_before_and_after_knot_insertion(order):
    curve = random_curve(5, order, 3)
    other = geomdl.NURBS.Curve(normalize_kv=False)
    other.degree = order
    other.ctrlpts = curve.control_points.tolist()
    other.weights = curve.weights.tolist()
    other.knotvector = curve.knots.tolist()
    u = [-2.0, -1.1, 0.3, 2.9]
    expected = np.array([other.derivatives(x, order=2) for x in u])
    got = np.stack(all_derivatives(curve, u), axis=1)
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9 * abs(expected).max())
    geomdl.operations.insert_knot(other, [0.123], [1])
    finer = nurbs(other.ctrlpts, other.knotvector, other.weights, order)
    assert len(finer.weights) == len(curve.weights) + 1
    np.testing.assert_allclose(points(finer, u), points(curve, u), atol=1e-13)


def test_partition_of_unity_affine_and_weight_scale():
    curve, u = random_curve(3, 3, 2), np.linspace(-2, 3, 101)
    ones = nurbs(np.ones((len(curve.weights), 1)), curve.knots, curve.weights, 3)
    value, first, second = all_derivatives(ones, u)
    np.testing.assert_allclose(value, 1, atol=1e-14)
    np.testing.assert_allclose(np.abs(first) + np.abs(second), 0, atol=1e-10)
    turn, shift = np.array([[0.3, -2], [1.1, 0.4]]), np.array([5.0, -1])
    moved = nurbs(curve.control_points @ turn + shift, curve.knots, 7 * curve.weights, 3)
    np.testing.assert_allclose(points(moved, u), points(curve, u) @ turn + shift, atol=1e-13)


def test_only_active_points_enter():
    curve = star()
    wild = np.array(curve.control_points)
    wild[5:] = 1e9  # u in [0, 0.1) uses points 0 to 2
    got, expected = (all_derivatives(c, [0.05])[0] for c in (nurbs(wild, curve.knots), curve))
    np.testing.assert_array_equal(got, expected)


def test_gradients():
    curve = random_curve(8, 3, 2)
    u = np.array([-1.9, 0.11, 2.8])
    _, first, second = all_derivatives(curve, u)
    slope, bend = jax.jacfwd(evaluate, 1), jax.jacfwd(jax.jacrev(evaluate, 1), 1)
    both = jax.jit(jax.vmap(lambda c, x: (slope(c, x), bend(c, x)), (None, 0)))
    for got, expected in zip(both(curve, u), (first, second), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-9)
    check_grads(jax.jit(lambda c: evaluate(c, 0.11)), (curve,), order=1, rtol=1e-6)


def test_single_precision_stays_single():
    with (
        jax.enable_x64(False),
        jax.numpy_dtype_promotion("strict"),
        jax.numpy_rank_promotion("raise"),
    ):
        got = jax.jit(evaluate)(star(), 0.33)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, points(star(), 0.33), atol=1e-8)
    half = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), star())
    assert jax.eval_shape(evaluate, half, 0.33).dtype == np.float32


def test_arc_length_and_inverse():
    curve = random_curve(2, 3, 3)
    table = arc_table(curve)
    s = np.random.default_rng(0).uniform(0, table.arc[-1], 200)
    _, u = parameter_at(curve, table, s)
    np.testing.assert_allclose(arc_at(curve, table, u), s, atol=1e-13 * table.arc[-1])
    fine = points(curve, np.unique(np.append(np.linspace(-2, 3, 200_001), curve.knots)))
    chords = np.linalg.norm(np.diff(fine, axis=0), axis=1).sum()
    assert table.arc[-1] == pytest.approx(chords, rel=1e-8)


SQUARE = [(0, 0), (1, 0), (1, 1), (0, 1)]
GOOD = (0, 0, 0, 0.5, 1, 1, 1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((star().control_points, star().knots, np.ones(15)), r"13 control points need 13 weights"),
        ((SQUARE, (0, 0, 0, 1, 1, 1)), "need 7 knots"),
        ((SQUARE, (0, 0, 0, 0.5, 0.4, 1, 1)), "must not decrease"),
        ((SQUARE, (0, 0, 0.1, 0.5, 1, 1, 1)), "clamped"),
        ((SQUARE, (0, 0, 0, 0.5, 0.9, 1, 1)), "clamped"),
        ((SQUARE, (0, 0, 0, 0, 1, 1, 1)), "exactly degree"),
        ((SQUARE, (1,) * 7), "last knot > first knot"),
        (([*SQUARE, (2, 2), (3, 3)], (0, 0, 0, 0.5, 0.5, 0.5, 1, 1, 1)), "at most degree = 2"),
        ((SQUARE, GOOD, (1, 1, 0, 1)), "must be > 0; weight 2"),
        ((SQUARE, GOOD, (1, -1, 1, 1)), "must be > 0; weight 1"),
        ((SQUARE, GOOD, (1, np.nan, 1, 1)), "weights must be finite"),
        ((SQUARE, (0, 0, 0, np.nan, 1, 1, 1)), "knots must be finite"),
        (([(0, 0), (1, np.inf), (1, 1), (0, 1)], GOOD), "control_points must be finite"),
        (([], GOOD), "shape"),
        (([1, 2, 3, 4], GOOD), "shape"),
        ((np.zeros((4, 0)), GOOD), "shape"),
        ((SQUARE, GOOD, None, 0), "degree must be an integer >= 1"),
        ((SQUARE, GOOD, None, 2.0), "degree must be an integer >= 1"),
        ((SQUARE, GOOD, None, 4), "needs at least 5 control points"),
    ],
)
def test_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        nurbs(*arguments)


@pytest.mark.parametrize("u", [-1e-9, 1 + 1e-9, np.nan, [0.2, 3]])
def test_parameter_outside_is_refused(u):
    with pytest.raises(ValueError, match=r"u must lie in \[0, 1\]"):
        points(circle(), u)


def test_curve_without_length_is_refused():
    with pytest.raises(ValueError, match="length > 0"):
        arc_table(nurbs(np.ones((4, 2)), GOOD))
