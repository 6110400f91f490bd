"""Draws: from (seed, run) alone, with the distributions and correlations that were asked for."""

import math
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy import stats

import jaxstage as js
from jaxstage.metrics import tracking
from tests.helpers.sweeping import REQUEST, text
from tuning.store.work_folder import differences, digest
from tuning.sweeps.configuration import (
    batch_of,
    build,
    configure_sweep,
    drawn_values,
)
from tuning.uncertainty import scenario_blocks as blocks
from tuning.uncertainty.designs import DESIGNS
from tuning.uncertainty.distributions import (
    discrete,
    from_table,
    lognormal,
    normal,
    triangular,
    uniform,
)
from tuning.uncertainty.metric_table import metric_columns, metric_names
from tuning.uncertainty.uncertain_space import batch, draw, longest_delay, space, uncertain_leaves

KNOWN = {
    "uniform": (uniform(1.0, 3.0), stats.uniform(1, 2)),
    "triangular": (triangular(1.0, 1.5, 3.0), stats.triang(0.25, 1, 2)),
    "normal": (normal(2.0, 0.5), stats.norm(2, 0.5)),
    "cut normal": (normal(2.0, 0.5, low=1.8, high=3.0), stats.truncnorm(-0.4, 2, 2, 0.5)),
    "lognormal": (lognormal(2.0, 0.3), stats.lognorm(0.3, scale=2)),
}


@pytest.mark.fast
@pytest.mark.parametrize("name", KNOWN)
def test_quantiles_are_those_of_scipy(name):
    found, known = KNOWN[name]
    p = np.linspace(0.001, 0.999, 501)
    np.testing.assert_allclose(found.quantile(p), known.ppf(p), rtol=1e-9)
    ends = found.quantile(np.array([0.0, 1.0]))
    assert np.isfinite(ends).all() and found.low < known.median() < found.high
    if np.isfinite(known.support()).all():
        np.testing.assert_allclose(ends, [found.low, found.high], rtol=1e-6)


@pytest.mark.fast
def test_a_discrete_value_comes_as_often_as_its_weight():
    found = discrete((3.0, 1.0, 2.0), (1.0, 2.0, 1.0))
    p = (np.arange(1000) + 0.5) / 1000
    values, counts = np.unique(found.quantile(p), return_counts=True)
    assert values.tolist() == [1, 2, 3] and counts.tolist() == [500, 250, 250]
    assert (found.low, found.high) == (1, 3)


@pytest.mark.fast
@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"distribution": "norml"}, "did you mean 'normal'"),
        ({}, "one of normal, lognormal"),
        ({"distribution": "normal", "mean": 1}, "missing a required argument: 'deviation'"),
        ({"distribution": "normal", "mean": 1, "deviation": -0.1}, "deviation = -0.1: must be > 0"),
        ({"distribution": "normal", "mean": 1, "deviation": 0}, "deviation = 0: must be > 0"),
        ({"distribution": "normal", "mean": "a", "deviation": 1}, "mean = a: must be a number"),
        ({"distribution": "normal", "mean": math.nan, "deviation": 1}, "must be finite"),
        ({"distribution": "normal", "mean": 0, "deviation": 1, "low": 9}, "nothing of"),
        ({"distribution": "uniform", "low": 2, "high": 1}, "low must be < high"),
        ({"distribution": "uniform", "low": 1, "high": math.inf}, "high = inf: must be finite"),
        ({"distribution": "uniform", "low": 1, "high": 2, "mode": 3}, "unexpected keyword"),
        ({"distribution": "triangular", "low": 1, "mode": 3, "high": 2}, "mode = 3: must be in"),
        ({"distribution": "lognormal", "median": -1, "deviation": 1}, "median = -1: must be > 0"),
        (
            {"distribution": "uniform", "low": [0.8, 0.9], "high": 2},
            "low = [0.8, 0.9]: must be a n",
        ),
        ({"distribution": "uniform", "low": True, "high": 2}, "low = True: must be a number"),
        ({"distribution": "discrete", "values": 3}, "values = 3: must be a list of numbers"),
        ({"distribution": "discrete", "values": [1, "a"]}, "values[1] = a: must be a number"),
        ({"distribution": "discrete", "values": []}, "0 values with 0 weights"),
        ({"distribution": "discrete", "values": [1], "weights": [-1]}, "weights[0] = -1"),
    ],
)
def test_an_impossible_distribution_is_refused(table, says):
    with pytest.raises(ValueError) as error:
        from_table(table)
    assert says in str(error.value)


# --- designs ---------------------------------------------------------------------------------


