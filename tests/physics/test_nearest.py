"""Orthogonal projection onto computed motions, near and far, against dense brute force downhill."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.model.fields import replace
from jaxstage.references import (
    analytic,
    circle,
    constant_feed_phase,
    helical,
    helix,
    make_path,
    make_trifolium,
    nurbs_lap,
    sampled,
    swing,
    swinging,
    trifolium,
    uniform_parameter,
    uniform_phase,
)
from jaxstage.references.nearest import project

DT = 1e-3
RADIUS = 0.01


def on_device(params):
    return jax.tree.map(jnp.asarray, params)


def leaf(phase):
    """Points of the trifolium, (..., 2) m, by its printed equation."""
    two, four = 2 * phase, 4 * phase
    x = -(np.cos(two) + np.cos(four))
    return RADIUS / 2 * np.stack([x, np.sin(two) - np.sin(four)], axis=-1)


def downhill(curve, start, tool, step=2e-4, most=40_000):
    """Least distance, walking on a dense grid downhill from a start, then by ternary search."""
    distance = lambda q: np.linalg.norm(curve(np.asarray(q)) - tool)  # noqa: E731
    forward = distance(start + step) < distance(start)
    grid = start + (1 if forward else -1) * step * np.arange(most)
    fall = np.linalg.norm(curve(grid) - tool, axis=-1)
    last = int(np.argmax(np.diff(fall) >= 0))
    low, high = sorted((grid[max(last - 1, 0)], grid[last + 1]))
    for _ in range(80):
        a, b = low + (high - low) / 3, high - (high - low) / 3
        low, high = (low, b) if distance(a) < distance(b) else (a, high)
    return distance((low + high) / 2)


def offsets(share, count, seed):
    """Ticks, commanded phases and tools at ``share`` of the radius of curvature, any direction."""
    rng = np.random.default_rng(seed)
    ticks = rng.integers(0, 4000, count)
    phase = 2 * np.pi * ticks * DT / 4.0
    bend = 12 * np.cos(6 * phase)  # kappa r = (9 - 6 cos 6 th) / g^3 with g = sqrt(5 - 4 cos 6 th)
    speed = np.sqrt(5 - 4 * np.cos(6 * phase))
    radius = RADIUS * speed**3 / (9 - bend / 2)
    angle = rng.uniform(0, 2 * np.pi, count)
    aside = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * (share * radius)[:, None]
    return ticks, phase, leaf(phase) + aside


@pytest.mark.parametrize("share", [0.1, 0.5, 0.7, 0.9, 1.3])
def test_far_off_the_trifolium(share):
    """What has settled is the local minimum; at the least 99 of 100 settle."""
    ticks, phase, tools = offsets(share, 300, seed=int(10 * share))
    params = on_device(make_trifolium(RADIUS, 4.0))
    near = jax.jit(jax.vmap(trifolium(DT).nearest, (None, 0, 0)))(params, ticks, tools)
    expected = [downhill(leaf, *own) for own in zip(phase, tools, strict=True)]
    settled = np.asarray(near.reach) == np.inf
    assert settled.mean() >= 0.99
    np.testing.assert_allclose(
        np.asarray(near.distance)[settled], np.array(expected)[settled], rtol=1e-6, atol=1e-9
    )


@pytest.mark.fast
def test_within_the_radius_of_curvature_newton_on_the_gradient_alone_is_too_slow():
    """0.9 of the radius of curvature inside the tip, and behind: 6 steps of it end far too high."""
    params = on_device(make_trifolium(RADIUS, 4.0))
    tick, phase = 333, 2 * np.pi * 0.333 / 4.0  # close to the tip of a leaf
    tip = leaf(np.pi / 6)
    tool = tip * (1 - 0.8 / 3) + 2e-4 * np.array([-tip[1], tip[0]]) / np.linalg.norm(tip)
    near = trifolium(DT).nearest(params, jnp.asarray(tick), jnp.asarray(tool))
    assert near.reach == np.inf
    np.testing.assert_allclose(near.distance, downhill(leaf, phase, tool), rtol=1e-8)


@pytest.mark.fast
@pytest.mark.parametrize("phase", [uniform_phase, constant_feed_phase])
def test_gradient_at_a_far_point(phase):
    """Of the distance: the unit vector to the tool. Of the point: by differences."""
    params = on_device(make_trifolium(RADIUS, 4.0))
    near = lambda tool: trifolium(DT, phase).nearest(params, jnp.asarray(310), tool)  # noqa: E731
    tool = trifolium(DT, phase).sample(params, jnp.asarray(300)).position * 0.8
    there = near(tool)
    assert there.reach == np.inf
    slope = jax.grad(lambda p: near(p).distance)(tool)
    np.testing.assert_allclose(slope, (tool - there.point) / there.distance, rtol=1e-6)
    turned = jax.jacrev(lambda p: near(p).point)(tool)
    h = 1e-7
    columns = [(near(tool + h * e).point - near(tool - h * e).point) / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(turned, np.stack(columns, axis=-1), rtol=1e-5, atol=1e-6)


@pytest.mark.fast
def test_on_a_circle_the_nearest_point_lies_on_the_ray_from_the_centre():
    """R - rho, for any tool nearer than a right angle; at 3/4 of the radius too."""
    params = on_device(helix(0.02, 2 * np.pi, 0.0))
    angle = np.linspace(-1.5, 1.5, 31)
    for rho in (0.005, 0.015, 0.019, 0.03):
        tools = rho * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
        near = jax.vmap(helical(DT).nearest, (None, None, 0))(params, jnp.asarray(0), tools)
        assert (near.reach == np.inf).all()
        np.testing.assert_allclose(near.distance, abs(rho - 0.02), rtol=1e-9)
        np.testing.assert_allclose(near.arc, 0.02 * angle, rtol=1e-4, atol=1e-12)


@pytest.mark.fast
def test_a_line_has_no_contour_error_from_rest_either():
    """Within the stroke 0 ... 2 A the distance is 0, beyond its ends what is beyond."""
    params = on_device(swing(0.02, 4.0))
    ticks = jnp.asarray([0, 1, 2, 10, 1000, 1990, 1999, 2000, 2003, 4000])
    place = swinging(DT).sample
    for off in (-2e-4, -1e-6, 0.0, 1e-6, 2e-4):
        tools = jax.vmap(place, (None, 0))(params, ticks).position + off
        near = jax.vmap(swinging(DT).nearest, (None, 0, 0))(params, ticks, tools)
        beyond = np.maximum(0, np.maximum(tools[:, 0] - 0.04, -tools[:, 0]))
        settled = np.asarray(near.reach) == np.inf
        assert settled.sum() >= 9
        np.testing.assert_allclose(near.distance[settled], beyond[settled], rtol=1e-2, atol=1e-9)


@pytest.mark.fast
def test_a_place_where_the_distance_is_largest_is_not_taken_for_the_nearest_point():
    """Beyond the centre of a circle the commanded point is the farthest one: unsettled."""
    reference = analytic("round", _round, DT)
    params = {"radius": jnp.asarray(0.02)}
    near = reference.nearest(params, jnp.asarray(0), jnp.asarray([-0.01, 0.0]))
    assert near.reach == 0
    run = reference.nearest(params, jnp.asarray(0), jnp.asarray([-0.01, 1e-4]))
    assert run.distance <= 0.0101 or run.reach == 0


def _round(params, time):
    return params["radius"] * jnp.stack([jnp.cos(time), jnp.sin(time)])


@pytest.mark.fast
def test_the_search_stays_between_its_ends():
    """A parabola y = x^2 from 0 to 1: the tool beside its end finds the end."""
    curve = lambda q: (  # noqa: E731
        jnp.stack([q, q * q]),
        jnp.stack([jnp.ones_like(q), 2 * q]),
        jnp.stack([jnp.zeros_like(q), 2 * jnp.ones_like(q)]),
    )
    ends = jnp.asarray(0.0), jnp.asarray(1.0)
    for tool, expected in (((1.5, 2.0), 1.0), ((-1.0, 0.0), 0.0)):
        q, settled = project(curve, jnp.asarray(0.5), jnp.asarray(tool), ends)
        assert q == expected
        assert settled


@pytest.mark.fast
def test_a_lap_states_how_far_it_searches():
    """A circle of four spans: three of them are searched, to the far end of a neighbour."""
    params = on_device(circle())
    near = nurbs_lap(1000, DT).nearest(params, jnp.asarray(0), jnp.asarray([0.024, 0.0]))
    np.testing.assert_allclose(near.distance, 0.001, rtol=1e-9)
    assert 0.02 < near.reach < 0.05
    two = replace(
        params,
        control_points=params.control_points[:5],
        weights=params.weights[:5],
        knots=jnp.asarray([0.0, 0, 0, 0.5, 0.5, 1, 1, 1]),
    )
    assert (
        nurbs_lap(1000, DT).nearest(two, jnp.asarray(3), jnp.asarray([0.024, 0.0])).reach == np.inf
    )


@pytest.mark.fast
def test_a_stored_lap_says_where_its_steps_have_not_settled():
    path = make_path(circle(), uniform_parameter(1.0, DT), window=0.25)
    at = lambda tick: sampled.sample(path, jnp.asarray(tick)).position  # noqa: E731
    for tool in (0.999 * at(100), 0.9 * at(100), 0.95 * at(90)):
        assert sampled.nearest(path, jnp.asarray(100), tool).reach == path.window
    assert sampled.nearest(path, jnp.asarray(100), 0.2 * at(0)).reach == 0
