"""Yield, statistics, specifications and sensitivities, on what is known exactly."""

import math

import numpy as np
import pytest
from scipy import special, stats

from tuning.sweeps.sensitivity import at_the_ends, rank_correlation, sobol_indices
from tuning.uncertainty.designs import DESIGNS
from tuning.uncertainty.specification import parse
from tuning.uncertainty.statistics import (
    OPEN,
    REFUTED,
    SHOWN,
    bootstrap,
    claim,
    metric_statistics,
    paired,
    percentile,
    share,
    worst_mean,
)

# --- shares ----------------------------------------------------------------------------------


@pytest.mark.fast
@pytest.mark.parametrize("runs", [20, 137])
@pytest.mark.parametrize("truth", [0.003, 0.1, 0.5, 0.95])
def test_the_interval_of_a_share_covers_at_least_so_often(runs, truth):
    """Exactly, by adding up the binomial over all outcomes; and not by being everything."""
    found = [share(count, runs) for count in range(runs + 1)]
    weight = stats.binom.pmf(np.arange(runs + 1), runs, truth)
    covers = np.array([s.low <= truth <= s.high for s in found])
    assert 0.95 <= weight @ covers <= 1.0
    assert weight @ np.array([s.high - s.low for s in found]) < 4.5 / math.sqrt(runs)


@pytest.mark.fast
def test_no_failure_in_few_runs_shows_little():
    """Nothing failed in 100 runs: the yield may still be 96.4 %."""
    found = share(100, 100)
    assert found.low == pytest.approx(0.025 ** (1 / 100)) and found.high == 1.0
    open_claim = claim(found, 0.99)
    assert open_claim.verdict == OPEN
    assert open_claim.needed == pytest.approx(math.log(0.025) / math.log(0.99), rel=0.03)
    assert claim(share(400, 400), 0.99).verdict == SHOWN
    assert claim(share(380, 400), 0.99).verdict == REFUTED
    assert claim(found, 0.96).verdict == SHOWN
    decided = claim(share(open_claim.needed, open_claim.needed), 0.99)
    assert decided.verdict == SHOWN
    for wrong in (0.0, 1.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="must be > 0 and < 1"):
            claim(found, wrong)


# --- bootstrap -------------------------------------------------------------------------------

SIGMA, RUNS, REPEATS = 0.5, 1000, 120
TRUE = {
    "mean": math.exp(SIGMA**2 / 2),
    "p50": 1.0,
    "p95": math.exp(SIGMA * special.ndtri(0.95)),
    "cvar95": math.exp(SIGMA**2 / 2) * special.ndtr(SIGMA - special.ndtri(0.95)) / 0.05,
}


@pytest.fixture(scope="module")
def log_normal():
    """Statistics of many small sweeps whose figure is log-normal."""
    source = np.random.default_rng(1)
    return [metric_statistics(np.exp(SIGMA * source.standard_normal(RUNS))) for _ in range(REPEATS)]


@pytest.mark.parametrize(
    ("name", "least"), [("mean", 0.9), ("p50", 0.9), ("p95", 0.9), ("cvar95", 0.84)]
)
def test_intervals_cover_the_truth(log_normal, name, least):
    """95 % is asked for; the tail's mean is known to be covered less often (92 %)."""
    found = [getattr(one, name) for one in log_normal]
    covered = np.mean([i.low <= TRUE[name] <= i.high for i in found])
    assert least <= covered
    assert np.mean([i.value for i in found]) == pytest.approx(TRUE[name], rel=0.02)
    width = np.mean([i.high - i.low for i in found])
    spread = np.std([i.value for i in found])
    assert width == pytest.approx(2 * 1.96 * spread, rel=0.25), "neither too wide nor too narrow"


@pytest.mark.fast
def test_too_few_runs_are_said_aloud():
    values = np.random.default_rng(0).random(150)
    found = metric_statistics(values)
    assert found.p95 is None and found.reasons["p95"] == "not enough samples: needs 200 runs"
    assert found.cvar95 is None and found.reasons["cvar95"].endswith("needs 1000 runs")
    assert found.mean and found.p50
    few = metric_statistics(values[:10])
    assert few.p50 is None and "needs 20 runs" in few.reasons["p50"]
    one = metric_statistics(values[:1])
    assert one.mean is None and "1 of 1 runs have a value" in one.reasons["mean"]