@pytest.mark.fast
@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"distribution": ["uniform"]}, "distribution = ['uniform']"),
        ({"distribution": "uniform", "low": 0, "high": 10**400}, "high: a number of 1329 bits"),
        ({"distribution": "lognormal", "median": 1e300, "deviation": 99.0}, "too wide"),
    ],
)
def test_what_is_no_distribution_at_all_is_refused(table, says):
    with pytest.raises(ValueError) as error:
        from_table(table)
    assert says in str(error.value)


@pytest.mark.fast
@pytest.mark.parametrize("name", DESIGNS)
def test_a_row_depends_on_seed_and_number_alone(name):
    dimensions, runs = 3, {"corners": 8, "saltelli": 40}.get(name, 64)
    design = DESIGNS[name]
    whole = design.rows(7, runs, dimensions, 0, runs)
    assert whole.shape == (runs, dimensions) and (whole >= 0).all() and (whole <= 1).all()
    for size in (1, 5, 33):
        parts = [
            design.rows(7, runs, dimensions, start, min(start + size, runs))
            for start in range(0, runs, size)
        ]
        np.testing.assert_array_equal(np.concatenate(parts), whole)
    if name in ("random", "sobol"):
        np.testing.assert_array_equal(design.rows(7, 10**6, dimensions, 0, runs), whole)
    if name != "corners":
        assert not np.array_equal(design.rows(8, runs, dimensions, 0, runs), whole)


@pytest.mark.fast
def test_designs_are_what_their_names_say():
    hypercube = DESIGNS["lhs"].rows(0, 50, 4, 0, 50)
    slices = np.sort((hypercube * 50).astype(int), axis=0)
    assert (slices == np.arange(50)[:, None]).all()
    sobol = DESIGNS["sobol"].rows(0, 256, 4, 0, 256)
    assert (np.sort((sobol * 256).astype(int), axis=0) == np.arange(256)[:, None]).all()
    corners = DESIGNS["corners"].rows(0, 16, 4, 0, 16)
    assert len(np.unique(corners, axis=0)) == 16 and set(corners.ravel()) == {0.0, 1.0}
    independent = DESIGNS["random"].rows(0, 5000, 6, 0, 5000)
    assert stats.kstest(independent.ravel(), "uniform").pvalue > 1e-3
    assert np.abs(np.corrcoef(independent.T) - np.eye(6)).max() < 0.06
    a, ab, b = DESIGNS["saltelli"].rows(0, 24, 1, 0, 24).reshape(8, 3).T
    np.testing.assert_array_equal(ab, b)
    assert (a != b).all()


@pytest.mark.fast
@pytest.mark.parametrize(
    ("design", "runs", "says"),
    [
        ("corners", 100, "12 uncertain values have 4096 corners"),
        ("saltelli", 100, "needs 2^k x 14 runs, e.g. 112"),
        ("grid", 100, "must be one of random, lhs, sobol, corners, saltelli"),
        ("sobol", 0, "-n 0: must be >= 1"),
        ("sobol", 10**12, "must be <= 20000000 runs of all loops together"),
    ],
)
def test_a_design_that_does_not_fit_is_refused(design, runs, says):
    with pytest.raises(ValueError, match=says.replace("^", r"\^")):
        configure_sweep(REQUEST._replace(design=design, runs=runs))


# --- scenarios -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def case():
    return js.build("pi-circle", js.Timing(lap_time=0.02, laps=1))


MASS = {"path": "plant.mass", "distribution": "normal", "mean": 1.0, "deviation": 0.1}
LOAD = {"path": "plant.load", "distribution": "uniform", "low": 0.5, "high": 1.5}


@pytest.mark.fast
def test_metrics_are_named_before_anything_is_computed(case):
    loop = case.loop
    first = loop.reference.sample(case.path, jax.numpy.zeros((), jax.numpy.int32))
    report = loop.metric.finish(loop.metric.init(first))
    batch = jax.tree.map(lambda x: np.asarray(x)[None], report)
    assert metric_names(case) == tuple(metric_columns(batch, loop.plant))


