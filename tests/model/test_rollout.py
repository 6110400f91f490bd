"""The loop itself: replay, segments, resume, batches, lost runs, compilation, dead code."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from jaxstage.controllers import cmac_sliding, gaussian, per_axis
from jaxstage.metrics import record, standard, together, tracking
from jaxstage.simulate import rollout
from jaxstage.simulate.rollout import replay, simulate
from tests.helpers.batteries import tracing

pytestmark = pytest.mark.long

#: two laps of 1000 ticks
SHORT = js.Timing(lap_time=0.1, laps=2)


def case(name="dfcmac-circle", metric=None, timing=SHORT, **changes):
    built = js.build(name, timing)
    loop = js.replace(built.loop, metric=metric or built.metric, **changes)
    return built._replace(loop=loop)


def run(c, ticks=None, carry=None, gains=None):
    return simulate(
        c.loop, c.gains if gains is None else gains, c.scenario, c.path,
        ticks or c.window.ticks, carry,
    )  # fmt: skip


def same(a, b):
    jax.tree.map(np.testing.assert_array_equal, _plain(a), _plain(b))


def close(a, b, rtol=1e-11):
    """Equal up to the rounding that a differently fused program may show."""
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=rtol, atol=1e-18), a, b)


def _plain(tree):
    return jax.tree.map(
        lambda x: jax.random.key_data(x) if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else x,
        tree,
    )


ONLINE = js.replace(standard(lambda memory: memory.surface), name="online")


def observed():
    """The loop that shows everything: all default metrics, and every tick."""
    return case(metric=together(ONLINE, record))


@functools.cache
def whole():
    return run(observed())


def motion(sample):
    return sample.step, sample.time, sample.output.position, sample.between.position


@pytest.mark.fast
def test_replay_equals_online():
    again, _ = jax.jit(lambda rows: replay(ONLINE, rows, 1e-4))(whole().rows["record"])
    close(again, whole().report["online"])


@pytest.mark.parametrize("segment", [1, 7, 100, 1999, 2000, 5000])
def test_segments_equal_the_plain_scan(segment):
    step, _, position, _ = run(case(metric=tracing(motion), segment=segment)).rows
    close(position, whole().rows["record"].output.position)
    np.testing.assert_array_equal(step, np.arange(2000))


@pytest.mark.fast
def test_resumed_equals_whole():
    """Two halves, the first from an explicit start: the programs of the two are one."""
    c = observed()
    begin = jax.jit(rollout.start, static_argnums=0)(c.loop, c.gains, c.scenario, c.path)
    first = run(c, ticks=1000, carry=begin)
    second = run(c, ticks=1000, carry=first.final)
    close(second.report, whole().report)
    close(second.final.state, whole().final.state)
    assert int(second.final.step) == 2000


def test_laps_repeat_the_path():
    position = whole().rows["record"].setpoint.position
    np.testing.assert_array_equal(position[:1000], position[1000:])


def test_substeps_do_not_move_the_samples():
    one = whole().rows["record"]
    _, time, position, between = run(case(metric=tracing(motion), substeps=4)).rows
    np.testing.assert_array_equal(one.time, time)
    assert between.shape == (2000, 4, 2)
    np.testing.assert_allclose(between[:-1, -1], position[1:], rtol=0, atol=1e-15)
    np.testing.assert_allclose(one.output.position, position, atol=1e-4)


def counted(loop):
    """A loop that counts how often its controller is traced."""
    calls = []
    law = loop.controller

    def control(*arguments):
        calls.append(1)
        return law.control(*arguments)

    return js.replace(loop, controller=js.replace(law, control=control)), calls


def test_changed_numbers_do_not_retrace():
    c = case(metric=tracking)
    loop, calls = counted(c.loop)

    def go(gains, scenario):
        return simulate(loop, gains, scenario, c.path, 50)

    go(c.gains, c.scenario)
    seen = len(calls)
    assert seen > 0
    go(js.replace(c.gains, slope=c.gains.slope * 2), c.scenario)
    go(js.replace(c.gains, slope=np.array([3.0, 4.0]), rate=np.float32([3, 4])), c.scenario)
    go(js.replace(c.gains, slope=jnp.array([1, 2])), c.scenario)
    go(c.gains, js.replace(c.scenario, key=jax.random.key(7)))
    plant = js.replace(c.scenario.plant, mass=np.float32([0.004, 0.005]))
    go(c.gains, js.replace(c.scenario, plant=plant))
    assert len(calls) == seen


def test_equal_definitions_share_one_compilation():
    c = case(metric=tracking)
    run(c)
    before = rollout._simulate._cache_size()
    again = js.build("dfcmac-circle", SHORT)
    law = per_axis(cmac_sliding(gaussian))
    assert js.replace(again.loop, metric=again.metric, controller=law) == case().loop
    loop = js.replace(again.loop, metric=tracking, controller=law)
    assert loop == c.loop and hash(loop) == hash(c.loop)
    simulate(loop, again.gains, again.scenario, again.path, 2000)
    assert rollout._simulate._cache_size() == before


def with_gains(c, slope, rate):
    return js.replace(c.gains, slope=jnp.stack([slope, slope]), rate=jnp.stack([rate, rate]))


@jax.jit
def four(slopes, rates):
    """Four runs side by side."""
    c = case(metric=tracking)
    return jax.vmap(lambda *pair: run(c, gains=with_gains(c, *pair)))(slopes, rates)


SLOPES = jnp.array([0.5, 1.0, 3.0, 40.0])
#: the second of these leaves the path
MIXED = jnp.array([10.0, 1e5, 20.0, 10.0])


def test_a_batch_equals_one_at_a_time():
    c = case(metric=tracking)
    batch = four(SLOPES, 10 * jnp.ones(4)).report
    for i, slope in enumerate(SLOPES):
        one = run(c, gains=with_gains(c, slope, jnp.asarray(10.0))).report
        close(jax.tree.map(lambda x: x[i], batch), one, rtol=1e-9)  # noqa: B023


def test_a_lost_run_is_flagged_and_leaves_the_others_alone():
    good = four(jnp.ones(4), MIXED.at[1].set(10.0))
    mixed = four(jnp.ones(4), MIXED)
    kept = np.array([0, 2, 3])
    np.testing.assert_array_equal(mixed.report.ate[kept], good.report.ate[kept])
    assert np.isnan(mixed.report.ate[1])
    left = mixed.final.left_path_at
    assert left[1] > 0 and (left[kept] == -1).all()


def test_a_lost_run_is_frozen_where_it_was_lost():
    c = observed()
    lost = run(c, gains=js.replace(c.gains, rate=jnp.full(2, 1e5)))
    tick = int(lost.final.left_path_at)
    rows = lost.rows["record"]
    error = np.abs(rows.setpoint.position - rows.output.position).max(axis=1)
    assert (error[:tick] <= c.loop.path_limit).all()
    assert np.isnan(rows.output.position[tick:]).all()
    assert np.isfinite(lost.final.state.position).all()
    assert int(lost.final.step) == 2000


def breaks_at(loop, below):
    """A loop whose law gives NaN, with a NaN derivative, once x is commanded below a limit."""
    law = loop.controller

    def control(gains, memory, setpoint, measurement, dt):
        demand, after = law.control(gains, memory, setpoint, measurement, dt)
        sign = jnp.where(setpoint.position[0] < below, -1.0, 1.0)
        return demand + 0 * jnp.sqrt(sign * gains.slope), after

    return js.replace(loop, controller=js.replace(law, control=control))


def test_non_finite_is_flagged_and_its_gradient_is_clean():
    c = case(metric=tracking)
    loop = breaks_at(c.loop, 0.02)

    def loss(slope, rate):
        gains = js.replace(c.gains, slope=jnp.full(2, slope), rate=jnp.full(2, rate))
        final = simulate(loop, gains, c.scenario, c.path, 800)
        lost = rollout.lost(final.final)
        return jnp.where(lost, 0.0, final.report.ate), final.final

    @jax.jit
    def both(*x):
        options = dict(argnums=(0, 1), has_aux=True)
        reverse = jax.value_and_grad(loss, **options)(*x)
        return reverse, jax.jacfwd(loss, **options)(*x)

    ((_, final), reverse), (forward, _) = both(1.0, 10.0)
    assert final.non_finite_at > 0 and final.left_path_at == -1
    np.testing.assert_array_equal(reverse, 0.0)
    np.testing.assert_array_equal(forward, 0.0)


def test_gradients_of_a_batch_with_a_lost_run_are_clean():
    @jax.jit
    @jax.grad
    def slope_of(rates):
        runs = four(jnp.ones(4), rates)
        return jnp.sum(jnp.where(runs.final.left_path_at >= 0, 0.0, runs.report.ate))

    mixed, alone = slope_of(MIXED), slope_of(MIXED.at[1].set(10.0))
    assert mixed[1] == 0 and alone[1] != 0
    kept = np.array([0, 2, 3])
    np.testing.assert_allclose(mixed[kept], alone[kept], rtol=1e-9)


def test_what_no_metric_reads_vanishes_from_the_compiled_loop():
    """The nearest point and the power ledger cost nothing unless a metric reads them."""
    c = case("pi-circle", metric=tracking)
    zero = jnp.zeros(2)
    nothing = js.replace(
        c.loop,
        reference=js.replace(
            c.loop.reference,
            nearest=lambda *_: js.Nearest(point=zero, distance=zero[0], arc=zero[0], reach=zero[0]),
        ),
        plant=js.replace(
            c.loop.plant,
            power=lambda *_: js.Power(
                copper=zero, mechanical=zero, dissipated=zero, load=zero, drawn=zero
            ),
        ),
    )

    def flops(loop):
        lowered = rollout._simulate.lower(loop, 100, c.gains, c.scenario, c.path, None)
        return lowered.compile().cost_analysis()["flops"]

    assert flops(c.loop) == flops(nothing)
    assert flops(c.loop) < 0.7 * flops(js.replace(c.loop, metric=standard()))


def test_ticks_must_be_positive():
    with pytest.raises(ValueError, match="ticks must be >= 1"):
        run(case(), ticks=-3)


def test_single_precision_stays_single(single):
    c = case(metric=record)
    final = run(c)
    kinds = {x.dtype for x in jax.tree.leaves(final) if jnp.issubdtype(x.dtype, jnp.floating)}
    assert kinds == {jnp.dtype("float32")}


def test_the_path_sets_the_precision():
    built = js.build("dfcmac-circle", SHORT)
    path = jax.tree.map(
        lambda x: x.astype(jnp.float32) if x.dtype == jnp.float64 else x, built.path
    )
    loop = js.replace(built.loop, metric=tracking)
    final = simulate(loop, built.gains, built.scenario, path, 100)
    assert final.final.state.position.dtype == jnp.float32
