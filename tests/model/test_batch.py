"""Batches: equal to single runs, to each other for any tile and device count, and independent."""

import functools
import json
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from jaxstage.metrics import record, standard, tracking
from jaxstage.references import circle, heart, nurbs_lap, star
from jaxstage.simulate import tiles
from jaxstage.simulate.batch import rollouts

pytestmark = pytest.mark.long

LANES = 11
TIMING = js.Timing(lap_time=0.1, laps=1)


#: all default metrics
FULL = standard(lambda memory: memory.surface)

build = functools.cache(js.build)


def case(metric=tracking, name="dfcmac-circle"):
    return js.with_metric(build(name, TIMING), metric)


def none_of(tree):
    return jax.tree.map(lambda _: None, tree)


def varied(c, **fields):
    """Gains with some batched fields, and the axes that say so."""
    gains = js.replace(c.gains, **fields)
    return gains, js.replace(none_of(c.gains), **dict.fromkeys(fields, 0))


def slopes(count=LANES):
    return jnp.asarray(np.random.default_rng(0).uniform(0.5, 4, (count, 2)))


def many(c, gains, axes, tile=None, devices=1, **rest):
    return rollouts(
        c.loop, gains, c.scenario, c.path, 1000,
        in_axes=(axes, None, None), tile=tile, devices=devices, **rest,
    )  # fmt: skip


def alone(c, gains):
    return js.simulate(c.loop, gains, c.scenario, c.path, 1000)


@functools.cache
def several(tile, broken=False):
    """Runs of different slope; one of them may leave its path."""
    c = case(FULL)
    rate = jnp.full((LANES, 2), c.gains.rate).at[5].multiply(1e4 if broken else 1.0)
    gains, axes = varied(c, rate=rate, slope=slopes())
    return many(c, gains, axes, tile=tile)


def test_a_batch_equals_single_runs():
    c, batch = case(FULL), several(4)
    for lane, slope in enumerate(slopes()):
        single = alone(c, js.replace(c.gains, slope=slope))
        jax.tree.map(
            lambda x, y: np.testing.assert_allclose(x[lane], y, rtol=1e-9, atol=1e-15),  # noqa: B023
            batch.report, single.report,
        )  # fmt: skip
        np.testing.assert_array_equal(batch.final.step[lane], single.final.step)


@pytest.mark.parametrize("tile", [1, 3, 11, 64])
def test_the_tile_does_not_change_a_bit(tile):
    jax.tree.map(np.testing.assert_array_equal, several(tile).report, several(4).report)


def test_recorded_rows_of_a_batch():
    c = case(record, "pi-circle")
    gains, axes = varied(c, slope=slopes(3))
    rows = many(c, gains, axes, tile=2).rows
    assert rows.command.shape == (3, 1000, 2)
    one = alone(c, js.replace(c.gains, slope=gains.slope[2])).rows
    np.testing.assert_allclose(rows.command[2], one.command, atol=1e-12)


def test_plants_starts_keys_and_paths_may_be_batched():
    c = case(name="pi-circle")
    count = 4
    mass = jnp.linspace(2e-3, 4e-3, count)[:, None] * jnp.ones((1, 2))
    scenario = js.replace(
        c.scenario,
        plant=js.replace(c.scenario.plant, mass=mass),
        start=js.replace(c.scenario.start, offset=jnp.linspace(0, 1e-5, 2 * count).reshape(-1, 2)),
        key=jax.random.split(jax.random.key(3), count),
    )
    axes = js.replace(
        none_of(c.scenario),
        plant=js.replace(none_of(c.scenario.plant), mass=0),
        start=js.replace(none_of(c.scenario.start), offset=0),
        key=0,
    )
    batch = rollouts(
        c.loop, c.gains, scenario, c.path, 500, in_axes=(None, axes, None), tile=3, devices=1
    )
    last = js.replace(
        c.scenario,
        plant=js.replace(c.scenario.plant, mass=mass[-1]),
        start=js.replace(c.scenario.start, offset=scenario.start.offset[-1]),
    )
    single = js.simulate(c.loop, c.gains, last, c.path, 500)
    np.testing.assert_allclose(batch.report.ate[-1], single.report.ate, rtol=1e-9)
    assert len(set(np.asarray(batch.report.ate))) == count


def test_every_run_may_have_its_own_curve():
    """Reference parameters are batched like any other: no stored path a run."""
    c = case(name="pi-circle")
    loop = js.replace(c.loop, reference=nurbs_lap(1000, 1e-4))
    shapes = [jax.tree.map(jnp.asarray, curve()) for curve in (circle, heart)]
    curves = jax.tree.map(lambda *x: jnp.stack(x), *shapes)
    batch = rollouts(
        loop, c.gains, c.scenario, curves, 800, in_axes=(None, None, 0), tile=2, devices=1
    )
    for lane, curve in enumerate(shapes):
        single = js.simulate(loop, c.gains, c.scenario, curve, 800)
        np.testing.assert_allclose(batch.report.ate[lane], single.report.ate, rtol=1e-9)
    assert star().weights.shape != circle().weights.shape  # other sizes need another batch


def test_stored_paths_may_be_batched():
    """Each run its own lap, here both of one length; their period is that of the loop."""
    paths = [build("pi-circle", TIMING).path] * 2
    paths[1] = js.replace(paths[1], setpoint=jax.tree.map(lambda x: 0.5 * x, paths[1].setpoint))
    c = case(name="pi-circle")
    batch = rollouts(
        c.loop, c.gains, c.scenario, jax.tree.map(lambda *x: jnp.stack(x), *paths), 500,
        in_axes=(None, None, 0), tile=2, devices=1,
    )  # fmt: skip
    for lane, path in enumerate(paths):
        single = js.simulate(c.loop, c.gains, c.scenario, path, 500)
        np.testing.assert_allclose(batch.report.ate[lane], single.report.ate, rtol=1e-9)


