"""The battery that every law passes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from batteries import DT, ENTRIES, Lead, ahead, cast, table_loop
from law_bench import CASES, MOVING, bench, close, compiled, ticks

from jaxstage import settings
from jaxstage.controllers import Offset, cmac_sliding, gaussian, offset_setpoint, per_axis, pi
from jaxstage.drives import CurrentDrive, current_drive
from jaxstage.fields import leaves, replace
from jaxstage.numerics.smooth import exact
from jaxstage.rollout import _simulate, simulate
from jaxstage.studies.fuzzy_cmac.loops import dfcmac_gains, pi_gains, scenario

pytestmark = pytest.mark.long

every_law = pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
types = pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64], ids=["f32", "f64"])


def kinds(tree):
    """Structure, shape, type and weak type of every leaf."""
    described = jax.tree.map(lambda x: (x.shape, str(x.dtype), x.weak_type), tree)
    return jax.tree.structure(tree), jax.tree.leaves(described)


@pytest.mark.fast
@every_law
@types
def test_memory_keeps_structure_shape_and_type(entry, dtype):
    """So that the scan accepts it, and nothing is ever traced twice."""
    law, gains = entry.make(), cast(entry.gains, dtype)
    wanted, measured = bench(MOVING, dtype)

    def period(gains, wanted, measured):
        before = law.init(gains, wanted, measured)
        demand, controlled = law.control(gains, before, wanted, measured, DT)
        return demand, before, controlled, law.settle(gains, controlled, demand, demand, DT)

    demand, before, controlled, settled = jax.eval_shape(period, gains, wanted, measured)
    assert demand.shape == (2,) and demand.dtype == dtype and not demand.weak_type
    assert kinds(before) == kinds(controlled) == kinds(settled)
    assert all(leaf.dtype == dtype and not leaf.weak_type for leaf in jax.tree.leaves(settled))


@every_law
def test_finite_command_and_memory(entry):
    """At zero error, rest, reversal, far off; also behind a drive that gives next to nothing."""
    for name, case in CASES.items():
        for limit in (np.inf, 1e-3):
            result = compiled(entry.name)(cast(entry.gains), bench(case), limit)
            assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(result)), name


@every_law
def test_jit_equals_eager(entry):
    eager = ticks(entry.make(), cast(entry.gains), bench(MOVING))
    jitted = compiled(entry.name)(cast(entry.gains), bench(MOVING), 0.3)
    close(jitted, eager, rtol=1e-11, atol=1e-14)


@every_law
def test_many_gains_equal_one_at_a_time(entry):
    one, pair = compiled(entry.name), bench(MOVING)
    some = [
        jax.tree.map(lambda x, c=c: x * c + (c - 1) * 1e-3, cast(entry.gains))
        for c in (0.8, 1.0, 1.3)
    ]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *some)
    many = jax.vmap(lambda g: one(g, pair, 0.3))(stacked)
    for i, gains in enumerate(some):
        close(jax.tree.map(lambda x, i=i: x[i], many), one(gains, pair, 0.3), 1e-11, 1e-14)


@every_law
def test_gradients(entry):
    """By gains, setpoint and measurement: finite at rest, zero error and reversal too. Forward
    equals reverse and differences at a point where no law switches."""
    law, gains = entry.make(), cast(entry.gains)
    weights = jnp.broadcast_to(jnp.asarray([0.7, -1.3]), (2, 2))
    rng = np.random.default_rng(0)
    direction = jax.tree.map(
        lambda x: jnp.asarray(rng.uniform(0.5, 1, x.shape) * np.where(x == 0, 1e-3, x)), gains
    )

    def objective(g, pair):
        demands, memory = ticks(law, g, pair, limit=0.05)
        return jnp.sum(demands * weights) + sum(jnp.sum(m) for m in jax.tree.leaves(memory))

    @jax.jit
    def slopes(g, pair, d):
        forward = jax.jvp(lambda x: objective(x, pair), (g,), (d,))
        return forward, jax.grad(objective, argnums=(0, 1))(g, pair)

    for name, case in CASES.items():
        found = slopes(gains, bench(case), direction)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found)), name
    (_, forward), (reverse, _) = slopes(gains, bench(MOVING), direction)
    assert forward != 0
    pairs = zip(jax.tree.leaves(reverse), jax.tree.leaves(direction), strict=True)
    np.testing.assert_allclose(sum(np.vdot(a, b) for a, b in pairs), forward, rtol=1e-10)
    h = 1e-6
    up, down = (
        slopes(
            jax.tree.map(lambda x, d, s=s: x + s * d, gains, direction), bench(MOVING), direction
        )
        for s in (h, -h)
    )
    np.testing.assert_allclose((up[0][0] - down[0][0]) / (2 * h), forward, rtol=5e-6)


@pytest.mark.fast
@every_law
def test_composed_anew_it_is_the_same_definition(entry):
    assert entry.make() is entry.make()
    assert hash(entry.make()) == hash(entry.make())


@pytest.mark.fast
@every_law
def test_gains_survive_a_file(entry, tmp_path):
    rng = np.random.default_rng(1)
    gains = jax.tree.map(lambda x: jnp.asarray(x * rng.uniform(0.5, 2, np.shape(x))), entry.gains)
    file = tmp_path / "gains.toml"
    file.write_text(settings.to_toml({"gains": gains}))
    back, _, paths = settings.apply(cast(entry.gains), scenario(), settings.read_toml(file))
    assert jax.tree.structure(back) == jax.tree.structure(gains)
    assert len(paths) == len(jax.tree.leaves(gains))
    jax.tree.map(np.testing.assert_array_equal, back, gains)


@pytest.mark.fast
@every_law
def test_every_gain_and_memory_has_unit_and_meaning(entry):
    law, gains = entry.make(), cast(entry.gains)
    memory = law.init(gains, *bench(MOVING))
    for tree in (gains, memory):
        described = list(leaves(tree))
        assert len(described) == len(jax.tree.leaves(tree))
        for path, quantity, _ in described:
            assert quantity.unit and quantity.doc, path
    assert all(q.symbol for _, q, _ in leaves(gains)), "a gain without symbol"


@every_law
def test_single_precision_follows_double(entry):
    """Errors are differences of positions of 20 mm: 2e-9 m of rounding, times the stiffest law."""
    for name in ("moving", "zero error", "rest"):
        fine, _ = compiled(entry.name)(cast(entry.gains), bench(CASES[name]), 0.3)
        coarse, _ = compiled(entry.name, "f32")(
            cast(entry.gains, jnp.float32), bench(CASES[name], jnp.float32), 0.3
        )
        assert coarse.dtype == jnp.float32
        scale = np.abs(fine).max() + 0.02
        np.testing.assert_allclose(coarse[0], fine[0], atol=1e-3 * scale, err_msg=name)


SETTLED = [entry for entry in ENTRIES if entry.settled and entry.name != "offset"]


@pytest.mark.parametrize("entry", SETTLED, ids=lambda entry: entry.name)
def test_single_precision_run_follows_double(entry):
    """A tenth of a second of a law that does not switch: errors agree to a fiftieth."""
    loop, scenario, path = table_loop(entry.make())
    reports = []
    for dtype in (jnp.float32, jnp.float64):
        run = simulate(loop, entry.gains, scenario, cast(path, dtype), 1000)
        assert run.report.ate.dtype == dtype
        reports.append(run.report)
    np.testing.assert_allclose(reports[0].ate, reports[1].ate, rtol=0.02)
    np.testing.assert_allclose(reports[0].tracking_max, reports[1].tracking_max, rtol=0.02)


def test_no_retrace_for_changed_numbers():
    """Floats, numpy or JAX numbers, other seeds and recomposed definitions: one compilation."""

    def loop_of():
        return table_loop(per_axis(cmac_sliding(gaussian, exact)))

    loop, scenario, path = loop_of()
    gains = dfcmac_gains()
    before = _simulate._cache_size()
    variants = [
        (gains, scenario),
        (cast(gains), cast(replace(scenario, key=()))),
        (jax.tree.map(lambda x: np.asarray(1.1 * x, np.float32), gains), scenario),
        (gains, replace(scenario, plant=jax.tree.map(lambda x: 1.2 * x, scenario.plant))),
    ]
    for seed, (numbers, uncertain) in enumerate(variants):
        again, _, _ = loop_of()
        assert again == loop
        simulate(again, numbers, replace(uncertain, key=jax.random.key(seed)), path, 20)
    assert _simulate._cache_size() == before + 1


def test_no_retrace_for_python_floats():
    law, gains = per_axis(pi), pi_gains()
    loop, scenario, path = table_loop(offset_setpoint(law, "lead", ahead), drive=current_drive(2))
    before = _simulate._cache_size()
    for delay, time in enumerate((1e-4, np.float32(2e-4), jnp.asarray(3e-4))):
        drive = CurrentDrive(limit=np.array([1.0, 2.0]), delay=delay, lag=float(time))
        scenario = replace(scenario, drive=drive)
        simulate(loop, Offset(law=gains, offset=Lead(time=time)), scenario, path, 20)
    assert _simulate._cache_size() == before + 1
