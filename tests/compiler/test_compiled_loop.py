"""The compiled engine means what the scan means: values, lost runs, every batch."""

import functools
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import jaxstage as js
from benchmarks.agreement import distinct, moved, spread
from jaxstage.compiler.cxx.kernels import kernel
from jaxstage.compiler.frontend.step_program import StepSpec
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.runtime import api, fallback, jax_primitives, toolchain
from jaxstage.hardware.sensors import Noisy, ideal_sensor, noisy
from jaxstage.metrics import high_frequency, tracking
from jaxstage.model.blocks import compiled, scan
from jaxstage.model.fields import replace
from jaxstage.simulate import batch
from jaxstage.simulate.rollout import start
from tests.helpers.compiled_cases import TICKS, case, close, many, program, run, shared_by_all

ROOT = Path(__file__).parents[2]
#: the default engine for runs of any length
from_the_first_tick = replace(js.auto, shortest=1)
#: one loop of each machine with each kind of law, coupled, with sensors, delays and observers
LOOPS = (
    "dfcmac-star", "sliding-circle", "cascade-circle", "asmc-s0", "af-pid-ccc-helix",
    "smc1500-motor",
)  # fmt: skip


@pytest.mark.parametrize("name", LOOPS)
def test_compiled_equals_scan(name):
    c = case(name)
    gains = spread(c.gains, 3)
    # a law that switches by a sign multiplies every rounding: few ticks
    ticks = 8 if name.startswith(("sliding", "smc1500")) else TICKS
    expected, found = (many(c, e, gains, ticks=ticks) for e in (scan, compiled))
    close(moved(expected), moved(found), 1e-12)
    assert api.refusal(program(c)) is None


