"""The form of a study: claims, bounds, verdicts, evidence; and the command that compares."""

import json
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
import tuning.app.comparison
from jaxstage import plot
from jaxstage.model.fields import replace
from jaxstage.model.settings import known_leaves
from jaxstage.studies import all_studies, compare
from jaxstage.studies.claim import (
    FAILS,
    HOLDS,
    UNCHECKED,
    Claim,
    at_least,
    at_most,
    count,
    judge,
    printed,
    within,
)
from jaxstage.studies.comparison import stored_verdicts
from jaxstage.studies.experiment import Experiment, measure, simulate_all
from jaxstage.studies.fuzzy_cmac.experiments import COUPLING, LOAD_AMPLITUDE, _disturbed, _uncertain
from jaxstage.studies.fuzzy_cmac.loops import CONTOURS, build, law
from jaxstage.studies.plots import Chart, ChartPlot, Line
from jaxstage.studies.study import Study
from tests.helpers.documented import undocumented
from tuning.app import main as cli

EVERY = [(study, claim) for study in all_studies for claim in study.claims]
every_claim = pytest.mark.parametrize(
    ("study", "claim"), EVERY, ids=[f"{s.name}:{c.id}" for s, c in EVERY]
)


def a_claim(bound, published=10.0, ours=lambda e: e["run"]["x_um"]):
    return Claim(
        id="one", where="Table 1", text="words", published=published, unit="um", ours=ours,
        bound=bound, reason="chosen lap time",
    )  # fmt: skip


def with_figure(x):
    return {"run": {"x_um": x}}


# --- claims and verdicts ---------------------------------------------------------------------


@pytest.mark.fast
@pytest.mark.parametrize(
    ("bound", "good", "bad"),
    [
        (within(0.1), (9.0, 10.0, 11.0), (8.99, 11.01)),
        (at_most(3.0), (-5.0, 3.0), (3.001,)),
        (at_least(3.0), (3.0, 50.0), (2.999,)),
        (printed(0.01), (9.99, 10.01), (9.98, 10.02)),
    ],
)
def test_a_bound_decides(bound, good, bad):
    claim = a_claim(bound)
    assert [judge(claim, with_figure(x)).verdict for x in good] == [HOLDS] * len(good)
    assert [judge(claim, with_figure(x)).verdict for x in bad] == [FAILS] * len(bad)


@pytest.mark.fast
def test_a_judgement_says_all():
    found = judge(a_claim(within(0.1)), with_figure(10.5))
    assert (found.published, found.ours, found.unit, found.verdict) == (10.0, 10.5, "um", HOLDS)
    assert found.difference == pytest.approx(0.05)
    assert found.reason == "holds if within 10 %; chosen lap time"
    words = judge(a_claim(at_most(11), published=None), with_figure(12.0))
    assert words.difference is None and words.verdict == FAILS


@pytest.mark.fast
def test_a_lost_run_fails_and_is_no_number():
    found = judge(a_claim(within(0.1)), with_figure(None))
    assert found.verdict == FAILS and found.ours is None
    assert "lost" in found.reason


@pytest.mark.fast
def test_what_cannot_be_checked_says_why():
    claim = replace(a_claim(None, published=3.0, ours=None), reason="their machine")
    found = judge(claim, {})
    assert (found.verdict, found.ours, found.reason) == (UNCHECKED, None, "their machine")


@every_claim
def test_every_verdict_can_turn(study, claim):
    """For each claim there are figures with which it holds and figures with which it fails."""
    assert claim.where and claim.text and claim.reason
    assert (claim.ours is None) == (claim.bound is None)
    if claim.ours is None:
        return
    around = claim.published or 0.0
    tried = [around, 0.0, -1.0, 1e12, -1e12, *(around * f for f in (0.5, 0.99, 1.01, 2.0))]
    tried += np.geomspace(1e-9, 1e9, 73).tolist()
    seen = {judge(replace(claim, ours=lambda e, x=x: x), {}).verdict for x in tried}
    assert seen == {HOLDS, FAILS}


