"""Trade-offs, gains as a file, parameters without effect, words of the command line."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxstage as js
from jaxstage.model.settings import read_toml
from jaxstage.model.signals import Measurement
from tuning.app.reports.tuning import _gradients
from tuning.store.gains_file import TunedGain, read_gains, read_tuned, to_text
from tuning.store.prepare import prepare
from tuning.tuner.evidence.diagnostics import effects, unchecked
from tuning.tuner.evidence.worst_case import worst_of
from tuning.tuner.options import default_objective, parse_gains, parse_objective, search_of
from tuning.tuner.pictures import BeforeAfter, rule_pictures, rules_text, write_rules
from tuning.tuner.problem.objective import Term
from tuning.tuner.problem.transforms import logarithmic
from tuning.tuner.search.evaluation_log import logged
from tuning.tuner.search.pareto_front import hypervolume, knee, non_dominated, weights

pytestmark = pytest.mark.fast

POINTS = st.lists(st.tuples(*[st.integers(0, 6).map(float)] * 3), min_size=1, max_size=12).map(
    np.array
)


class Memory(NamedTuple):
    """The end of a run that never was."""

    memory: Any


class Ended(NamedTuple):
    """A run that never was."""

    final: Memory


# --- trade-offs --------------------------------------------------------------------------------


@given(POINTS)
@settings(max_examples=60, deadline=None)
def test_the_front_is_what_no_other_point_beats(points):
    kept = non_dominated(points)
    assert kept.any()
    for i, point in enumerate(points):
        beaten = any(np.all(p <= point) and np.any(p < point) for p in points)
        earlier = any(np.array_equal(p, point) for p in points[:i])
        assert kept[i] == (not beaten and not earlier)


def test_a_lost_run_is_on_no_front():
    points = np.array([[1.0, np.nan], [2.0, 2.0], [3.0, 1.0], [np.inf, 0.0]])
    assert non_dominated(points).tolist() == [False, True, True, False]


@given(POINTS)
@settings(max_examples=40, deadline=None)
def test_the_hypervolume_counts_the_boxes_that_are_beaten(points):
    """Against counting unit boxes, whose corners are whole numbers."""
    reference = np.array([7.0, 6.0, 5.0])
    corners = np.stack(np.meshgrid(*map(np.arange, reference), indexing="ij"), -1).reshape(-1, 3)
    beaten = np.any(np.all(points[:, None] <= corners[None], axis=2), axis=0)
    assert hypervolume(points, reference) == pytest.approx(beaten.sum())
    assert hypervolume(points[non_dominated(points)], reference) == pytest.approx(beaten.sum())


def test_the_knee_is_nearest_to_the_best_of_all():
    front = np.array([[0.0, 100.0], [1.0, 10.0], [10.0, 0.0]])
    assert knee(front) == 1
    assert knee(front * [1000.0, 1e-6]) == 1, "it does not depend on the units"
    with pytest.raises(ValueError, match="no point"):
        knee(np.empty((0, 2)))


def test_weights_cover_the_simplex():
    found = weights(3, 3)
    assert found.shape == (10, 3) and len({tuple(w) for w in found}) == 10
    np.testing.assert_allclose(found.sum(axis=1), 1.0)
    for corner in np.eye(3):
        assert any(np.array_equal(w, corner) for w in found)


# --- parameters --------------------------------------------------------------------------------


def test_a_parameter_without_effect_and_two_that_do_the_same():
    """Residuals that depend on a, on b + c and a little on b - c, and not on d."""
    jacobian = np.array([[2.0, 0, 0, 0], [0, 1, 1, 0], [0, 1e-3, -1e-3, 0]])
    found = effects(2 * jacobian.T @ jacobian, np.zeros(4), 1.0, ("a", "b", "c", "d"))
    assert found.insensitive == ("d",)
    assert found.redundant == (("b", "c"),)
    assert found.eigenvalues[0] == pytest.approx(0.0, abs=1e-12)
    apart = effects(np.diag([2.0, 1.0]), np.zeros(2), 1.0, ("a", "b"))
    assert apart.insensitive == apart.redundant == ()


def test_a_slope_alone_is_an_effect():
    found = effects(np.zeros((1, 1)), np.array([0.5]), 1.0, ("a",))
    assert found.insensitive == ()


def test_the_worst_are_the_lost_ones_and_the_earliest_first():
    figures = np.array([3.0, np.nan, 5.0, np.nan])
    lost_at = np.array([np.nan, 0.4, np.nan, 0.2])
    assert worst_of(figures, lost_at, 3).tolist() == [3, 1, 2]


# --- gains as a file ---------------------------------------------------------------------------


def test_tuned_gains_come_back_to_the_last_bit(tmp_path):
    case = js.build("cmac-circle")
    slope = jnp.asarray([1 / 3, np.pi])
    gains = js.replace(case.gains, slope=slope)
    tuned = [
        TunedGain("gains.slope", "c1", "1/s", np.full(2, 0.1), np.array([9.0, 10.0]), np.ones(2))
    ]
    file = tmp_path / "gains.toml"
    file.write_text(to_text(case, gains, tuned, ["tuned for\ncmac-circle"]))
    head = '# tuned for cmac-circle\nlaw = "cmac_sliding[crisp, exact]"\n\n[gains]\n'
    assert file.read_text().startswith(head)
    (found,) = read_tuned(file)
    assert found.gain == "gains.slope" and found.symbol == "c1" and found.unit == "1/s"
    assert found.low.tolist() == [0.1, 0.1] and found.high.tolist() == [9.0, 10.0]
    assert found.before.tolist() == [1.0, 1.0]
    assert read_toml(file).values["tuned"][0]["low"] == 0.1, "one number where all agree"
    again = prepare("cmac-star", [], gains=read_gains(file)).case.gains
    assert np.array_equal(again.slope, slope) and np.array_equal(again.weights, gains.weights)


def test_a_plain_file_holds_no_tuned_gains(tmp_path):
    file = tmp_path / "gains.toml"
    file.write_text("[gains]\nslope = 2.0\n")
    with pytest.raises(ValueError, match="holds no"):
        read_tuned(file)


# --- words -------------------------------------------------------------------------------------


def test_which_gains():
    found = parse_gains(["c1=0.1..10, eta:tied", "start.toml", "weights=-1..1:tanh", "rules:fixed"])
    assert str(found.file) == "start.toml"
    assert found.searches == (
        {"name": "c1", "low": 0.1, "high": 10.0},
        {"name": "eta", "tied": True},
        {"name": "weights", "low": -1.0, "high": 1.0, "transform": "tanh"},
        {"name": "rules", "fixed": True},
    )
    one = search_of({"name": "c1", "transform": "log"})
    assert one.name == "c1" and one.transform == logarithmic and one.low is None


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("c1=1..", "'' is not a number"),
        ("c1=a..2", "'a' is not a number"),
        ("c1=0.1..1e400", "'1e400' is not a finite number"),
        ("c1=nan..2", "'nan' is not a finite number"),
        ("c1=5", "must be NAME"),
        ("c1:tide", "':tide'; did you mean 'tied'"),
        ("", "must be NAME"),
    ],
)
def test_wrong_words_about_gains(word, says):
    with pytest.raises(ValueError, match="--gains") as told:
        parse_gains([word])
    assert says in str(told.value)


def test_two_files_to_start_from():
    with pytest.raises(ValueError, match="one file"):
        parse_gains(["a.toml", "b.toml"])


COLUMNS = ("contour_rms_um", "energy_J", "command_change_rms_A", "following_rms_um")


def test_an_objective_is_a_sum_of_weighted_figures():
    found = parse_objective("contour_rms_um/20 + 0.1*energy_J + 2*following_rms_um/4*0.5", COLUMNS)
    assert found == (
        Term("contour_rms_um", 1.0, 20.0),
        Term("energy_J", 0.1, None),
        Term("following_rms_um", 1.0, 4.0),
    )
    usual = default_objective(COLUMNS, "A")
    assert usual == "contour_rms_um + 0.1*command_change_rms_A + 0.1*energy_J"
    assert [term.weight for term in parse_objective(usual, COLUMNS)] == [1.0, 0.1, 0.1]
    assert default_objective(("following_rms_um",), "V") == "following_rms_um"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("contour_rm_um", "did you mean 'contour_rms_um'"),
        ("contour_rms_um + contour_rms_um", "stands twice"),
        ("contour_rms_um - energy_J", "must be weight"),
        ("contour_rms_um * energy_J", "must be weight"),
        ("1/energy_J", "must be weight"),
        ("3", "must be weight"),
        ("-1*energy_J", "must be weight"),
        ("0*energy_J", "must be > 0"),
        ("energy_J/0", "must be > 0"),
        ("energy_J +", "at character"),
        ("__import__('os')", "must be weight"),
        (
            "1" + 400 * "0" + "*energy_J",
            "a number: weights and scales must be > 0 and at most 1e+100",
        ),
        ("energy_J/1e400", "inf: weights and scales"),
        (" + ".join(["energy_J"] * 3000), "longer than 2000 characters"),
        ("(" * 900 + "energy_J" + ")" * 900, "too"),
        ("9" * 5000 + "*energy_J", "longer than 2000 characters"),
    ],
)
def test_wrong_objectives(text, says):
    with pytest.raises(ValueError, match="--objective") as told:
        parse_objective(text, COLUMNS)
    assert says in str(told.value) and "\n" not in str(told.value)
    assert len(str(told.value)) < 400


# --- evaluation log ----------------------------------------------------------------------------


def test_a_damaged_answer_is_computed_again(tmp_path):
    """Any byte of a file flipped, or the file cut anywhere: the right answer, never another one."""
    values = {"objective": np.arange(3.0), "costs": np.ones((2, 2))}
    logged(tmp_path, 0, "question", lambda: values)
    file = tmp_path / "00000.npz"
    whole = file.read_bytes()
    rng = np.random.default_rng(0)
    damaged = [whole[: int(n)] for n in rng.integers(0, len(whole), 40)]
    for place in rng.integers(0, len(whole), 400):
        flipped = bytearray(whole)
        flipped[place] ^= int(rng.integers(1, 256))
        damaged.append(bytes(flipped))
    again = {"objective": np.full(3, 7.0), "costs": np.zeros((2, 2))}
    for content in damaged:
        file.write_bytes(content)
        answer, _ = logged(tmp_path, 0, "question", lambda: again)
        expected = values if np.array_equal(answer["objective"], values["objective"]) else again
        for name in values:
            np.testing.assert_array_equal(answer[name], expected[name])
    file.write_bytes(whole[:100])
    assert logged(tmp_path, 0, "question", lambda: again)[0] is not None
    with pytest.raises(ValueError, match="holds the evaluations of another tuning"):
        logged(tmp_path, 0, "other", lambda: again)


# --- fuzzy rules -------------------------------------------------------------------------------


def test_fuzzy_rules_before_and_after_as_tables_and_surfaces(tmp_path):
    case = js.build("af-pid-ccc", js.Timing(lap_time=10.0, dt=2e-4, duration=2e-3, scored=0))
    rules = case.gains.extra.rules
    moved = js.replace(rules, proportional=rules.proportional.at[0, 3].set(1234.5))
    after = js.replace(case.gains, extra=js.replace(case.gains.extra, rules=moved))
    first = case.loop.reference.sample(case.path, jnp.zeros((), jnp.int32))
    seen = Measurement(
        position=first.position,
        velocity=first.velocity,
        drive_position=first.position,
        drive_velocity=first.velocity,
    )
    cases = [case, case._replace(gains=after)]
    runs = [Ended(Memory(c.loop.controller.init(c.gains, first, seen))) for c in cases]
    pair = BeforeAfter(cases[0], cases[1], (runs[0], runs[1]))
    write_rules(tmp_path, pair)
    before, tuned = (tmp_path / "rules.txt").read_text().split("AFTER TUNING")
    assert before.startswith("BEFORE TUNING") and "1234" not in before
    assert tuned.count("1234") == 2, "at the start of a run, and at the end of this one"
    for text in ("K_P in 1/s2", "K_I in 1/s3", "K_D in 1/s", "NB", "PB"):
        assert text in before and text in tuned, text
    drawn = rule_pictures(pair)
    names = [
        f"rules-{q}-{w}"
        for w in ("before", "after")
        for q in ("proportional", "integral", "derivative")
    ]
    assert list(drawn) == names
    told = [text.get_text() for text in drawn["rules-proportional-after"].axes[0].texts]
    assert "1234" in told or "1235" in told
    plain = js.build("pi-circle", js.Timing(lap_time=0.02, laps=1))
    without = Ended(Memory(()))
    assert rules_text(BeforeAfter(plain, plain, (without, without))) is None


# --- diagnostics -------------------------------------------------------------------------------


def test_the_check_of_gradients_says_how_many_runs_agree():
    """Three of four runs are enough, and the fourth is named with its error."""
    errors = {"a 0": 0.01, "a 1": 0.19, "b 0": 0.96, "b 1": 0.02}
    told = _gradients({"gradient_ok": True, "gradient_error": errors})
    assert told == "yes: 3 of 4 runs agree with differences to 20%, worst 0.96 in b 0"
    none = _gradients({"gradient_ok": False, "gradient_error": {"a": None}})
    assert none.startswith("NO: 0 of 1 runs agree")


def test_why_gradients_were_not_checked():
    """A method that uses none, and one that was asked for by name."""
    assert unchecked("cma") == "the gradient was not checked: the method does not use it"
    assert unchecked("lbfgs") == "the gradient was not checked: --method lbfgs was asked for"
