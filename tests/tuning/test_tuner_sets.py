"""Training and held-out runs: what the defaults are, what a file says, what is refused."""

import functools
import re
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from jaxstage.metrics import columns
from tuning.app.comparison import find_study, gains_files, other_gains
from tuning.store.gains_file import NO_GAINS
from tuning.store.prepare import prepare
from tuning.tuner.evidence.validation import (
    PairedRuns,
    Validation,
    ValidationRuns,
    held_out_verdict,
    refusals,
    simulate_metrics,
    simulate_pairs,
    warnings,
    with_light_metric,
)
from tuning.tuner.evidence.worst_case import worst_plants
from tuning.tuner.problem import default_sets as training
from tuning.tuner.problem.default_sets import LoopSpec, longer, shortened, spreads_of
from tuning.tuner.problem.objective import Objective, parse_goals
from tuning.tuner.problem.problem import Evaluation
from tuning.tuner.problem.scenario_set import (
    ContourSpec,
    SetSpec,
    count_runs,
    run_sets,
    set_table,
    widened,
)
from tuning.tuner.problem.set_file import ScenarioSets, read_sets, refuse_overlap
from tuning.tuner.report import verdict_text
from tuning.tuner.session import missed_goals
from tuning.uncertainty.scenario_file import NO_SCENARIO

#: laps of 50 ms: paths of 500 ticks
FAST = ("lap_time=0.05", "laps=1", "scored=0")


@functools.cache
def loop_spec(loop="pi-circle", words=FAST):
    spreads = tuple(spreads_of(loop, NO_SCENARIO))
    return LoopSpec(loop, words, NO_GAINS, NO_SCENARIO, spreads, 7)


def sets_of(file, spec):
    return read_sets(file, spec, prepare(spec.loop, spec.words).case)


@functools.cache
def default():
    return sets_of(None, loop_spec())


def set_spec(**changes):
    plain = SetSpec(
        contours=(ContourSpec("pi-circle", FAST),),
        plants=3,
        nominal=True,
        noise_seeds=2,
        seed=1,
        spreads=loop_spec().spreads,
    )
    return plain._replace(**changes)


# --- what is taken where nothing was said --------------------------------------------------------


def test_training_runs_are_short_and_judged_after_the_start():
    long = js.Timing(lap_time=5.0, laps=2)
    short = shortened(long)
    assert short.lap_time == 1.0 and short.duration == 1.0 and short.skip == 0.2
    assert short.duration / short.dt == training.TRAINING_TICKS
    far = longer(long)
    assert far.lap_time == 5.0 and far.duration == 4.0 and far.skip == 0.8


def test_a_loop_that_judges_whole_runs_or_has_a_start_of_its_own_keeps_that():
    whole = shortened(js.Timing(lap_time=10.0, laps=1, scored=0, dt=2e-4))
    assert whole.skip is None and whole.scored == 0 and whole.duration == 2.0
    own = shortened(js.Timing(lap_time=20.0, laps=1, dt=5e-3, skip=1.0))
    assert own.skip == 1.0 and own.duration == 20.0 and own.lap_time == 20.0
    several = shortened(js.Timing(lap_time=0.3, laps=9))
    assert several.lap_time == 0.3 and several.duration == pytest.approx(0.9)
    fed = shortened(js.Timing(feed=600.0))
    assert fed.feed == 600.0 and fed.duration == 1.0


def test_the_held_out_runs_are_apart():
    """Other contours, another seed, four times as long; plants at least 20 % apart."""
    sets = default()
    assert [c.loop for c in sets.train.contours] == ["pi-circle", "pi-star"], "and sharp corners"
    assert {c.loop for c in sets.held_out.contours} == {"pi-bowknot", "pi-heart"}
    assert sets.held_out.plants == 100 and sets.held_out.seed != sets.train.seed
    assert sets.held_out.horizons == (4 * sets.train.horizons[0],)
    for spread in sets.held_out.spreads:
        assert spread["low"] <= 0.8 and spread["high"] >= 1.2
    table = set_table(sets.held_out._replace(plants=7))
    runs = run_sets(table, {})
    assert [len(one.labels) for one in runs] == [4, 3] and count_runs(table) == 7
    assert len({tuple(m) for one in runs for m in one.values["plant.mass"]}) == 7