def test_compiled_is_the_scan_where_no_operation_is_contracted():
    """An encoder multiplies every rounding: with contraction they differ by 1e-5."""
    command = [sys.executable, "-m", "benchmarks.agreement", "asmc-s3"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    values, slopes = re.search(r"^asmc-s3 (\S+) (\S+)$", done.stdout, re.M).groups()
    assert float(values) < 1e-12 and float(slopes) < 1e-10


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


@pytest.mark.fast
def test_every_published_loop_is_compiled():
    refused = {}
    for name, c in distinct().items():
        reason = api.refusal(program(c))
        if reason is not None:
            refused[name] = reason
    assert not refused


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
        program, leaves = api.program_of(StepSpec(step), x, (), start)
        assert api.refusal(program) is None
        return api.rollout(program, leaves, 1)[0]

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
    assert "each run has for itself" in str(api.refusal(one, tuple(flags)))

    def both(engine):
        loop = replace(c.loop, engine=engine)
        return jax.vmap(lambda p: js.simulate(loop, c.gains, c.scenario, p, 5).report.ate)(paths)

    fallback._warn.cache_clear()
    with pytest.warns(RuntimeWarning, match="runs as a slower lax.scan: .*each run has for itself"):
        errors = both(from_the_first_tick)
    np.testing.assert_allclose(errors, run(c, scan, c.gains, ticks=5).report.ate, rtol=1e-12)
    with pytest.raises(RuntimeError, match=r"engine = compiled, .*each run has for itself"):
        both(compiled)


def test_random_noise_is_a_scan_with_its_reason():
    c = case("cascade-circle")
    shaken = Noisy(noise=jnp.asarray(1e-7), sensor=())
    noise = c._replace(
        loop=replace(c.loop, sensor=noisy(ideal_sensor)),
        scenario=replace(c.scenario, sensor=shaken),
    )
    assert "random" in str(api.refusal(program(noise)))


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
def test_a_law_that_cannot_be_compiled_runs_and_says_why_once(how):
    c = case("cascade-circle")
    c = c._replace(loop=replace(c.loop, controller=odd_law(how), engine=compiled))
    told = js.explain(c.loop, c.gains, c.scenario, c.path, kernels=("forward",))
    assert not told.compiled and f"primitive '{how}'" in told.text()
    with pytest.raises(RuntimeError, match=f"engine = compiled, .*primitive '{how}'"):
        run(c, compiled, c.gains)
    fallback._warn.cache_clear()
    with pytest.warns(RuntimeWarning, match=f"lax.scan: .*primitive '{how}'") as warned:
        found = run(c, from_the_first_tick, c.gains)
        run(c, from_the_first_tick, c.gains, ticks=TICKS - 1)
        js.rollouts(
            replace(c.loop, engine=from_the_first_tick), spread(c.gains, 2), c.scenario, c.path, 5
        )
    assert len(warned) == 1
    close(run(c, scan, c.gains).final, found.final, 0)


def test_what_is_explained_without_building():
    c = case("cascade-circle")
    told = js.explain(c.loop, c.gains, c.scenario, c.path, kernels=())
    assert told.compiled and told.kernels == () and told.reason is None
    loop = replace(c.loop, controller=odd_law("sort"))
    told = js.explain(loop, c.gains, c.scenario, c.path, kernels=())
    assert not told.compiled and "primitive 'sort'" in told.reason
    assert not js.explain(
        replace(c.loop, engine=scan), c.gains, c.scenario, c.path, kernels=()
    ).compiled
    with pytest.raises(ValueError, match="kernels = 'backward': must be of forward, tangent"):
        js.explain(c.loop, c.gains, c.scenario, c.path, kernels=("backward",))


def test_without_a_compiler_everything_works(monkeypatch):
    monkeypatch.setattr(api, "compiler", lambda: "no C++ compiler was found")
    c = case("cascade-circle")
    fallback._warn.cache_clear()
    # its length is its own, so that no compiled program of another test is met
    with pytest.warns(RuntimeWarning, match="no C\\+\\+ compiler"):
        found = run(c, from_the_first_tick, c.gains, ticks=TICKS + 1)
    close(run(c, scan, c.gains, ticks=TICKS + 1).final, found.final, 0)
    assert "compiler" in str(api.refusal(program(c)))


def test_a_compiler_that_fails_is_told_by_every_entry(monkeypatch):
    """The graph is made, and then the compiler fails: `simulate` and `rollouts` say so."""
    c = case("cascade-circle")
    gains = spread(c.gains, 2)

    def failing(text):
        raise LoweringError("g++ failed: no space left")

    monkeypatch.setattr(jax_primitives, "build", failing)
    jax_primitives.compiled_kernel.cache_clear()
    loop = replace(c.loop, engine=from_the_first_tick)
    try:
        # lengths of their own, as above
        for entry in (
            lambda e: js.rollouts(replace(loop, engine=e), gains, c.scenario, c.path, TICKS + 2),
            lambda e: many(c, e, gains, ticks=TICKS + 2),
            lambda e: run(c, e, c.gains, ticks=TICKS + 2),
        ):
            fallback._warn.cache_clear()
            with pytest.warns(RuntimeWarning, match="lax.scan: g\\+\\+ failed: no space left"):
                found = entry(from_the_first_tick)
            close(moved(entry(scan)), moved(found), 1e-12)
            with pytest.raises(RuntimeError, match="g\\+\\+ failed"):
                entry(compiled)
    finally:
        jax_primitives.compiled_kernel.cache_clear()
        batch._refusal.cache_clear()


def test_an_accelerator_is_told_by_what_is_lowered_for_it():
    c = case("cascade-circle")

    def lowered(engine):
        traced = jax.jit(lambda g: run(c, engine, g).report.ate).trace(c.gains)
        return traced.lower(lowering_platforms=("cuda",)).as_text()

    fallback._warn.cache_clear()
    with pytest.warns(RuntimeWarning, match="for processors alone"):
        assert "jaxstage_" not in lowered(from_the_first_tick)
    with pytest.raises(RuntimeError, match="for processors alone"):
        lowered(compiled)


def test_without_jit_the_number_is_the_same():
    c = case("cascade-circle")
    with jax.disable_jit():
        eager = [run(c, engine, c.gains, ticks=3).final for engine in (compiled, scan)]
    for final in eager:
        close(run(c, compiled, c.gains, ticks=3).final, final, 1e-12)


# --- the cache -------------------------------------------------------------------------------


def test_a_kernel_is_built_once_and_a_damaged_one_again():
    one = program(case("cascade-circle"))
    text = kernel(one, "forward", shared_by_all(one)).text(1)
    text += "// another file\n"
    file = toolchain.library_file(text, toolchain.compiler())
    file.write_bytes(b"not a library")
    assert not toolchain.build.__wrapped__(text).cached
    assert toolchain.build.__wrapped__(text).cached
    assert not [x for x in file.parent.iterdir() if x.suffix not in ("", ".so")]


@pytest.mark.fast
def test_short_runs_are_a_scan():
    assert js.auto.shortest > 1000 > js.compiled.shortest
    c = case("cascade-circle")
    text = str(jax.make_jaxpr(lambda g: run(c, js.auto, g))(c.gains))
    assert "jaxstage_rollout" not in text
    assert "jaxstage_rollout" in str(jax.make_jaxpr(lambda g: run(c, compiled, g))(c.gains))