def test_a_lost_lane_changes_nothing_in_the_others():
    good, broken = several(4), several(4, broken=True)
    others = np.arange(LANES) != 5
    jax.tree.map(
        lambda x, y: np.testing.assert_array_equal(x[others], y[others]),
        broken.report, good.report,
    )  # fmt: skip
    assert broken.final.left_path_at[5] > 0
    assert all(np.isnan(x[5]).all() for x in jax.tree.leaves(broken.report))


def test_changed_numbers_do_not_recompile():
    c = case(name="pi-circle")
    seen = []
    law = c.loop.controller

    def control(*arguments):
        seen.append(1)
        return law.control(*arguments)

    c = c._replace(loop=js.replace(c.loop, controller=js.replace(law, control=control)))
    gains, axes = varied(c, slope=slopes())
    many(c, gains, axes, tile=4, memory=1e9)
    before = len(seen)
    many(c, js.replace(gains, slope=gains.slope * 1.5), axes, tile=4, memory=1e9)
    assert len(seen) == before


def test_gradients_go_through_a_batch():
    c = case(name="pi-circle")
    gains, axes = varied(c, slope=slopes(3))

    def total(slope):
        return jnp.sum(many(c, js.replace(gains, slope=slope), axes, tile=2).report.ate)

    def one(slope):
        return alone(c, js.replace(c.gains, slope=slope)).report.ate

    @jax.jit
    def derivatives(slope):
        return jax.grad(total)(slope), jax.jacfwd(total)(slope), jax.grad(one)(slope[1])

    reverse, forward, single = derivatives(gains.slope)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)
    np.testing.assert_allclose(reverse[1], single, rtol=1e-7)


def test_bad_batches_are_refused():
    c = case()
    gains, axes = varied(c, slope=slopes(), rate=jnp.full((LANES - 1, 2), 10.0))
    with pytest.raises(ValueError, match=r"leading size: gains.slope has 11, gains\S* has 10"):
        many(c, gains, axes)
    with pytest.raises(ValueError, match="in_axes has no 0"):
        many(c, c.gains, None)
    gains, axes = varied(c, slope=slopes().at[7, 1].set(-1.0))
    with pytest.raises(
        ValueError, match=r"gains.slope of run 7 \(y\) \[c1\] = -1 1/s: must be > 0"
    ):
        many(c, gains, axes)
    gains, axes = varied(c, slope=slopes())
    with pytest.raises(ValueError, match="tile = 0: must be >= 1"):
        many(c, gains, axes, tile=0)
    with pytest.raises(ValueError, match=r"devices = 99: must be 1\.\."):
        many(c, gains, axes, devices=99)
    with pytest.raises(ValueError, match="in_axes holds 1: must be 0 or None"):
        many(c, gains, 1)
    with pytest.raises(ValueError, match=r"in_axes holds '0', 0\.0: must be 0 or None"):
        js.rollouts(c.loop, gains, c.scenario, c.path, 10, in_axes=("0", 0.0, None))


def test_recording_beyond_the_budget_is_refused_before_it_runs():
    c = case(record)
    gains, axes = varied(c, slope=slopes(1000))
    with pytest.raises(ValueError, match=r"1000 runs of 1000 ticks would return .* GB"):
        many(c, gains, axes, tile=4, memory=1e8)


def test_the_tile_is_measured_once_and_remembered(tmp_path, monkeypatch):
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    measured = []
    original = tiles._measure
    monkeypatch.setattr(tiles, "_measure", lambda *a: measured.append(1) or original(*a))
    monkeypatch.setattr(tiles, "CANDIDATES", (2, 8))
    try:
        c = case(name="pi-circle")
        gains, axes = varied(c, slope=slopes())
        many(c, gains, axes)
        many(c, gains, axes)
        (chosen,) = json.loads((tmp_path / "tiles.json").read_text()).values()
    finally:
        jax.config.update("jax_compilation_cache_dir", before)
    assert measured == [1] and chosen in (2, 8)


DEVICES = """
import sys, jax, numpy as np
import jaxstage as js
js.configure("double", cores=2)
from jaxstage.simulate.batch import rollouts
from jaxstage.metrics import contour
from jaxstage.metrics import energy
from jaxstage.metrics import together
from jaxstage.metrics import tracking
c = js.build("dfcmac-circle", js.Timing(lap_time=0.1, laps=1))
loop = js.replace(c.loop, metric=together(tracking, contour, energy))
slopes = np.random.default_rng(0).uniform(0.5, 4, (8, 2))
gains = js.replace(c.gains, slope=slopes)
axes = js.replace(jax.tree.map(lambda _: None, c.gains), slope=0)
found = []
for devices in (1, None):
    run = rollouts(
        loop, gains, c.scenario, c.path, 1000, in_axes=(axes, None, None), tile=2, devices=devices
    )
    assert len(run.report["tracking"].ate.sharding.device_set) == (devices or 2)
    found.append(np.concatenate([np.ravel(x) for x in jax.tree.leaves(run.report)]))
np.save(sys.argv[1], found)
"""


def test_the_number_of_devices_does_not_change_a_result(tmp_path):
    """XLA compiles the partitioned program on its own, so the last bits may differ: < 1e-10."""
    file = tmp_path / "found.npy"
    subprocess.run(
        [sys.executable, "-c", DEVICES, str(file)],
        check=True, env={**os.environ, "JAX_ENABLE_X64": "1"},
    )  # fmt: skip
    one, two = np.load(file)
    np.testing.assert_allclose(one, two, rtol=1e-10, atol=1e-15)