def test_without_another_contour_the_motion_is_spread():
    sets = sets_of(None, loop_spec("none", ()))
    paths = [spread["path"] for spread in sets.held_out.spreads]
    assert [c.loop for c in sets.held_out.contours] == ["none"]
    assert {"reference.radius", "reference.turn_rate", "reference.climb_rate"} < set(paths)
    assert not any(spread["path"].startswith("reference") for spread in sets.train.spreads)


def test_only_narrow_uniform_factors_are_widened():
    narrow = {"path": "a", "distribution": "uniform", "low": 0.95, "high": 1.3}
    normal = {"path": "b", "distribution": "normal", "mean": 1.0, "deviation": 0.01}
    plain = narrow | {"relative": False}
    found = widened([narrow, normal, plain], 0.2)
    assert (found[0]["low"], found[0]["high"]) == (0.8, 1.3)
    assert found[1:] == [normal, plain]


# --- runs ----------------------------------------------------------------------------------------


def test_every_combination_once():
    table = set_table(
        set_spec(
            contours=(ContourSpec("pi-circle", FAST), ContourSpec("pi-star", FAST)),
            horizons=(0.02, 0.03),
            starts=({"offset": [0.0, 0.0]}, {"offset": [1e-4, 0.0]}),
        )
    )
    runs = run_sets(table, {})
    assert count_runs(table) == sum(len(one.labels) for one in runs) == 2 * 2 * 2 * 4 * 2
    assert [(one.case.name, one.case.window.ticks) for one in runs] == [
        ("pi-circle", 200),
        ("pi-circle", 300),
        ("pi-star", 200),
        ("pi-star", 300),
    ]
    one = runs[0]
    assert len(set(one.labels)) == len(one.labels) == 16 and len(set(one.seeds)) == 16
    offsets = one.values["start.offset"][:, 0]
    assert offsets.tolist() == [0.0] * 8 + [1e-4] * 8
    mass = one.values["plant.mass"]
    np.testing.assert_array_equal(mass[:8], mass[8:])
    np.testing.assert_array_equal(mass[0], np.asarray(one.case.scenario.plant.mass))
    assert np.array_equal(mass[0], mass[1]), "two noise seeds of one plant"


def test_plants_depend_on_the_seed_and_their_number_alone():
    some, more = (run_sets(set_table(set_spec(plants=n)), {})[0].values for n in (3, 6))
    other = run_sets(set_table(set_spec(seed=2)), {})[0].values
    for path in some:
        np.testing.assert_array_equal(more[path][: len(some[path])], some[path])
    assert not np.array_equal(some["plant.mass"][2:], other["plant.mass"][2:])


def test_plants_that_cannot_exist_are_passed_over():
    """With +-20 % on both, some static frictions would fall below Coulomb friction."""
    values = run_sets(set_table(set_spec(plants=60)), {})[0].values
    assert np.all(values["plant.static"] >= values["plant.coulomb"])
    names = run_sets(set_table(set_spec(plants=60)), {})[0].labels
    assert int(names[-1].split("plant ")[1].split(",")[0]) > 59
    none = [{"path": "plant.mass", "distribution": "uniform", "low": -2.0, "high": -1.0}]
    with pytest.raises(ValueError, match="only 0 can exist"):
        run_sets(set_table(set_spec(spreads=tuple(none))), {})


def test_loops_of_other_laws_do_not_train_together():
    both = (ContourSpec("pi-circle", FAST), ContourSpec("cmac-circle", FAST))
    with pytest.raises(ValueError, match=r"different laws \(pi, cmac_sliding"):
        set_table(set_spec(contours=both))


# --- the file ------------------------------------------------------------------------------------

FILE = """
[train]
plants = 2
seed = 5
[[train.contour]]
loop = "pi-circle"
set = ["lap_time=0.1", "laps=1", "scored=0"]
[[train.contour]]
loop = "pi-star"
set = ["lap_time=0.1", "laps=1", "scored=0"]
[[train.start]]
offset = [1e-5, 0.0]

[held_out]
plants = 9
noise_seeds = 2
"""


def test_a_file_says_what_it_says_and_defaults_the_rest(tmp_path):
    file = tmp_path / "train.toml"
    file.write_text(FILE)
    sets = sets_of(file, loop_spec())
    train, held_out = sets
    assert [c.loop for c in train.contours] == ["pi-circle", "pi-star"]
    assert train.horizons == () and train.skip is None, "the timing of the contours counts"
    assert (train.plants, train.seed, train.nominal) == (2, 5, True)
    assert train.starts == ({"offset": [1e-5, 0.0]},) and train.spreads == loop_spec().spreads
    assert held_out == default().held_out._replace(plants=9, noise_seeds=2)
    assert run_sets(set_table(train), {})[1].case.window.ticks == 1000


