"""Files of the user's own in JAXSTAGE_STUDIES: found like the published ones, or refused."""

import jax
import pytest

import jaxstage as js
from jaxstage.studies import known_studies
from tests.helpers.commanding import command as command
from tuning.sweeps.configuration import SweepRequest, build, configure_sweep

STUDY = """
import jaxstage as js
from jaxstage.studies import NamedLoop
from jaxstage.studies import Spread
from jaxstage.studies import Study

def build(timing):
    return js.build("pi-circle", timing)._replace(name="mine")

study = Study(
    name="own", title="T", source="S", loops=(NamedLoop(name="mine", summary="M", build=build),),
    spreads=(Spread(path="plant.mass", low=0.9, high=1.1, reason="R"),),
)
"""

#: a study of nothing but what is put in
WITH = """
from jaxstage.studies import NamedLoop, Study
study = Study(name="other", title="T", source="S", {})
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Write a file and name it in the variable."""

    def write(text, name="own.py"):
        file = tmp_path / name
        file.write_text(text, encoding="utf-8")
        monkeypatch.setenv("JAXSTAGE_STUDIES", str(file))
        return file

    return write


@pytest.mark.fast
def test_a_loop_of_a_file_is_known_while_the_variable_names_it(own, monkeypatch):
    own(STUDY)
    assert "mine" in js.loop_names() and js.find("mine").summary == "M"
    monkeypatch.delenv("JAXSTAGE_STUDIES")
    assert "mine" not in js.loop_names()
    with pytest.raises(ValueError, match="unknown loop 'mine'"):
        js.find("mine")


@pytest.mark.fast
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def broken(:\n", r"own\.py:1: SyntaxError: "),
        ("x = 1\nimport nowhere_at_all\n", r"own\.py:2: ModuleNotFoundError: No module"),
        ("x = 1\n", r"own\.py: must hold study = Study\(\.\.\.\)"),
        (
            STUDY.replace('name="mine"', 'name="pi-circle"'),
            r"two loops are called pi-circle \(.*own\.py\)",
        ),
        (
            STUDY.replace('name="own"', 'name="mine"'),
            r"a study and a loop are both called mine \(.*own\.py\)",
        ),
        (STUDY.replace('name="own"', 'name="fuzzy-ccc"'), "two studies are called fuzzy-ccc"),
        ("x = 1\nexit(3)\n", r"own\.py:2: SystemExit: 3"),
        ("raise KeyError('two\\nlines')\n", r"own\.py:1: KeyError: 'two.*lines'"),
        (WITH.format("loops=3"), r"own\.py: loops of the study = 3: must be a tuple of NamedLoop"),
        (WITH.format("loops=[1]"), r"loops of the study = \[1\]: must be a tuple of NamedLoop"),
        (WITH.format("loops=(), spreads=3"), "spreads of the study = 3: must be a tuple of Spread"),
        (WITH.format("loops=(), plots=(1,)"), "must be a tuple of ChartPlot or RunPlot"),
        (WITH.format("loops=(NamedLoop(name='a', summary='', build=4),)"), "build of a = 4"),
        (
            WITH.format("loops=(NamedLoop(name=5, summary='', build=id),)"),
            "name of a NamedLoop",
        ),
        (
            WITH.format("loops=(NamedLoop(name='a', summary='', build=id, timing=3),)"),
            "timing of a = 3: must be a Timing",
        ),
    ],
)
def test_a_file_that_cannot_be_used_is_named(own, text, message):
    own(text)
    with pytest.raises(ValueError, match=message) as refused:
        known_studies()
    assert "\n" not in str(refused.value)


@pytest.mark.fast
def test_a_missing_file_is_one_line_of_the_command_line(command, monkeypatch):
    monkeypatch.setenv("JAXSTAGE_STUDIES", "nowhere.py")
    answer = command("list")
    assert answer.status == 2 and len(answer.err.splitlines()) == 1
    assert "nowhere.py is not a Python file" in answer.err


def test_a_study_without_claims_is_listed_and_not_compared(own, command):
    own(STUDY)
    assert "claims" not in command("list").out.split("own")[-1]
    answer = command("compare", "own")
    assert answer.status == 2 and "unknown study 'own'" in answer.err


def test_a_sweep_remembers_the_file(own):
    """Its spreads are those of the file; another file is refused when the sweep goes on."""
    file = own(STUDY)
    with jax.enable_x64(True):
        text = configure_sweep(
            SweepRequest(loops=("mine",), runs=4, words=("lap_time=0.02", "laps=1"))
        )
    plan = build(text)
    assert [item.path for item in plan.spaces[0].uncertain] == ["plant.mass"]
    file.write_text(STUDY + "\n# another one\n", encoding="utf-8")
    build.cache_clear()
    with pytest.raises(ValueError, match="mine: its file in JAXSTAGE_STUDIES is not the one"):
        build(text)


@pytest.mark.fast
@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("None", r"own\.py: build of mine gives None: must be a Case"),
        ("timing.nowhere", r"own\.py:\d+: AttributeError: 'Timing' object has no attribute"),
        ("exit(3)", r"own\.py:\d+: SystemExit: 3"),
    ],
)
def test_a_build_that_fails_or_gives_no_case_is_one_line(own, body, message):
    own(STUDY.replace('js.build("pi-circle", timing)._replace(name="mine")', body))
    with pytest.raises(ValueError, match=message) as refused:
        js.build("mine")
    assert "\n" not in str(refused.value)


def test_an_own_study_that_leaves_ends_the_command_with_status_2(own, command):
    own("exit(3)")
    result = command("list")
    assert result.status == 2 and result.out == ""
    assert result.err.count("\n") == 1 and "own.py:1: SystemExit: 3" in result.err