@pytest.mark.fast
def test_factors_values_and_shared_draws(case):
    start = {
        "path": "start.offset", "distribution": "uniform", "low": -1e-4, "high": 1e-4,
        "relative": False,
    }  # fmt: skip
    found = space(case, [MASS, LOAD | {"shared": True}, start], ())
    assert found.dimensions() == 5
    values = draw(found, "lhs", 0, 400, 0, 400)
    factors = values["plant.mass"] / np.array([3.0e-3, 2.8e-3])
    assert factors.mean(axis=0) == pytest.approx([1, 1], abs=0.003)
    assert factors.std(axis=0) == pytest.approx([0.1, 0.1], rel=0.02)
    assert abs(np.corrcoef(factors.T)[0, 1]) < 0.15
    np.testing.assert_allclose(values["plant.load"][:, 0], values["plant.load"][:, 1])
    assert np.ptp(values["plant.load"][:, 0]) == pytest.approx(0.1, rel=0.02)
    assert np.abs(values["start.offset"]).max() == pytest.approx(1e-4, rel=0.02)
    columns = [name for item in found.uncertain for name in item.columns]
    assert columns == [
        "plant_mass_x_kg", "plant_mass_y_kg", "plant_load_x_N", "plant_load_y_N",
        "start_offset_x_m", "start_offset_y_m",
    ]  # fmt: skip


@pytest.mark.fast
def test_correlations_are_drawn(case):
    pairs = [
        {"between": ["plant.mass", "plant.load"], "value": 0.8},
        {"between": ["plant.mass.x", "plant.mass.y"], "value": -0.5},
    ]
    with pytest.raises(ValueError, match="not positive definite"):
        space(
            case,
            [MASS, LOAD],
            [*pairs, {"between": ["plant.load.x", "plant.load.y"], "value": 0.9}],
        )
    found = space(case, [MASS, LOAD], pairs[:1])
    whole = draw(found, "random", 3, 2000, 0, 2000)
    parts = [draw(found, "random", 3, 2000, i, i + 7) for i in (0, 7, 700)]
    for start, part in zip((0, 7, 700), parts, strict=True):
        for path, value in part.items():
            np.testing.assert_array_equal(value, whole[path][start : start + 7])
    rho = 6 / np.pi * np.arcsin(0.8 / 2)  # Spearman's of a Gaussian copula
    for axis in (0, 1):
        seen = stats.spearmanr(whole["plant.mass"][:, axis], whole["plant.load"][:, axis]).statistic
        assert seen == pytest.approx(rho, abs=0.03)
    across = stats.spearmanr(whole["plant.mass"][:, 0], whole["plant.load"][:, 1]).statistic
    assert abs(across) < 0.08
    assert stats.kstest(whole["plant.load"][:, 0], stats.uniform(0.05, 0.1).cdf).pvalue > 1e-3


@pytest.mark.fast
@pytest.mark.parametrize(
    ("spread", "says"),
    [
        ({"path": "plant.mas"}, "did you mean"),
        ({"path": "gains.slope"}, "unknown setting"),
        ({"distribution": "uniform", "low": 0.5, "high": 1.5}, "a spread has a path"),
        (MASS | {"deviation": -1}, "plant.mass: deviation = -1: must be > 0"),
        (MASS | {"shared": "yes"}, "shared = yes: must be true or false"),
        (MASS | {"path": "start.offset"}, "relative = false draws the values themselves"),
        (LOAD, "the spread of plant.load is given twice"),
    ],
)
def test_a_bad_spread_is_named(case, spread, says):
    with pytest.raises(ValueError, match=says):
        space(case, [LOAD, spread], ())


@pytest.mark.fast
@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"between": ["plant.mass", "plant.load"]}, "between = .two settings. and value"),
        ({"between": ["plant.mass", "plant.load"], "value": 1.0}, "= 1.0: must be > -1 and < 1"),
        ({"between": [1, 2], "value": 2}, "correlation of 1 and 2 = 2: must be > -1 and < 1"),
        ({"between": ["plant.mass", "plant.damping"], "value": 0.1}, "not among the spreads"),
        ({"between": ["plant.mass", "plant.load.x"], "value": 0.1}, "2 and 1 numbers"),
        ({"between": ["plant.mass", "plant.mass"], "value": 0.1}, "different ones"),
    ],
)
def test_a_bad_correlation_is_refused(case, table, says):
    with pytest.raises(ValueError, match=says):
        space(case, [MASS, LOAD], [table])


@pytest.mark.fast
def test_blocks_are_added_where_there_is_none(case):
    added = blocks.with_blocks(case, {"drive": "current_drive", "sensor": "noisy_encoder"})
    settings = uncertain_leaves(added)
    assert {"drive.delay", "drive.limit", "sensor.noise", "sensor.sensor.resolution"} <= set(
        settings
    )
    delay = {
        "path": "drive.delay",
        "distribution": "discrete",
        "values": [0, 1, 3],
        "relative": False,
    }
    found = space(added, [delay], ())
    assert longest_delay(found) == 3
    able = blocks.with_max_delay(added, longest_delay(found))
    assert able.loop.drive.max_delay == 3
    assert set(draw(found, "sobol", 0, 64, 0, 64)["drive.delay"].tolist()) == {0, 1, 3}
    for wrong in ({"drive": "motor"}, {"plant": "x"}):
        with pytest.raises(ValueError, match="must be one of"):
            blocks.with_blocks(case, wrong)
    with pytest.raises(ValueError, match="has its own"):
        blocks.with_blocks(added, {"drive": "current_drive"})


