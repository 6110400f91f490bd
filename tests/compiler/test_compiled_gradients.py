"""Derivatives of compiled loops are those of the scan, and lost runs leave no trace in them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from benchmarks.agreement import spread
from jaxstage.compiler.cxx.kernels import kernel
from jaxstage.compiler.frontend.step_program import is_real
from jaxstage.compiler.runtime import fallback, jax_primitives
from jaxstage.model.blocks import compiled, scan
from jaxstage.model.fields import replace
from tests.helpers.compiled_cases import TICKS, case, close, many, program, run, shared_by_all


@pytest.mark.fast
@pytest.mark.parametrize("name", ["dfcmac-star", "asmc-s0", "af-pid-ccc-helix", "asmc-mrac-r"])
def test_gradients_of_every_study_are_compiled(name):
    one = program(case(name))
    moving = tuple(i for i, x in enumerate(one.inputs) if is_real(x))
    shared = shared_by_all(one)
    for what in ("tangent", "pullback"):
        assert kernel(one, what, shared, moving).nodes > kernel(one, "forward", shared).nodes


def test_gradients_through_rollouts_have_kernels(monkeypatch):
    """Inside a sharded call, where the kernel of this loop is made, JAX adds its own primitives."""
    c = case("pi-circle")
    gains = spread(c.gains, 2)
    monkeypatch.setattr(
        jax_primitives, "_pullback_reference", lambda *a, **more: pytest.fail("a scan")
    )

    def error(gains):
        loop = replace(c.loop, engine=compiled)
        return js.rollouts(loop, gains, c.scenario, c.path, 12).report.ate.sum()

    def plain(gains):
        return jax.vmap(lambda g: run(c, compiled, g, ticks=12).report.ate)(gains).sum()

    found = jax.jit(jax.grad(error))(gains)
    close(jax.jit(jax.grad(plain))(gains), found, 1e-12)


def objective(c, engine):
    def of(gains, plant):
        loop = replace(c.loop, engine=engine)
        result = js.simulate(loop, gains, replace(c.scenario, plant=plant), c.path, TICKS)
        return result.report.ate * 1e6

    return of


def test_reverse_is_forward_is_that_of_the_scan():
    c = case("dfcmac-circle")
    gains = spread(c.gains, 2)
    scale = jax.tree.map(jnp.abs, c.gains), c.scenario.plant

    def reverse(engine):
        slope = jax.grad(objective(c, engine), argnums=(0, 1))
        return jax.jit(jax.vmap(slope, in_axes=(0, None)))(gains, c.scenario.plant)

    def along(g):
        return jax.jvp(objective(c, compiled), (g, c.scenario.plant), scale)[1]

    expected, found = reverse(scan), reverse(compiled)
    products = jax.tree.map(lambda a, s: a * jnp.broadcast_to(s, a.shape), found, scale)
    wanted = jax.tree.map(lambda a, s: a * jnp.broadcast_to(s, a.shape), expected, scale)
    largest = max(float(jnp.abs(x).max()) for x in jax.tree.leaves(wanted) if x.size)
    for x, y in zip(jax.tree.leaves(wanted), jax.tree.leaves(products), strict=True):
        np.testing.assert_allclose(y / largest, x / largest, rtol=0, atol=1e-10)
    total = sum(jnp.sum(x.reshape(2, -1), axis=1) for x in jax.tree.leaves(products) if x.size)
    np.testing.assert_allclose(jax.jit(jax.vmap(along))(gains), total, rtol=1e-10)


def test_second_derivatives_and_those_by_the_path_are_those_of_the_scan():
    c = case("cascade-circle")

    def of(engine):
        def error(factor, shift):
            gains = replace(c.gains, velocity_gain=c.gains.velocity_gain * factor)
            lap = c.path.setpoint.position + shift
            path = replace(c.path, setpoint=replace(c.path.setpoint, position=lap))
            loop = replace(c.loop, engine=engine)
            return js.simulate(loop, gains, c.scenario, path, 10).report.tesd * 1e6

        return jax.jit(lambda x, y: (jax.grad(jax.grad(error))(x, y), jax.grad(error, 1)(x, y)))

    fallback._warn.cache_clear()
    with pytest.warns(RuntimeWarning) as warned:
        expected, found = (of(e)(1.0, 0.0) for e in (scan, compiled))
    told = {str(w.message).removeprefix("runs as a slower lax.scan: ") for w in warned}
    assert told == {jax_primitives.NO_KERNEL, jax_primitives.NO_SECOND} and len(warned) == 2
    assert all(abs(x) > 0 for x in expected)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_lost_run_is_flagged_and_leaves_no_trace_in_a_gradient():
    c = case("cascade-circle")
    gains = spread(c.gains, 3)
    wild = replace(gains, position_gain=gains.position_gain.at[1].multiply(1e9))
    expected, found = (many(c, e, wild) for e in (scan, compiled))
    close(expected.final, found.final, 1e-9)
    assert (np.asarray(js.lost(found.final)) == [False, True, False]).all()
    assert np.isnan(found.report.ate[1]) and np.isfinite(found.report.ate[0])

    def total(g):
        result = many(c, compiled, g)
        return jnp.sum(jnp.where(js.lost(result.final), 0.0, result.report.ate))

    slope, calm = jax.grad(total)(wild), jax.grad(total)(gains)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(slope))
    assert float(jnp.abs(slope.velocity_gain[0]).max()) > 0
    assert not np.any(slope.velocity_gain[1])
    # a lost run makes the tape of its vector useless, not the gradients of the others
    others = np.array([0, 2])
    close(*(jax.tree.map(lambda x: x[others], g) for g in (calm, slope)), 1e-12)


def test_gradients_of_runs_that_go_through_time_together():
    c = case("pi-circle")
    gains = spread(c.gains, 40)
    one = program(c)
    made = kernel(one, "pullback", shared_by_all(one), (0, 1))
    assert "INTERLEAVE = 2;" in made.text(8) and "INTERLEAVE = 1;" in made.text(3)

    slope = jax.grad(lambda g: run(c, compiled, g, ticks=12).report.ate)
    slopes = jax.jit(jax.vmap(slope))
    few = slopes(jax.tree.map(lambda x: x[4:7], gains))
    close(few, jax.tree.map(lambda x: x[4:7], slopes(gains)), 1e-12)
    beside_a_lost_run = jax.tree.map(lambda x: x.at[7].multiply(1e9), gains)
    close(few, jax.tree.map(lambda x: x[4:7], slopes(beside_a_lost_run)), 1e-12)
    assert np.isnan(run(c, compiled, jax.tree.map(lambda x: x[7], beside_a_lost_run)).report.ate)