@pytest.mark.fast
def test_lost_runs_count_as_worst():
    values = np.random.default_rng(0).random(1000)
    values[:30] = np.nan
    found = metric_statistics(values)
    everything = np.where(np.isnan(values), np.inf, values)
    assert found.p95.value == np.percentile(everything, 95, method="higher")
    assert found.mean.value == pytest.approx(np.nanmean(values))
    assert found.cvar95 is None and "30 of 1000 runs" in found.reasons["cvar95"]
    values[:49] = np.nan
    near = metric_statistics(values)
    assert math.isfinite(near.p95.value) and near.p95.high == math.inf
    values[:60] = np.nan
    assert metric_statistics(values).p95 is None and metric_statistics(values).p50 is not None
    lost = metric_statistics(np.full(300, np.nan))
    assert lost[:4] == (None,) * 4


@pytest.mark.fast
def test_the_worst_mean_is_that_of_the_worst_five_per_cent():
    values = np.random.default_rng(3).permutation(np.arange(1.0, 201))
    assert worst_mean(values) == np.mean(np.arange(191.0, 201))
    assert percentile(95)(values) == 191
    both = bootstrap(values, np.mean)
    assert both == bootstrap(values, np.mean) and both.low < both.value < both.high


# --- the same plants -------------------------------------------------------------------------


@pytest.mark.fast
def test_controllers_are_compared_plant_by_plant():
    """The spread of the plants is large, the difference small: pairs show it."""
    source = np.random.default_rng(0)
    plant = 100 * source.random(400)
    a, b = plant + 1 + 0.5 * source.random(400), plant + 1.5
    found = paired("a", a, "b", b)
    assert found.difference.high < 0 and found.difference.value == pytest.approx(np.mean(a - b))
    assert found.better.count == np.sum(a < b)
    a[:5], b[3:8] = np.nan, np.nan
    lost = paired("a", a, "b", b)
    survived = np.isfinite(a) & np.isfinite(b)
    assert lost.difference.value == pytest.approx(np.mean((a - b)[survived]))
    assert lost.better.count == np.sum((a < b)[survived]) + 3, "lost by b alone: plants 5, 6, 7"
    assert lost.better.of == lost.plants == 400 and lost.survived == 392


# --- specification ---------------------------------------------------------------------------

KINDS = {"x_um": float, "y_um": float, "finite": bool}
ROWS = {
    "x_um": np.array([1.0, 5.0, np.nan, 30.0]),
    "y_um": np.array([2.0, 2.0, 2.0, -2.0]),
    "finite": np.array([True, True, False, True]),
}


@pytest.mark.fast
@pytest.mark.parametrize(
    ("text", "passes"),
    [
        ("x_um < 20", [1, 1, 0, 0]),
        ("x_um < 20 and finite", [1, 1, 0, 0]),
        ("not (x_um < 20)", [0, 0, 0, 1]),
        ("x_um != 5", [1, 0, 0, 1]),
        ("finite", [1, 1, 0, 1]),
        ("not finite", [0, 0, 1, 0]),
        ("0 < y_um <= x_um", [0, 1, 0, 0]),
        ("x_um / y_um > 1 or x_um - 2 * y_um < -2.5", [1, 1, 0, 0]),
        ("-y_um == 2.0", [0, 0, 0, 1]),
        ("  x_um<2e1  ", [1, 1, 0, 0]),
        ("20 > x_um", [1, 1, 0, 0]),
        ("1 / (x_um - 1) > 1e300", [1, 0, 0, 0]),
    ],
)
def test_a_specification_decides(text, passes):
    """A run without a value does not pass, whichever way round it is asked."""
    assert parse(text, KINDS).passes(ROWS).tolist() == [bool(p) for p in passes]


@pytest.mark.fast
def test_a_specification_knows_its_limits():
    assert parse("x_um < 20 and finite and 3 > y_um", KINDS).limits == {"x_um": 20.0, "y_um": 3.0}
    assert parse("x_um < 20 or y_um < 3", KINDS).limits == {}
    assert parse("x_um + 1 < 20", KINDS).limits == {}