def test_values_of_reference_and_drive_may_be_uncertain():
    """A motion that is computed in the tick has parameters of its own; each run its own delay."""
    built = js.build("sim1")
    light = js.replace(built.loop, metric=tracking)
    spreads = [
        {"path": "reference.amplitude", "distribution": "uniform", "low": 0.5, "high": 1.5},
        {"path": "drive.delay", "distribution": "discrete", "values": [0, 1], "relative": False},
    ]
    found = space(built, spreads, ())
    case = blocks.with_max_delay(built._replace(loop=light), longest_delay(found))
    values = draw(found, "sobol", 0, 4, 0, 4)
    drawn = batch(case, values, np.arange(4, dtype=np.uint32))
    run = js.rollouts(
        case.loop, drawn.gains, drawn.scenario, drawn.path, 50, in_axes=drawn.in_axes, tile=4
    )
    for lane in range(4):
        path = js.replace(case.path, amplitude=values["reference.amplitude"][lane])
        drive = js.replace(case.scenario.drive, delay=values["drive.delay"][lane])
        scenario = js.replace(case.scenario, drive=drive)
        single = js.simulate(case.loop, case.gains, scenario, path, 50).report.tracking_max
        assert run.report.tracking_max[lane] == pytest.approx(float(single), rel=1e-9)
    assert len(set(np.asarray(run.report.tracking_max))) == 4


# --- configuration ---------------------------------------------------------------------------

FILE = """
[blocks]
drive = "current_drive"

[plant]
damping = 0.11

[[spread]]
path = "plant.mass"
distribution = "normal"
mean = 1.0
deviation = 0.1

[[spread]]
path = "drive.delay"
distribution = "discrete"
values = [0, 2]
relative = false
"""


def written(folder, text, name="scenario.toml"):
    file = Path(folder) / name
    file.write_text(text)
    return file


def test_a_scenario_file_is_all_in_the_configuration(tmp_path):
    found = text(scenario=written(tmp_path, FILE))
    plan = build(found)
    assert build(found) is plan, "nothing is compiled twice"
    (case,), (uncertain,) = plan.cases, plan.spaces
    assert case.loop.drive.max_delay == 2
    assert np.asarray(case.scenario.plant.damping).tolist() == [0.11, 0.11]
    assert [item.path for item in uncertain.uncertain] == ["plant.mass", "drive.delay"]
    assert (plan.chunks, plan.size) == (6, 3)
    told = differences(text(), found)
    assert "blocks.drive: none -> current_drive" in told
    assert "loop.pi-circle.values.plant.damping: [0.1, 0.12] -> [0.11, 0.11]" in told
    assert digest(found) != digest(text()) == digest(configure_sweep(REQUEST))
    assert differences(found, found) == []
    seeds = batch_of(plan, 0, np.arange(3), drawn_values(plan, 0, 0, 3)).scenario.key
    assert len(np.unique(jax.random.key_data(seeds), axis=0)) == 3


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("deviation = 0.1", "deviation = -0.1", "scenario.toml:8: plant.mass: deviation = -0.1"),
        ("deviation = 0.1", "deviation = 0.9", "of run "),
        ("values = [0, 2]", "values = [0, 0.5]", "must be a whole number"),
        ("[[spread]]", "[spread]", "scenario.toml"),
        ('"plant.mass"', '"plant.maas"', "scenario.toml:8: unknown setting 'plant.maas'"),
        ("damping = 0.11", "damping = -1", "scenario.toml:6: plant.damping (x)"),
        ('"current_drive"', '"servo"', "scenario.toml:3: blocks.drive = servo"),
        ('"current_drive"', '["servo"]', "scenario.toml:3: blocks.drive = ['servo']: must be one"),
        ("[blocks]\ndrive =", "blocks =", "scenario.toml:2: write a table: [blocks], then drive"),
        ("values = [0, 2]", "values = [0, 1e9]", "drive.delay = 1e+09 periods: must be <= 100000"),
    ],
)
def test_a_bad_scenario_file_is_one_line(tmp_path, old, new, says):
    count = -1 if old != "[[spread]]" else 2
    file = written(tmp_path, FILE.replace(old, new, count))
    with pytest.raises(ValueError) as error:
        text(scenario=file, runs=64)
    assert says in str(error.value) and "\n" not in str(error.value)