@pytest.mark.fast
@pytest.mark.parametrize("study", all_studies, ids=lambda study: study.name)
def test_a_study_is_whole(study):
    names = [claim.id for claim in study.claims]
    assert len(set(names)) == len(names)
    assert set(stored_verdicts(study)) == set(names), "run jaxstage compare STUDY --verdicts"
    assert set(stored_verdicts(study).values()) <= {HOLDS, FAILS, UNCHECKED}
    assert len({plot.name for plot in study.plots}) == len(study.plots)
    assert all(plot.text for plot in study.plots) and study.references
    assert all(0 < s.low < 1 < s.high and s.reason for s in study.spreads)
    case = study.loops[0].build(study.loops[0].timing)
    settings = known_leaves(case.gains, case.scenario)
    assert all(spread.path in settings for spread in study.spreads)


@pytest.mark.fast
def test_loops_have_names_of_their_own():
    names = js.loop_names()
    assert len(set(names)) == len(names)


def test_claims_are_made_without_starting_jax():
    program = (
        "import jaxstage.studies, jax\n"
        "from jax._src import xla_bridge\n"
        "assert not xla_bridge.backends_are_initialized()\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=Path(__file__).parents[2])


# --- evidence --------------------------------------------------------------------------------

SHORT = js.Timing(lap_time=1.0, laps=1)


@pytest.fixture(scope="module")
def short_runs():
    """The published laws on a short lap of the circle, and the conventional one with credit 1."""
    plain, fuzzy = (build(law(name), "circle", SHORT) for name in ("cmac", "dfcmac"))
    full = plain._replace(gains=replace(plain.gains, credit=jnp.ones(2)))
    return measure({"cmac": plain, "full": full, "dfcmac": fuzzy})


def test_an_input_turns_a_verdict(short_runs):
    """With the credit of the fuzzy law the conventional CMAC is the better one."""
    claim = next(c for c in all_studies[0].claims if c.id == "table2-ate-better")

    def verdict(name):
        cells = {"cmac": short_runs[name], "dfcmac": short_runs["dfcmac"]}
        evidence = {f"{k}-{c}/second lap": v for k, v in cells.items() for c in CONTOURS}
        return judge(claim, evidence).verdict

    assert verdict("cmac") == HOLDS
    assert verdict("full") == FAILS


def test_a_batch_of_cases_is_each_case(short_runs):
    case = build(law("cmac"), "circle", SHORT)
    alone = measure({"alone": case})["alone"]
    assert alone["ate_um"] == pytest.approx(short_runs["cmac"]["ate_um"], rel=1e-9)
    assert short_runs["cmac"]["ate_um"] == pytest.approx(54.2739, abs=6e-5)
    assert short_runs["dfcmac"]["ate_um"] == pytest.approx(41.1731, abs=6e-5)


def test_other_machines_are_drawn_by_seed_within_the_spreads():
    study = all_studies[0]
    case = build(law("pi"), "circle", SHORT)
    one, again, other = (_uncertain(case, seed).scenario.plant for seed in (3, 3, 4))
    assert jax.tree.all(jax.tree.map(np.array_equal, one, again))
    assert not np.array_equal(one.mass, other.mass)
    for spread in study.spreads:
        name = spread.path.removeprefix("plant.")
        factor = np.asarray(getattr(one, name)) / np.asarray(getattr(case.scenario.plant, name))
        assert (factor >= spread.low).all() and (factor <= spread.high).all() and factor.std() > 0
    assert jax.tree.all(jax.tree.map(np.array_equal, case.gains, _uncertain(case, 3).gains)), (
        "the law's model stays"
    )


def test_disturbances_act():
    """A load at 5 Hz and cross-coupling move the PI law's error; each on its own."""
    case = build(law("pi"), "circle", js.Timing(lap_time=0.3, laps=1, scored=0))
    runs = simulate_all(
        {
            "none": _disturbed(case, 0.0, 0.0),
            "load": _disturbed(case, LOAD_AMPLITUDE, 0.0),
            "coupling": _disturbed(case, 0.0, COUPLING),
        }
    )
    error = {k: float(r.report["tracking"].ate) for k, r in runs.items()}
    assert abs(error["load"] / error["none"] - 1) > 1e-3
    assert abs(error["coupling"] / error["none"] - 1) > 1e-3


# --- the command -----------------------------------------------------------------------------


def small_study(x):
    """Two claims on one figure x, and one that cannot be checked."""
    return Study(
        name="fuzzy-cmac", title="A small study", source="nowhere", loops=(), references=("r",),
        spreads=(), boxes=(),
        experiments=(Experiment(name="e", text="it", measure=lambda: with_figure(x)),),
        claims=(
            a_claim(within(0.1)),
            replace(a_claim(at_most(1.0), published=None), id="two"),
            replace(a_claim(None, published=None, ours=None), id="three", reason="their machine"),
        ),
        plots=(
            ChartPlot(
                name="bars", title="Bars", text="how to read it",
                charts=lambda e: (
                    Chart("t", "", "um", (Line("a", ("p", "q"), (1.0, None)),), bars=True),
                    Chart("l", "s", "um", (Line("b", [0, 1], [1, 2]),), log_y=True),
                ),
            ),
        ),
    )  # fmt: skip


def test_compare_runs_all_experiments_and_judges():
    told = []
    found = compare(small_study(10.5), told.append)
    assert told == ["it"]
    assert [j.verdict for j in found.claims] == [HOLDS, FAILS, UNCHECKED]
    assert count(found.claims) == {HOLDS: 1, FAILS: 1, UNCHECKED: 1}


KEYS = {
    "id", "where", "text", "published", "ours", "unit", "difference", "verdict", "reason",
}  # fmt: skip


def command(monkeypatch, capsys, *words):
    monkeypatch.setattr(tuning.app.comparison, "known_studies", lambda: (small_study(10.5),))
    monkeypatch.setattr("jaxstage.system.runtime.configure", lambda **_: None)
    monkeypatch.setattr(sys, "argv", ["jaxstage", *words])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    return stopped.value.code or 0, capsys.readouterr()


def test_the_object_of_compare(monkeypatch, capsys):
    status, told = command(monkeypatch, capsys, "compare", "fuzzy-cmac", "--json")
    found = json.loads(told.out)
    assert status == 0 and found["study"] == "fuzzy-cmac"
    assert [set(claim) for claim in found["claims"]] == [KEYS] * 3
    assert [claim["verdict"] for claim in found["claims"]] == ["holds", "fails", "unchecked"]
    assert found["claims"][0]["ours"] == 10.5 and found["claims"][2]["ours"] is None
    assert set(found["changed"]) == {"one", "two", "three"}
    assert not undocumented(KEYS | set(found))


def test_compare_prints_and_draws(monkeypatch, capsys, tmp_path):
    words = ("compare", "fuzzy-cmac", "--out", str(tmp_path / "new"))
    status, told = command(monkeypatch, capsys, *words)
    assert status == 0 and "simulating it" in told.err
    for text in ("A small study", "Table 1", "+5.0%", "holds if within 10 %", "their machine"):
        assert text in told.out
    names = {"claims.png", "bars.png", "compare.json"}
    assert {file.name for file in (tmp_path / "new").iterdir()} == names
    assert json.loads((tmp_path / "new" / "compare.json").read_text())["study"] == "fuzzy-cmac"


def test_verdicts_as_stored(monkeypatch, capsys):
    _, told = command(monkeypatch, capsys, "compare", "fuzzy-cmac", "--verdicts")
    assert told.out.splitlines() == ['one = "holds"', 'two = "fails"', 'three = "unchecked"']


def test_an_unknown_study_is_one_line(monkeypatch, capsys):
    status, told = command(monkeypatch, capsys, "compare", "fuzzy-cmca")
    assert status == 2 and "did you mean" in told.err and told.err.count("\n") == 1


def test_list_counts_the_verdicts(monkeypatch, capsys):
    _, told = command(monkeypatch, capsys, "list")
    for study in all_studies:
        numbers = count(stored_verdicts(study))
        assert f"{numbers[HOLDS]} holds, {numbers[FAILS]} fails" in told.out
        assert all(name in told.out for name in study.references)


@pytest.mark.fast
def test_claims_are_drawn_with_their_verdicts():
    judged = compare(small_study(10.5)).claims
    figure = plot.claims("A small study", judged)
    words = " ".join(text.get_text() for ax in figure.axes for text in ax.texts)
    assert "holds" in words and "fails" in words and "unchecked" not in words
    title = " ".join(text.get_text() for text in figure.texts)
    assert "1 claims hold, 1 fail, 1 cannot be checked" in title