def test_the_file_of_the_documentation_is_read(tmp_path):
    text = (Path(__file__).parents[2] / "docs" / "tuning.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    file = tmp_path / "train.toml"
    file.write_text(block)
    train, held_out = sets_of(file, loop_spec("dfcmac-circle"))
    assert train.contours == (ContourSpec("dfcmac-circle", ("lap_time=1",)),)
    assert train.horizons == (1.0,) and train.skip == 0.2 and len(train.spreads) == 1
    assert held_out.plants == 100 and held_out.dealt


WRONG = {
    "key": ("[train]\nplant = 3", ":2: [train] unknown key 'plant'; did you mean 'plants'"),
    "table": ("[tain]\nplants = 3", ":2: 'tain.plants' is not in [train], [held_out]"),
    "count": ("[train]\nseed = 1\nplants = -3", ":3: [train] plants = -3: must be a whole number"),
    "flag": ("[held_out]\nnominal = 1", ":2: [held_out] nominal = 1: must be true or false"),
    "horizon": ("[train]\nhorizons = [0.0]", ":2: [train] horizons = 0.0: must be > 0 s"),
    "horizons": ("[train]\nhorizons = 1", ":2: [train] horizons = 1: must be a list"),
    "skip": ("[train]\nskip = -1", ":2: [train] skip = -1: must be >= 0 s"),
    "nan": ("[train]\nskip = nan", ":2: [train] skip = nan: must be >= 0 s"),
    "seed": ("[train]\nseed = -1", ":2: [train] seed = -1: must be a whole number"),
    "design": ('[train]\ndesign = "corners"', ":2: [train] design = corners: must be one of"),
    "loop": ('[[train.contour]]\nloop = "pi-cirle"', ":1: [train] unknown loop 'pi-cirle'"),
    "contour": ("[[train.contour]]\nlop = 1", ":1: [train] contour: unknown key 'lop'"),
    "words": ('[[train.contour]]\nloop = "pi-star"\nset = "a"', "set = a: must be a list"),
    "list": ('[train]\ncontour = "pi-star"', ":2: [train] write [[...contour]]"),
    "no plant": ("[train]\nplants = 0\nnominal = false", "[train] holds no plant"),
    "few": ("[held_out]\nplants = 1", "fewer plants than contours"),
    "toml": ("[train\n", "line 1"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_one_line_with_its_place(tmp_path, case):
    text, says = WRONG[case]
    file = tmp_path / "train.toml"
    file.write_text(text + "\n")
    with pytest.raises(ValueError) as told:
        sets_of(file, loop_spec())
    assert str(told.value).startswith(str(file)) and says in str(told.value)
    assert "\n" not in str(told.value)


def test_a_missing_file_and_a_held_out_set_that_is_no_other():
    with pytest.raises(ValueError, match="no such file"):
        sets_of(Path("none.toml"), loop_spec())
    same = ScenarioSets(set_spec(), set_spec())
    with pytest.raises(ValueError, match="the held-out set is the training set"):
        refuse_overlap(same)
    refuse_overlap(ScenarioSets(set_spec(), set_spec(seed=2)))


# --- verdicts ------------------------------------------------------------------------------------


def pairs(before, after):
    both = np.array([before, after], float)
    return PairedRuns("contour_rms_um", both[0], both[1], {"contour_rms_um": both})


def test_the_verdict_on_held_out_runs():
    rng = np.random.default_rng(0)
    before = rng.uniform(10, 20, 60)
    found = held_out_verdict(pairs(before, 0.4 * before))
    assert found.change.value == pytest.approx(-0.6) and found.lost == found.lost_before == 0
    assert found.before.low < before.mean() < found.before.high
    assert found.better.count == 60
    noisy = held_out_verdict(pairs(before, before * rng.uniform(0.2, 0.6, 60)))
    assert noisy.change.low < noisy.change.value < noisy.change.high < -0.5


def test_runs_that_one_of_both_lost_are_not_averaged():
    found = held_out_verdict(pairs([1.0, 2.0, 3.0, np.nan], [0.5, 1.0, np.nan, 9.0]))
    assert found.before.value == 1.5 and found.after.value == 0.75
    assert (found.lost_before, found.lost, found.better.count) == (1, 1, 3)
    assert found.others["contour_rms_um"] == (1.5, 0.75)
    gone = held_out_verdict(pairs([1.0, np.nan], [np.nan, 2.0]))
    assert gone.before is gone.change is None and gone.lost == 1


def test_what_was_lost_and_is_held_is_accepted():
    """Absolute numbers where there is nothing before to compare with."""
    lost = np.full(40, np.nan)
    verdict = held_out_verdict(pairs(lost, np.linspace(5.0, 9.0, 40)))
    assert verdict.before is verdict.change is None and verdict.after.value == pytest.approx(7.0)
    assert (verdict.lost_before, verdict.lost) == (40, 0)
    assert verdict.others["contour_rms_um"] == (None, pytest.approx(7.0))
    assert refusals(VALIDATION, verdict) == ()
    text = verdict_text(verdict)
    assert text.startswith("contour rms 7 um (") and "0 lost, 40 before" in text
    (refused,) = refusals(VALIDATION, held_out_verdict(pairs(lost, lost)))
    assert refused.reason == "too few held-out runs are left to compare"


GOOD = ValidationRuns((10.0, 4.0), (1.0, 0.3), 0)
VALIDATION = Validation(GOOD, GOOD, GOOD, ())
PLANTS = np.linspace(5.0, 9.0, 40)


@pytest.mark.parametrize(
    ("changes", "after", "says"),
    [
        ({"missed": ("the goal a < 1 is not met: a = 2",)}, 0.5, "the goal a < 1 is not met"),
        (
            {"exact": ValidationRuns((10.0, 4.0), (1.0, 1.0), 0)},
            0.5,
            "on the exact model did not fall",
        ),
        (
            {"exact": ValidationRuns((10.0, 4.0), (1.0, np.nan), 0)},
            0.5,
            "on the exact model did not fall",
        ),
        ({"exact": ValidationRuns((10.0, np.nan), (1.0, 1e6), 2)}, 0.5, "2 training runs are lost"),
        ({"half_step": GOOD._replace(lost=1)}, 0.5, "with half the step 1 runs are lost"),
        ({"half_step": GOOD._replace(metric=(10.0, 5.0))}, 0.5, "depends on the integration"),
        (
            {"longer": GOOD._replace(objective=(1.0, 1.2))},
            0.5,
            "with 4 times the time and other plants the obj",
        ),
        ({"longer": GOOD._replace(metric=(30.0, 9.0))}, 0.5, "the metric grows from 4 to 9"),
        ({}, 1.01, "is not shown to be a gain"),
        ({}, np.nan, "40 of 40 held-out runs are lost, 0 before"),
    ],
)
def test_what_is_refused_says_why(changes, after, says):
    verdict = held_out_verdict(pairs(PLANTS, after * PLANTS))
    refused = refusals(VALIDATION._replace(**changes), verdict)
    assert any(says in one.reason for one in refused), refused
    for one in refused:
        assert "\n" not in one.reason + one.advice
        assert "--" in one.advice, "it names an option"


def test_what_is_better_everywhere_is_accepted():
    assert refusals(VALIDATION, held_out_verdict(pairs(PLANTS, 0.5 * PLANTS))) == ()


def test_effort_that_grows_tenfold_is_warned_of():
    """Of each metric the worst axis, and what would have priced it; nothing else is told."""
    runs = np.ones((2, 5))
    columns = {
        "contour_rms_um": runs,
        "command_rms_x_A": runs * [[0.1], [2.0]],
        "command_rms_y_A": runs * [[0.1], [3.8]],
        "chattering_x_A": runs * [[0.1], [0.9]],
        "energy_J": runs * [[27.0], [115100.0]],
        "energy_copper_J": runs * [[1.0], [100.0]],
        "following_max_x_um": runs * [[1.0], [100.0]],
    }
    verdict = held_out_verdict(PairedRuns("contour_rms_um", runs[0], 0.5 * runs[0], columns))
    first, second = warnings(verdict, ("x", "y"))
    assert first.startswith("command_rms_y_A grows from 0.1 to 3.8, 38 times: --objective")
    assert "0.1*command_rms_A'" in first
    assert second.startswith("energy_J grows from 27 to 1.151e+05, 4.26e+03 times")
    assert warnings(verdict._replace(others={}), ("x", "y")) == ()


def test_held_out_runs_are_simulated_under_both_gains():
    """Bit for bit the figure of `jaxstage run` of the nominal plant, under each of the gains."""
    (one,) = run_sets(set_table(set_spec(plants=1, noise_seeds=1)), {})
    slower = js.replace(one.case.gains, slope=one.case.gains.slope * 3)
    found = simulate_pairs([one], one.case.gains, slower, "contour_rms_um")
    for gains, metric in ((one.case.gains, found.before), (slower, found.after)):
        run = jax.block_until_ready(one.case._replace(gains=gains).simulate())
        plain = float(run.report["contour"].contour_rms) * 1e6
        assert metric[0] == pytest.approx(plain, rel=1e-10) and metric[1] != metric[0]
    axes = simulate_pairs([one], one.case.gains, slower, "following_rms_um")
    each = [axes.columns[f"following_rms_{axis}_um"][0] for axis in "xy"]
    np.testing.assert_allclose(axes.before, np.sqrt(np.mean(np.square(each), axis=0)))


def test_a_goal_that_is_missed_says_where_and_by_what():
    class Problem(NamedTuple):
        objective: Objective
        run_names: tuple

    columns = {"contour_max_um": np.array([[9.0, 9.0], [3.0, 31.0]]), "growth": np.ones((2, 2))}
    goals = parse_goals("contour_max_um < 20 and growth < 2", columns)
    problem = Problem(Objective((), goals), ("circle 0", "circle 1"))
    found = Evaluation(np.zeros(2), np.zeros((2, 2)), np.zeros(2), np.full((2, 2), np.nan), columns)
    assert missed_goals(problem, found, 0) == ()
    assert missed_goals(problem, found, 1) == (
        "the goal contour_max_um < 20 is not met: contour_max_um = 31 in circle 1",
    )
    columns["contour_max_um"][1, 0] = np.nan
    assert "contour_max_um = nan in circle 0" in missed_goals(problem, found, 1)[0]


def test_the_worst_plants_are_those_that_simulation_shows():
    (one,) = run_sets(set_table(set_spec(noise_seeds=1)), {})
    found = worst_plants([one], one.case.gains, "contour_rms_um")
    shown = simulate_metrics(
        [one._replace(case=with_light_metric(one.case, "contour_rms_um"))], [one.case.gains]
    )
    order = np.argsort(-shown["contour_rms_um"][0])[:2]
    assert found.labels == tuple(one.labels[i] for i in order)
    assert found.worst == shown["contour_rms_um"].max()
    (added,) = found.added
    np.testing.assert_array_equal(added.seeds, one.seeds[order])
    np.testing.assert_array_equal(added.values["plant.mass"], one.values["plant.mass"][order])


# --- compare --gains -----------------------------------------------------------------------------


def test_a_loop_with_the_gains_of_its_study_and_of_a_file(tmp_path):
    file = tmp_path / "gains.toml"
    file.write_text("[gains]\nslope = 3.0\n\n[[tuned]]\ngain = 'gains.slope'\n")
    study = find_study("fuzzy-cmac")
    given = gains_files(study, [f"pi-circle={file}"])
    (found,) = other_gains(given, FAST)
    case = js.build("pi-circle", js.Timing(lap_time=0.05, laps=1, scored=0))
    assert found.loop == "pi-circle" and found.file == str(file)
    for gains, told in ((1.0, found.study), (3.0, found.given)):
        run = case._replace(gains=js.replace(case.gains, slope=jnp.full(2, gains))).simulate()
        plain = columns(run.report, case.loop.plant)
        assert told["contour_rms_um"] == pytest.approx(plain["contour_rms_um"], rel=1e-9)
    assert found.study["contour_rms_um"] != found.given["contour_rms_um"]


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("gains.toml", "must be LOOP=FILE"),
        ("pi-circle=", "must be LOOP=FILE"),
        ("pi-cirle=a.toml", "fuzzy-cmac has no such loop; did you mean 'pi-circle'"),
        ("none=a.toml", "has no such loop"),
    ],
)
def test_wrong_gains_to_compare(word, says):
    with pytest.raises(ValueError, match="--gains") as told:
        gains_files(find_study("fuzzy-cmac"), [word])
    assert says in str(told.value)
