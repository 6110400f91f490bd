"""The trifolium: printed form, derivatives, constant feed, the nearest point on the leaf."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.references import (
    constant_feed_phase,
    make_trifolium,
    trifolium,
    uniform_phase,
)
from jaxstage.references.trifolium import length

DT, T, R = 5e-3, 20.0, 5e-3
COUNT = 4000
PATH = jax.tree.map(jnp.asarray, make_trifolium(R, T))
TICKS = jnp.arange(COUNT, dtype=jnp.int32)
timings = pytest.mark.parametrize(
    "phase", [uniform_phase, constant_feed_phase], ids=["uniform", "constant_feed"]
)
RUNS = {
    phase: jax.vmap(trifolium(DT, phase).sample, (None, 0))
    for phase in (uniform_phase, constant_feed_phase)
}


def printed(time, radius=R, lap_time=T):
    """(22) as printed."""
    th = 2 * np.pi * np.asarray(time) / lap_time
    leaf = radius * np.cos(th) * (4 * np.sin(th) ** 2 - 1)
    return np.stack([leaf * np.cos(th), leaf * np.sin(th)], axis=-1)


def test_the_printed_curve_and_its_derivatives():
    lap = RUNS[uniform_phase](PATH, TICKS)
    np.testing.assert_allclose(lap.position, printed(np.arange(COUNT) * DT), atol=1e-17)
    at = 740  # 3.7 s
    np.testing.assert_allclose(lap.position[at], [1.86834e-3, 4.31749e-3], rtol=3e-6)
    np.testing.assert_allclose(lap.velocity[at], [-1.99033e-3, -8.78022e-4], rtol=3e-6)
    np.testing.assert_allclose(lap.acceleration[at], [-9.23508e-4, -4.65951e-3], rtol=3e-6)
    w = 2 * np.pi / T
    np.testing.assert_allclose(lap.velocity[0], [0.0, -R * w], atol=1e-18)
    for signal, mean in ((lap.velocity, 2.5 * R**2 * w**2), (lap.acceleration, 34 * R**2 * w**4)):
        np.testing.assert_allclose(np.mean(signal**2, axis=0), mean, rtol=1e-12)


@timings
def test_derivatives_tangent_and_curvature(phase):
    lap = RUNS[phase](PATH, TICKS)
    x, v, a = (np.asarray(s) for s in (lap.position, lap.velocity, lap.acceleration))

    def numeric(s):  # sixth order, once round
        ahead = [np.roll(s, -k, axis=0) - np.roll(s, k, axis=0) for k in (1, 2, 3)]
        return (45 * ahead[0] - 9 * ahead[1] + ahead[2]) / (60 * DT)

    np.testing.assert_allclose(numeric(x), v, atol=2e-12)
    np.testing.assert_allclose(numeric(v), a, atol=1e-9)
    speed = np.linalg.norm(v, axis=1)
    np.testing.assert_allclose(lap.tangent, v / speed[:, None], atol=1e-14)
    across = (v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]) / speed**3
    np.testing.assert_allclose(lap.curvature, np.abs(across), rtol=1e-10)


def test_constant_feed():
    lap = RUNS[constant_feed_phase](PATH, TICKS)
    np.testing.assert_allclose(length(PATH), 13.364893 * R, rtol=1e-7)
    speed = np.linalg.norm(np.asarray(lap.velocity), axis=1)
    np.testing.assert_allclose(speed, length(PATH) / T, rtol=1e-13)
    along = np.sum(np.asarray(lap.acceleration) * np.asarray(lap.tangent), axis=1)
    np.testing.assert_allclose(along, 0, atol=1e-15)
    slowest, fastest = np.sort(np.linalg.norm(RUNS[uniform_phase](PATH, TICKS).velocity, axis=1))[
        [0, -1]
    ]
    np.testing.assert_allclose([slowest, fastest], [R * 2 * np.pi / T, 3 * R * 2 * np.pi / T])


@timings
def test_nearest_point_on_the_leaf(phase):
    """Set off across the curve it is that far away, at the commanded arc; ahead it is on it."""
    reference = trifolium(DT, phase)
    lap = RUNS[phase](PATH, TICKS)
    normal = np.stack([-lap.tangent[:, 1], lap.tangent[:, 0]], axis=1)
    found = jax.vmap(reference.nearest, (None, 0, 0))
    beside = found(PATH, TICKS, lap.position + 5e-6 * normal)
    np.testing.assert_allclose(beside.distance, 5e-6, rtol=1e-9)
    np.testing.assert_allclose(beside.point, lap.position, atol=1e-15)
    ahead = found(PATH, TICKS, jnp.roll(lap.position, -5, axis=0))
    np.testing.assert_allclose(ahead.distance, 0, atol=1e-15)
    steps = np.diff(np.asarray(beside.arc))
    speed = np.linalg.norm(np.asarray(lap.velocity), axis=1)
    np.testing.assert_allclose(steps, DT * (speed[1:] + speed[:-1]) / 2, rtol=1e-4)
    np.testing.assert_allclose(beside.arc[-1] + DT * speed[-1], length(PATH), rtol=1e-6)


def test_the_local_branch_at_the_triple_crossing():
    """Near the origin another leaf may be nearer; the contour error is that of the leaf in hand."""
    crossing = int(np.argmin(np.linalg.norm(RUNS[uniform_phase](PATH, TICKS).position, axis=1)))
    reference = trifolium(DT)
    here = reference.sample(PATH, jnp.asarray(crossing))
    aside = jnp.array([-here.tangent[1], here.tangent[0]])
    tool = here.position + 4e-6 * aside
    found = reference.nearest(PATH, jnp.asarray(crossing), tool)
    np.testing.assert_allclose(found.distance, 4e-6, rtol=1e-9)
    dense = printed(np.linspace(0, T / 2, 200_001))
    everywhere = np.linalg.norm(dense - np.asarray(tool), axis=1).min()
    assert everywhere < 0.6 * 4e-6


def test_derivatives_by_the_parameters():
    """A step of T or r moves the setpoint as finite differences say."""
    reference = trifolium(DT, constant_feed_phase)

    def position(radius, lap_time):
        path = make_like(radius, lap_time)
        return reference.sample(path, jnp.asarray(1234)).velocity

    def make_like(radius, lap_time):
        return type(PATH)(radius=radius, lap_time=lap_time)

    slopes = jax.jit(jax.jacfwd(position, argnums=(0, 1)))(PATH.radius, PATH.lap_time)
    for i, (step, value) in enumerate(((1e-7, R), (1e-4, T))):
        args = [[R, T], [R, T]]
        args[0][i], args[1][i] = value + step, value - step
        numeric = (position(*map(jnp.asarray, args[0])) - position(*map(jnp.asarray, args[1]))) / (
            2 * step
        )
        np.testing.assert_allclose(slopes[i], numeric, rtol=1e-6)


@pytest.mark.fast
@pytest.mark.parametrize(
    ("values", "name"),
    [
        ((0.0, T), "radius"),
        ((np.nan, T), "radius"),
        ((R, 0.0), "lap_time"),
        ((R, np.inf), "lap_time"),
    ],
)
def test_bad_parameters_are_refused(values, name):
    with pytest.raises(ValueError, match=f"{name} must be finite and > 0"):
        make_trifolium(*values)


@pytest.mark.fast
def test_equal_motions_are_one_definition():
    assert trifolium(DT) is trifolium(DT)
    assert trifolium(DT) is not trifolium(DT, constant_feed_phase)
