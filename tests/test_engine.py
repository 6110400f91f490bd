"""The compiled engine means what the scan means: values, derivatives, lost runs, every batch."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from speed.agreement import distinct, moved, spread

import jaxstage as js
from jaxstage.blocks import compiled, scan
from jaxstage.engine import build as building
from jaxstage.engine import loop as engine_loop
from jaxstage.engine import primitives
from jaxstage.engine.kernels import kernel
from jaxstage.engine.program import is_real
from jaxstage.fields import replace
from jaxstage.metrics import high_frequency, tracking
from jaxstage.rollout import compiled_form, start
from jaxstage.sensors import Noisy, ideal_sensor, noisy

TICKS = 30
#: one loop of each machine with each kind of law, coupled, with sensors, delays and observers
LOOPS = (
    "dfcmac-star", "sliding-circle", "cascade-circle", "asmc-s0", "af-pid-ccc-helix",
    "smc1500-motor",
)  # fmt: skip


@functools.cache
def case(name):
    found = js.build(name)
    return found._replace(loop=replace(found.loop, metric=tracking))


def run(c, engine, gains, ticks=TICKS, **changes):
    loop = replace(c.loop, engine=engine, **changes)
    return js.simulate(loop, gains, c.scenario, c.path, ticks)


def many(c, engine, gains, **more):
    return jax.jit(jax.vmap(lambda g: run(c, engine, g, **more)))(gains)


def close(a, b, tolerance):
    """Leaf by leaf, relative to the largest number of the leaf."""
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        x, y = np.asarray(x, float), np.asarray(y, float)
        np.testing.assert_array_equal(np.isnan(x), np.isnan(y))
        scale = np.nanmax(np.abs(x), initial=1e-12) if x.size else 1.0
        np.testing.assert_allclose(y / scale, x / scale, rtol=0, atol=tolerance)


@pytest.mark.parametrize("name", LOOPS)
def test_compiled_equals_scan(name):
    c = case(name)
    gains = spread(c.gains, 3)
    # a law that switches by a sign multiplies every rounding: few ticks
    ticks = 8 if name.startswith(("sliding", "smc1500")) else TICKS
    expected, found = (many(c, e, gains, ticks=ticks) for e in (scan, compiled))
    close(moved(expected), moved(found), 1e-12)
    assert engine_loop.refusal(program(c)) is None


def program(c, **changes):
    loop = replace(c.loop, **changes)
    carry = jax.eval_shape(lambda: start(loop, c.gains, c.scenario, c.path))
    zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), carry)
    return compiled_form(loop, c.gains, c.scenario, c.path, zeros)[0]


def test_long_arrays_are_loops_in_the_kernel():
    """80 bins of a spectrum, in a kernel of every kind; the last run leaves its path on the way."""
    ticks = 200
    c = case("cascade-circle")
    metric = high_frequency(0.4 / c.loop.dt, ticks, c.loop.dt)
    gains = jax.tree.map(lambda x: x.at[2].multiply(-40.0), spread(c.gains, 3))

    def of(engine):
        loop = replace(c.loop, metric=metric, engine=engine, path_limit=1e-4)

        def sums(g):
            return js.simulate(loop, g, c.scenario, c.path, ticks).final

        def power(g):
            acc = sums(g).metric
            return jnp.sum(acc.cosine**2) + jnp.sum(acc.sine**2)

        one = jax.tree.map(lambda x: x[0], gains)
        along = jax.jvp(power, (one,), (jax.tree.map(jnp.ones_like, one),))[1]
        final = jax.vmap(sums)(gains)
        return (final.metric, along, jax.grad(power)(one)), final.left_path_at

    (expected, lost), (found, also) = (jax.jit(of, static_argnums=0)(e) for e in (scan, compiled))
    assert 0 < lost[2] < ticks and lost[0] == -1
    np.testing.assert_array_equal(lost, also)
    close(expected, found, 1e-11)
    assert all(np.any(np.asarray(x) != 0) for x in jax.tree.leaves(expected))
    one = program(c, metric=metric)
    text = kernel(one, "forward", shared_by_all(one)).text(1)
    assert text.count("for (int k = 0; k < 80; k++)") >= 6


def shared_by_all(one):
    """What `kernel` is told of a program whose runs differ in their inputs alone."""
    return (False,) * (len(one.shared) + len(one.carry))


@pytest.mark.fast
def test_every_published_loop_is_compiled():
    refused = {}
    for name, c in distinct().items():
        reason = engine_loop.refusal(program(c))
        if reason is not None:
            refused[name] = reason
    assert not refused


@pytest.mark.fast
@pytest.mark.parametrize("name", ["dfcmac-star", "asmc-s0", "af-pid-ccc-helix", "asmc-mrac-r"])
def test_gradients_of_every_study_are_compiled(name):
    one = program(case(name))
    moving = tuple(i for i, x in enumerate(one.inputs) if is_real(x))
    shared = shared_by_all(one)
    for what in ("tangent", "pullback"):
        assert kernel(one, what, shared, moving).nodes > kernel(one, "forward", shared).nodes


@pytest.mark.parametrize("lanes", [1, 17, 64])
def test_batches(lanes):
    c = case("cascade-circle")
    gains = spread(c.gains, lanes)
    close(moved(many(c, scan, gains)), moved(many(c, compiled, gains)), 1e-12)


def test_nested_vmap_and_one_run():
    c = case("cascade-circle")
    gains = spread(c.gains, 6)
    flat = moved(many(c, compiled, gains))
    square = jax.tree.map(lambda x: x.reshape(2, 3, *x.shape[1:]), gains)
    nested = moved(jax.jit(jax.vmap(jax.vmap(lambda g: run(c, compiled, g))))(square))
    close(flat, jax.tree.map(lambda x: x.reshape(6, *x.shape[2:]), nested), 0)
    one = moved(run(c, compiled, jax.tree.map(lambda x: x[4], gains)))
    close(jax.tree.map(lambda x: x[4], flat), one, 0)


def test_rollouts_go_through_the_kernel_too():
    c = case("cascade-circle")
    gains = spread(c.gains, 5)
    loop = replace(c.loop, engine=compiled)
    together = js.rollouts(loop, gains, c.scenario, c.path, TICKS)
    close(moved(many(c, compiled, gains)), moved(together), 0)


def test_gradients_through_rollouts_have_kernels(monkeypatch):
    """Inside a sharded call, where the kernel of this loop is made, JAX adds its own primitives."""
    c = case("pi-circle")
    gains = spread(c.gains, 2)
    monkeypatch.setattr(primitives, "_pullback_reference", lambda *a, **more: pytest.fail("a scan"))

    def error(gains):
        loop = replace(c.loop, engine=compiled)
        return js.rollouts(loop, gains, c.scenario, c.path, 12).report.ate.sum()

    def plain(gains):
        return jax.vmap(lambda g: run(c, compiled, g, ticks=12).report.ate)(gains).sum()

    found = jax.jit(jax.grad(error))(gains)
    close(jax.jit(jax.grad(plain))(gains), found, 1e-12)


def test_single_precision(single):
    c = js.build("cascade-circle")
    c = c._replace(loop=replace(c.loop, metric=tracking))
    gains = jax.tree.map(lambda x: x.astype(jnp.float32), spread(c.gains, 3))
    expected, found = (many(c, e, gains) for e in (scan, compiled))
    assert found.report.ate.dtype == jnp.float32
    close(expected.final.state, found.final.state, 1e-5)


def elementary(x):
    y = jnp.where(jnp.isfinite(x), jnp.abs(x) + 1e-3, 2.0)
    return jnp.stack([
        jnp.exp(x), jnp.tanh(x), jnp.expm1(x), jax.nn.sigmoid(x), jnp.log(y), jnp.log1p(y),
        jnp.sqrt(y), y**0.7, jnp.sin(x), jnp.cos(x), jnp.arctan2(x, y), jnp.floor(x), jnp.round(x),
        jnp.sign(x), jnp.maximum(x, 0.5), jnp.minimum(0.5, x), jnp.clip(x, -y, y), x % 3.0,
        (jnp.clip(x, -1e6, 1e6).astype(jnp.int32) // 7 * 3 + 16777217).astype(x.dtype),
    ])  # fmt: skip


@pytest.mark.parametrize(("dtype", "ulps"), [(jnp.float64, 8), (jnp.float32, 8)])
def test_elementary_functions_are_accurate_and_keep_nan(dtype, ulps):
    size = np.concatenate([np.logspace(-9, 1.9, 60), [0.0, 1e-30, np.inf]])
    x = jnp.asarray(np.concatenate([size, -size, [np.nan]]), dtype)

    def step(static, inputs, shared, carry):
        return elementary(inputs), None

    def one(x):
        start = jnp.zeros(19, dtype)
        program, leaves = engine_loop.program_of(step, None, x, (), start)
        assert engine_loop.refusal(program) is None
        return engine_loop.rollout(program, leaves, 1)[0]

    found = np.asarray(jax.jit(jax.vmap(one))(x), float)
    wanted = np.asarray(jax.vmap(elementary)(x.astype(jnp.float64)), float)
    if dtype == jnp.float32:
        wanted = wanted.astype(np.float32).astype(float)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(wanted))
    tolerance = ulps * float(jnp.finfo(dtype).eps)
    tiny = float(jnp.finfo(dtype).tiny)
    finite, infinite = np.isfinite(wanted), np.isinf(wanted)
    np.testing.assert_array_equal(found[infinite], wanted[infinite])
    np.testing.assert_allclose(found[finite], wanted[finite], rtol=tolerance, atol=tiny)


# --- derivatives -----------------------------------------------------------------------------


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

    expected, found = (of(e)(1.0, 0.0) for e in (scan, compiled))
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
    others = np.array([0, 2])  # a lost run makes the tape of its vector useless, not their gradients
    close(*(jax.tree.map(lambda x: x[others], g) for g in (calm, slope)), 1e-12)


def test_gradients_of_runs_that_go_through_time_together():
    c = case("pi-circle")
    gains = spread(c.gains, 40)
    one = program(c)
    made = kernel(one, "pullback", shared_by_all(one), (0, 1))
    assert "TOGETHER = 4;" in made.text(8) and "TOGETHER = 1;" in made.text(3)

    def slopes(gains):
        return jax.jit(jax.vmap(jax.grad(lambda g: run(c, compiled, g, ticks=12).report.ate)))(gains)

    found, few = slopes(gains), slopes(jax.tree.map(lambda x: x[-3:], gains))
    close(few, jax.tree.map(lambda x: x[-3:], found), 1e-12)


def test_a_broken_start_is_lost_at_once():
    c = case("cascade-circle")
    begin = start(c.loop, c.gains, c.scenario, c.path)
    broken = replace(begin, state=jax.tree.map(lambda x: x * jnp.nan, begin.state))
    for engine in (scan, compiled):
        loop = replace(c.loop, engine=engine)
        result = js.simulate(loop, c.gains, c.scenario, c.path, TICKS, carry=broken)
        assert int(result.final.non_finite_at) == 0 and int(result.final.step) == TICKS


# --- resume, record, fall back ---------------------------------------------------------------


@pytest.mark.fast
def test_resumed_equals_whole():
    c = case("cascade-circle")
    loop = replace(c.loop, engine=compiled)
    whole = run(c, compiled, c.gains)
    first = run(c, compiled, c.gains, ticks=11)
    second = js.simulate(loop, c.gains, c.scenario, c.path, TICKS - 11, carry=first.final)
    close(moved(whole), moved(second), 0)


def test_recorded_rows():
    c = case("cascade-circle")
    expected, found = (many(c, e, spread(c.gains, 2), metric=js.record) for e in (scan, compiled))
    close(expected.rows, found.rows, 1e-11)
    assert found.rows.step.dtype == expected.rows.step.dtype
    assert found.rows.output.position.shape == (2, TICKS, 2)


def test_paths_of_their_own_fall_back_with_a_reason():
    c = case("cascade-circle")
    paths = jax.tree.map(lambda x: jnp.stack([x, x]), c.path)
    one = program(c)
    flags = [False] * len(one.inputs) + [True] * len(one.shared) + [False] * len(one.carry)
    assert "each run has for itself" in str(engine_loop.refusal(one, tuple(flags)))
    loop = replace(c.loop, engine=compiled)
    both = jax.vmap(lambda p: js.simulate(loop, c.gains, c.scenario, p, 5).report.ate)(paths)
    np.testing.assert_allclose(both, run(c, scan, c.gains, ticks=5).report.ate, rtol=1e-12)


def test_random_noise_is_a_scan_with_its_reason():
    c = case("cascade-circle")
    shaken = Noisy(noise=jnp.asarray(1e-7), sensor=())
    noise = c._replace(
        loop=replace(c.loop, sensor=noisy(ideal_sensor)),
        scenario=replace(c.scenario, sensor=shaken),
    )
    assert "random" in str(engine_loop.refusal(program(noise)))


@functools.cache
def odd_law(how):
    """The cascade with a primitive that has no kernel."""
    inner = case("cascade-circle").loop.controller

    def control(gains, memory, setpoint, measurement, dt):
        demand, memory = inner.control(gains, memory, setpoint, measurement, dt)
        if how == "sort":
            return jnp.sort(demand), memory
        return lax.while_loop(lambda x: jnp.sum(x * x) > 1e6, lambda x: x / 2, demand), memory

    return replace(inner, name=how, control=control)


@pytest.mark.parametrize("how", ["sort", "while"])
def test_a_law_that_cannot_be_compiled_runs_and_says_why(how):
    c = case("cascade-circle")
    c = c._replace(loop=replace(c.loop, controller=odd_law(how), engine=compiled))
    told = js.explain(c.loop, c.gains, c.scenario, c.path, kernels=("forward",))
    assert not told.compiled and f"primitive '{how}'" in told.text()
    found = run(c, compiled, c.gains)
    close(run(c, scan, c.gains).final, found.final, 0)


def test_without_a_compiler_everything_works(monkeypatch):
    monkeypatch.setattr(engine_loop, "compiler", lambda: None)
    c = case("cascade-circle")
    # its length is its own, so that no compiled program of another test is met
    found, expected = (run(c, e, c.gains, ticks=TICKS + 1) for e in (compiled, scan))
    close(expected.final, found.final, 0)
    assert "compiler" in str(engine_loop.refusal(program(c)))


# --- the cache -------------------------------------------------------------------------------


def test_a_kernel_is_built_once_and_a_damaged_one_again():
    one = program(case("cascade-circle"))
    text = kernel(one, "forward", shared_by_all(one)).text(1)
    text += "// another file\n"
    file = building.library_file(text)
    file.write_bytes(b"not a library")
    assert not building.build.__wrapped__(text).cached
    assert building.build.__wrapped__(text).cached
    assert not [x for x in file.parent.iterdir() if x.suffix not in ("", ".so")]


@pytest.mark.fast
def test_short_runs_are_a_scan():
    assert js.auto.shortest > 1000 > js.compiled.shortest
    c = case("cascade-circle")
    text = str(jax.make_jaxpr(lambda g: run(c, js.auto, g))(c.gains))
    assert "jaxstage_rollout" not in text
    assert "jaxstage_rollout" in str(jax.make_jaxpr(lambda g: run(c, compiled, g))(c.gains))