@pytest.mark.fast
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("z_um < 20", "unknown column 'z_um'; did you mean"),
        ("x_um <", "at character"),
        ("x_um", "is a number: compare it"),
        ("1 < 2", "reads no column"),
        ("finite < 3", "'finite' is a condition, not a number"),
        ("x_um and finite", "'x_um' is a number, not a condition"),
        ("__import__('os').system('ls')", "is not part of the language"),
        ("x_um.real < 3", "'x_um.real' is not part of the language"),
        ("x_um ** 9 < 3", "is not part of the language"),
        ("(lambda: 3)() < 3", "is not part of the language"),
        ("x_um in (1, 2)", "only < <= > >= == != compare"),
        ("x_um < 'a'", "is not part of the language"),
        ("True", "is not part of the language"),
        ("x_um < 1j", "is not part of the language"),
        ("x_um if finite else y_um", "is not part of the language"),
        ("x_um < 3; import os", "at character"),
        ("", "at character"),
        ("(" * 400 + "x_um", ""),
        ("-" * 990 + "x_um < 1", ""),
        ("x_um < 1 or " * 200 + "finite", "longer than"),
    ],
)
def test_a_bad_specification_is_one_line(text, says):
    with pytest.raises(ValueError) as error:
        parse(text, KINDS)
    told = str(error.value)
    assert told.startswith("--spec '") and says in told and "\n" not in told
    assert len(told) < 400


# --- sensitivity -----------------------------------------------------------------------------


def test_sobol_indices_of_a_function_with_known_ones():
    """Ishigami: y = sin a + 7 sin^2 b + 0.1 c^4 sin a with a, b, c uniform in -pi..pi."""
    base = 2048
    cube = DESIGNS["saltelli"].rows(0, base * 5, 3, 0, base * 5)
    a, b, c = (np.pi * (2 * cube - 1)).T
    y = np.sin(a) + 7 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)
    variance = 7**2 / 8 + 0.1 * np.pi**4 / 5 + 0.1**2 * np.pi**8 / 18 + 0.5
    first = np.array([0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2, 7**2 / 8, 0.0]) / variance
    both = 8 * 0.1**2 * np.pi**8 / 225 / variance
    total = first + np.array([both, 0.0, both])
    found = sobol_indices(("a", "b", "c"), y)
    np.testing.assert_allclose(found.first, first, atol=0.02)
    np.testing.assert_allclose(found.total, total, atol=0.02)
    assert (np.abs(found.first - first) <= 1.5 * found.first_error).all()
    assert (np.abs(found.total - total) <= 1.5 * found.total_error).all()
    assert (found.total_error > 0).all() and (found.total_error < 0.1).all()
    lost = y.copy()
    lost[[7, 5003]] = np.nan
    near = sobol_indices(("a", "b", "c"), lost)
    assert near.dropped == pytest.approx(2 / base)
    np.testing.assert_allclose(near.total, total, atol=0.02)
    lost[::7] = np.nan
    with pytest.raises(ValueError, match="blocks hold a lost run"):
        sobol_indices(("a", "b", "c"), lost)


@pytest.mark.fast
def test_rank_correlation_and_the_ends_of_a_sweep():
    x = np.random.default_rng(0).random(500)
    assert rank_correlation(x, np.exp(5 * x)) == pytest.approx(1)
    assert rank_correlation(x, -(x**3)) == pytest.approx(-1)
    assert rank_correlation(x, np.ones(500)) is None
    y = np.where(x < 0.5, np.nan, x)
    lost_as_worst = stats.spearmanr(x, np.where(np.isnan(y), 2.0, y)).statistic
    assert rank_correlation(x, y) == pytest.approx(lost_as_worst) and lost_as_worst < -0.2
    assert rank_correlation(np.round(x), np.where(x < 0.5, np.nan, 3.0)) == pytest.approx(-1)
    assert rank_correlation(x, np.full(500, np.nan)) is None
    low, high = at_the_ends(x, x**2)
    ordered = np.sort(x)
    assert low == np.median(ordered[:50] ** 2) and high == np.median(ordered[-50:] ** 2)
    assert at_the_ends(x[:50], x[:50]) is None and at_the_ends(x, y) is None
