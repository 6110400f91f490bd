"""What is refused before a run: the message names the leaf, the axis, the unit and the range."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import settings as effort
from hypothesis import strategies as st

from jaxstage.controllers import RigidAxis, per_axis, pi
from jaxstage.hardware.drives import CurrentDrive, current_drive
from jaxstage.hardware.loads import SineLoad, sine_load
from jaxstage.hardware.sensors import Encoder, encoder
from jaxstage.metrics.effort import Effort
from jaxstage.metrics.table import key
from jaxstage.model.fields import in_units_of, quantities, replace
from jaxstage.model.settings import SCENARIO_PARTS, known_leaves
from jaxstage.model.validate import check
from jaxstage.plants import pmsm_table
from jaxstage.references import analytic
from jaxstage.simulate.rollout import simulate
from jaxstage.studies import Timing, build
from jaxstage.studies.fuzzy_cmac.loops import dfcmac_gains, pi_gains
from tests.helpers.batteries import DT, cast, table_loop

LOOP, SCENE, PATH = table_loop(per_axis(pi), load=sine_load, sensor=encoder, drive=current_drive(2))
SCENE = replace(
    SCENE,
    load=SineLoad(**{n: np.ones(2) for n in ("amplitude", "frequency", "phase", "bias")}),
    sensor=Encoder(resolution=np.array(1e-6), bandwidth=np.array(np.inf)),
    drive=CurrentDrive(limit=np.full(2, np.inf), delay=np.array(1.0), lag=np.array(0.0)),
)
GAINS = dfcmac_gains()
KNOWN = known_leaves(GAINS, SCENE)


def changed(path, new):
    """Gains and scenario with one leaf replaced by ``new(old)``."""

    def walk(tree, names):
        if not names:
            return new(np.array(tree, dtype=float))
        return replace(tree, **{names[0]: walk(getattr(tree, names[0]), names[1:])})

    root, *names = path.split(".")
    if root == "gains":
        return walk(GAINS, names), SCENE
    return GAINS, replace(SCENE, **{root: walk(getattr(SCENE, root), names)})


def refused(path, new, loop=LOOP, over=PATH):
    """The one line with which ``check`` refuses a changed leaf."""
    gains, scene = changed(path, new)
    with pytest.raises(ValueError) as caught:
        check(loop, gains, scene, over)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@st.composite
def spoiled(draw):
    """A leaf, the index of one of its entries, and a value outside its range."""
    path = draw(st.sampled_from(sorted(KNOWN)))
    quantity, value = KNOWN[path]
    shape = np.shape(value)
    index = tuple(draw(st.integers(0, n - 1)) for n in shape)
    bad = [np.nan] if quantity.infinite else [np.nan, np.inf, -np.inf]
    if max(quantity.low, quantity.above) > -np.inf:
        bottom = max(quantity.low, quantity.above)
        bad += [bottom - draw(st.floats(1e-3, 1e6)), -np.inf]
    if quantity.above > -np.inf:
        bad.append(quantity.above)
    if quantity.high < np.inf:
        bad.append(quantity.high + draw(st.floats(1e-3, 1e6)))
    return path, index, draw(st.sampled_from(bad))


@pytest.mark.fast
@given(spoiled())
@effort(deadline=None, max_examples=120)
def test_any_bad_entry_is_named(case):
    path, index, bad = case

    def spoil(x):
        x[index] = bad
        return x

    message = refused(path, spoil)
    quantity = in_units_of(KNOWN[path][0], "A")
    assert message.startswith(path)
    if index:
        assert f"({'xy'[index[0]]})" in message
        assert all(f"[{i}]" in message for i in index[1:])
    assert f"[{quantity.symbol}] = {bad:g}" in message
    assert quantity.unit == "1" or f" {quantity.unit}: must be " in message
    assert message.endswith(f"must be {quantity.range_text()}")


@pytest.mark.fast
def test_a_unit_with_a_command_below_the_stroke_is_clear():
    """In N m as in A; the name of a column is the same without brackets."""
    constant = quantities(RigidAxis)["force_constant"]
    assert in_units_of(constant, "A").unit == "N/A"
    unit = in_units_of(constant, "N m").unit
    assert unit == "N/(N m)" and key("constant", unit) == "constant_N_per_Nm"
    variance = quantities(Effort)["command_variance"]
    assert in_units_of(variance, "N m").unit == "N2 m2"


@pytest.mark.fast
@given(st.sampled_from(sorted(KNOWN)), st.floats(1e-6, 1e6))
@effort(deadline=None, max_examples=60)
def test_any_value_in_range_is_accepted(path, size):
    quantity, _ = KNOWN[path]
    assume(not quantity.at_least and path not in ("plant.coulomb", "drive.delay"))
    gains, scene = changed(path, lambda x: np.full_like(x, size))
    check(LOOP, gains, scene, PATH)


@pytest.mark.fast
def test_static_friction_is_not_below_coulomb():
    message = refused("plant.static", lambda x: np.array([x[0], 0.1499]))
    assert message == "plant.static (y) [F_s] = 0.1499 N: must be >= coulomb"
    gains, scene = changed("plant.static", lambda x: np.full(2, 0.15))
    check(LOOP, gains, scene, PATH)


@pytest.mark.fast
@pytest.mark.parametrize(
    ("path", "allowed"),
    [
        ("plant.mass", "> 0 kg"),
        ("plant.force_constant", "> 0 N/A"),
        ("plant.stribeck", "> 0 m/s"),
        ("plant.backlash", ">= 0 A"),
        ("gains.rate", ">= 0 A2 s2/m2"),
        ("gains.switching_gain", ">= 0 m/s2"),
        ("gains.receptive.width", "> 0"),
        ("gains.error_width", "> 0 m"),
        ("gains.nominal.mass", "> 0 kg"),
        ("sensor.bandwidth", "> 0 Hz"),
        ("drive.limit", "> 0 1"),
    ],
)
def test_ranges_of_the_specification(path, allowed):
    message = refused(path, lambda x: -np.ones_like(x))
    assert message.endswith(f"must be {allowed}".removesuffix(" 1"))
    accepted = allowed.startswith(">=")
    gains, scene = changed(path, np.zeros_like)
    if accepted:
        check(LOOP, gains, scene, PATH)
    else:
        refused(path, np.zeros_like)


@pytest.mark.fast
@pytest.mark.parametrize(
    ("path", "shape", "expected"),
    [
        ("plant.mass", (3,), "plant.mass has shape (3,), expected (2,)"),
        ("plant.mass", (), "plant.mass has shape (), expected (2,)"),
        ("plant.mass", (2, 1), "plant.mass has shape (2, 1), expected (2,)"),
        ("gains.slope", (3,), "gains.slope has shape (3,), expected () or (2,)"),
        ("gains.weights", (2, 36), "gains.weights has shape (2, 36), expected (4, 3, 3) or (2, 4"),
        ("sensor.resolution", (3,), "sensor.resolution has shape (3,), expected () or (2,)"),
        ("start.offset", (0,), "start.offset has shape (0,), expected (2,)"),
    ],
)
def test_wrong_shapes(path, shape, expected):
    assert refused(path, lambda x: np.ones(shape)).startswith(expected)


@pytest.mark.fast
def test_wrong_axes_of_the_path():
    plant = pmsm_table(("x",))
    message = refused("plant.mass", lambda x: np.ones(3), replace(LOOP, plant=plant))
    assert message == f"the path has 2 axes, but {plant.name} has 1 (x)"


@pytest.mark.fast
@pytest.mark.parametrize("delay", [3.0, 2.5, 1e9])
def test_delay_beyond_the_queue(delay):
    message = refused("drive.delay", lambda x: np.array(delay))
    assert "drive.delay" in message and f"{delay:g} periods" in message and "<= 2" in message


@pytest.mark.fast
def test_delay_is_a_whole_number():
    message = refused("drive.delay", lambda x: np.array(0.5))
    assert message == "drive.delay = 0.5 periods: must be a whole number"


@pytest.mark.fast
@pytest.mark.parametrize(
    ("field", "bad", "allowed"),
    [
        *[("dt", bad, "> 0 s") for bad in (0.0, -1e-4, np.nan, np.inf)],
        *[("substeps", bad, ">= 1") for bad in (0, -1, np.nan)],
        ("substeps", 1.5, "a whole number"),
        ("segment", -1, ">= 0"),
        ("segment", 2.5, "a whole number"),
        *[("path_limit", bad, "> 0 m") for bad in (0.0, -1.0, np.nan)],
    ],
)
def test_impossible_loops(field, bad, allowed):
    with pytest.raises(ValueError, match=f"^loop.{field} = {bad}: must be {allowed}$"):
        check(replace(LOOP, **{field: bad}), GAINS, SCENE, PATH)


@pytest.mark.fast
@pytest.mark.parametrize("ticks", [0, -5])
def test_a_run_needs_ticks(ticks):
    with pytest.raises(ValueError, match=f"ticks must be >= 1, got {ticks}"):
        simulate(LOOP, GAINS, SCENE, PATH, ticks)


@pytest.mark.fast
@pytest.mark.parametrize(
    ("ticks", "reason"),
    [
        (2**31, "ticks must be <= 2147483647 (the counter has 32 bits), got 2147483648"),
        (1e3, "ticks = 1000.0: must be a whole number"),
        ("10", "ticks = '10': must be a whole number"),
    ],
)
def test_ticks_that_nothing_can_count(ticks, reason):
    with pytest.raises(ValueError, match=f"^{re.escape(reason)}$"):
        simulate(LOOP, GAINS, SCENE, PATH, ticks)


@pytest.mark.fast
def test_the_period_of_the_path_is_that_of_the_loop():
    with pytest.raises(ValueError, match=r"loop.dt = .* s, but the path has a tick every"):
        check(replace(LOOP, dt=2 * LOOP.dt), GAINS, SCENE, PATH)


def test_a_key_of_the_old_kind_is_refused():
    with pytest.raises(ValueError, match=r"scenario.key must be a key of jax.random.key"):
        check(LOOP, GAINS, replace(SCENE, key=jax.random.PRNGKey(0)), PATH)


# --- timing ----------------------------------------------------------------------------------


@pytest.mark.fast
@pytest.mark.parametrize(
    ("timing", "message"),
    [
        *[({"lap_time": bad}, "lap_time = .*: must be > 0 s") for bad in (0, -1, np.nan, np.inf)],
        *[({"dt": bad}, "dt = .*: must be > 0 s") for bad in (0, -1e-4, np.nan, np.inf)],
        *[({"feed": bad}, "feed = .*: must be > 0 mm/min") for bad in (0, -1, np.nan)],
        *[({"duration": bad}, "duration = .*: must be > 0 s") for bad in (0, -1, np.nan)],
        *[
            ({"laps": bad}, "laps = .*: must be a whole number >= 1")
            for bad in (0, -1, 1.5, np.nan, np.inf)
        ],
        *[
            ({"substeps": bad}, "substeps = .*: must be a whole number >= 1")
            for bad in (0, -1, 1.5, np.nan, np.inf)
        ],
        *[
            ({"laps": 2, "scored": bad}, "scored = .*: must be 0 .whole run. or .*1..2")
            for bad in (3, -1, 1.5, np.nan, np.inf)
        ],
        ({"duration": 0.015, "scored": 2}, "scored = 2: must be 0 .whole run. or .*1..1"),
        ({"duration": 1e-6}, "duration = .*: must be >= dt"),
        ({"lap_time": 1e-5}, "lap_time must be >= dt"),
        ({"feed": 1e9}, "feed must be <= .* mm/min"),
    ],
    ids=str,
)
def test_impossible_timing(timing, message):
    with pytest.raises(ValueError, match=message):
        build("pi-circle", Timing(**{"lap_time": 0.01, "laps": 1} | timing))


@pytest.mark.fast
@given(
    laps=st.integers(1, 3), scored=st.integers(0, 3), extra=st.floats(0, 1),
    timed=st.booleans(),
)  # fmt: skip
@effort(deadline=None, max_examples=25)
def test_the_scored_window_lies_in_the_run(laps, scored, extra, timed):
    assume(scored <= laps)
    duration = (laps + extra) * 0.01 if timed else None
    timing = Timing(lap_time=0.01, laps=laps, scored=scored, duration=duration)
    window = build("pi-circle", timing).window
    assert 0 <= window.start < window.stop <= window.ticks
    assert window.ticks == (round(duration / 1e-4) if timed else laps * 100)
    assert window.stop - window.start == (100 if scored else window.ticks)


# --- under a trace ---------------------------------------------------------------------------


def test_nothing_is_raised_for_traced_values():
    """A batch with a run of negative mass computes; that run is lost, its neighbour is not."""
    loop, scene, path = table_loop(per_axis(pi))
    plant = scene.plant

    def score(mass):
        there = replace(scene, plant=replace(plant, mass=mass))
        run = simulate(loop, pi_gains(), there, path, 200)
        return run.report.ate, run.final.left_path_at, run.final.non_finite_at

    masses = jnp.asarray([plant.mass, -plant.mass, [jnp.nan, 1.0]])
    ate, left, broken = jax.jit(jax.vmap(score))(masses)
    assert np.isfinite(ate[0]) and left[0] == broken[0] == -1
    assert np.isnan(ate[2]) and broken[2] >= 0
    alone = simulate(loop, pi_gains(), scene, path, 200)
    np.testing.assert_allclose(ate[0], alone.report.ate, rtol=1e-9)
    with pytest.raises(ValueError, match=r"plant.mass .x. .M. = -0.003 kg: must be > 0 kg"):
        score(masses[1])


@pytest.mark.fast
def test_shapes_are_checked_under_a_trace():
    def score(slope):
        return check(LOOP, replace(GAINS, slope=slope), SCENE, PATH)[0].slope

    with pytest.raises(ValueError, match=r"gains.slope has shape"):
        jax.eval_shape(score, jnp.ones(3))
    assert jax.eval_shape(score, jnp.ones(2)).shape == (2,)


@pytest.mark.fast
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_the_path_sets_the_precision(dtype):
    gains, scene, path = check(LOOP, GAINS, SCENE, cast(PATH, dtype))
    numbers = (gains, path, *(getattr(scene, name) for name in SCENARIO_PARTS))
    assert all(x.dtype == dtype and not x.weak_type for x in jax.tree.leaves(numbers))
    assert jnp.issubdtype(scene.key.dtype, jax.dtypes.prng_key)


@pytest.mark.fast
def test_a_traced_delay_is_clipped_not_refused():
    drive = current_drive(2)
    memory = drive.init(SCENE.drive, jnp.zeros(2))

    def late(delay):
        params = cast(replace(SCENE.drive, delay=delay))
        held = memory
        for k in range(5):
            _, applied, held = drive.apply(params, held, jnp.full(2, float(k)), DT)
        return applied

    np.testing.assert_array_equal(jax.vmap(late)(jnp.asarray([0.0, 2.0, 9.0]))[:, 0], [4, 2, 2])


def test_a_path_without_numbers_takes_the_default_precision():
    """The precision of a run is that of its path; without one it is JAX's."""
    fixed = replace(LOOP, reference=analytic("fixed", _fixed, DT))
    gains, _, _ = check(fixed, GAINS, SCENE, ())
    assert {x.dtype for x in jax.tree.leaves(gains)} == {jnp.zeros(()).dtype}


def _fixed(params, time):
    return jnp.zeros(2) + time


# --- what is no number -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "value",
    [[1.0, 2.0], (1.0,), True, np.array([True, False]), jnp.array([True]), 1 + 2j, "200", None],
    ids=str,
)
def test_a_gain_that_is_no_number_is_refused_by_name(value):
    gains = replace(GAINS, **{"slope": value})
    with pytest.raises(ValueError, match=r"gains\.slope = .*: must be a number or an array"):
        check(LOOP, gains, SCENE, PATH)


@pytest.mark.fast
def test_whole_numbers_and_numpy_numbers_are_gains():
    loop, scene, path = table_loop(per_axis(pi))
    gains = pi_gains()
    whole = replace(gains, **{"slope": np.int64(3)})
    got, _, _ = check(loop, whole, scene, path)
    assert float(got.slope) == 3.0 and got.slope.dtype == jnp.float64


@pytest.mark.fast
@pytest.mark.parametrize("substeps", [10_001, 10**6])
def test_substeps_without_end_are_refused(substeps):
    with pytest.raises(ValueError, match=f"loop.substeps = {substeps}: must be <= 10000"):
        check(replace(LOOP, substeps=substeps), GAINS, SCENE, PATH)
