"""Every command as its help shows it, the reports of what it leaves, and what it says when used
wrongly."""

import json
import re
import shlex
from html.parser import HTMLParser

import jax
import pytest
import typer

from tests.helpers.commanding import command as command
from tests.helpers.commanding import few_figures
from tests.studies.test_studies import small_study
from tuning.app.main import EXAMPLES, app
from tuning.app.reports.page import Page, html

BLANK = Page(
    title="<script>alert(1)</script>", subtitle="a & b", good=None, verdict=("x < y",),
    facts={}, tables=(), pictures=(), files={}, settings={},
)  # fmt: skip
VOID = {"meta", "img", "br", "hr", "link", "input"}


class Reader(HTMLParser):
    """Text and references of a document; asserts that every tag is closed."""

    def __init__(self):
        super().__init__()
        self.open, self.text, self.outside, self.pictures, self.captions = [], [], [], [], 0

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        if tag not in VOID:
            self.open.append(tag)
        for name in ("src", "href"):
            if name in given and not given[name].startswith("data:"):
                self.outside.append(given[name])
        if tag == "img":
            self.pictures.append(given["alt"])
        self.captions += tag == "figcaption"
        assert tag not in ("script", "link", "iframe")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style" and data.strip():
            self.text.append(data.strip())


def read(text):
    """The document, checked to be whole and to refer to nothing outside."""
    reader = Reader()
    reader.feed(text)
    reader.close()
    assert not reader.open and not reader.outside
    assert not re.search(r"url\(|@import|https?://(?!doi)", text.split("</style>")[0])
    return reader


# --- the examples, in an order in which each finds what it needs -----------------------------


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """The folder in which all examples run."""
    return tmp_path_factory.mktemp("examples")


def example(call, name, place, monkeypatch, **smaller):
    """Run the example of a command's help. smaller: words that make it shorter."""
    if name in ("run", "sweep", "replay"):
        few_figures(monkeypatch)
    monkeypatch.chdir(place)
    shown = call(name, "--help").out
    text = " ".join(shown[shown.index("Example: ") :].removeprefix("Example: ").split())
    assert text == EXAMPLES[name]
    first, *words = shlex.split(text)
    assert first == "jaxstage" and words[0] == name
    answer = call(*(smaller.get(word, word) for word in words))
    assert answer.status == 0, answer.err
    return answer


LAP = {"lap_time=1": "lap_time=0.02"}


@pytest.mark.fast
def test_every_command_has_an_example():
    commands = typer.main.get_command(app).commands
    assert set(commands) == set(EXAMPLES)
    assert all(0 < len(one.help.splitlines()[0]) <= 60 for one in commands.values())


@pytest.mark.fast
def test_list(command, place, monkeypatch):
    assert "dfcmac-circle" in example(command, "list", place, monkeypatch).out


def test_doctor(command, place, monkeypatch):
    monkeypatch.setattr("tuning.app.doctor.speed", lambda: 1.0)
    assert "cores" in example(command, "doctor", place, monkeypatch).out


def test_precision(command, place, monkeypatch):
    monkeypatch.setattr("jaxstage.studies.precision.compare_precision", lambda case: {"ate_um": 0})
    assert "[pi-circle]" in example(command, "precision", place, monkeypatch).out


def test_export(command, place, monkeypatch):
    assert "make check" in example(command, "export", place, monkeypatch).out


def test_the_example_of_frequency(command, place, monkeypatch):
    assert "phase margin" in example(command, "frequency", place, monkeypatch).out


def test_run_and_its_report(command, place, monkeypatch):
    example(command, "run", place, monkeypatch, **LAP)
    answer = command("report", "out")
    assert answer.status == 0 and answer.out.strip() == "out/report.html"
    folder = place / "out"
    reader = read((folder / "report.html").read_text(encoding="utf-8"))
    result = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    shown = reader.text
    assert shown.index(result["verdict"]) < shown.index("Pictures") < shown.index("Figures")
    assert set(reader.pictures) == {file.stem for file in folder.glob("*.png")}
    assert reader.captions == len(reader.pictures) > 4
    assert (folder / "gains.toml").read_text(encoding="utf-8").strip() in "\n".join(shown)
    assert f"jaxstage {result['version']}, jax {jax.__version__}" in shown
    assert shown[shown.index("seed") + 1] == "0"


def test_sweep_replay_and_their_report(command, place, monkeypatch):
    example(command, "sweep", place, monkeypatch, **LAP, **{"64": "8"})
    assert "identical to its row" in example(command, "replay", place, monkeypatch).out
    example(command, "report", place, monkeypatch)
    reader = read((place / "swept/report.html").read_text(encoding="utf-8"))
    found = json.loads((place / "swept/summary.json").read_text(encoding="utf-8"))
    share = found["loops"][0]["yield"]
    verdict = next(text for text in reader.text if text.startswith("pi-circle: "))
    assert f"{share['value']:.2%} ({share['low']:.2%} to {share['high']:.2%})" in verdict
    assert found["loops"][0]["claim"]["verdict"] in verdict
    assert "contour_max_um < 60 and finite" in reader.text
    assert {"distribution", "pi-circle-against-cascade-circle"} <= set(reader.pictures)
    assert "cascade-circle gains.toml" in reader.text


def test_tune(command, place, monkeypatch):
    """The words are understood; what a tuning does and reports is in test_tuner_cli."""
    plans = []
    monkeypatch.setattr(
        "tuning.app.commands.tune._tune",
        lambda plan, methods, options: plans.append((plan, options.out)),
    )
    example(command, "tune", place, monkeypatch)
    ((plan, out),) = plans
    assert plan.table["loop"] == "pi-circle" and plan.table["budget"] == 60 and out.name == "tuned"


def test_compare_and_its_report(command, place, monkeypatch):
    study = small_study(10.5)
    monkeypatch.setattr("tuning.app.comparison.known_studies", lambda: (study,))
    monkeypatch.setattr("tuning.app.reports.comparison.known_studies", lambda: (study,))
    example(command, "compare", place, monkeypatch)
    assert command("report", "compared", "--out", "one.html").status == 0
    reader = read((place / "one.html").read_text(encoding="utf-8"))
    assert any("claims of the paper hold" in text for text in reader.text)
    assert set(reader.pictures) == {"claims", "bars"}
    assert {claim.text for claim in study.claims} <= set(reader.text)


@pytest.mark.fast
@pytest.mark.parametrize(
    ("words", "completed"),
    [("ru", "run"), ("run dfcmac-h", "dfcmac-heart"), ("sweep pi-circle cascade-s", "cascade-star"),
     ("compare adap", "adaptive-smc")],
)  # fmt: skip
def test_the_shell_completes(command, monkeypatch, words, completed):
    monkeypatch.setenv("_JAXSTAGE_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", f"jaxstage {words}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
    assert command().out.split() == [completed]


# --- reports ---------------------------------------------------------------------------------


def test_what_is_no_folder_of_ours_is_one_line(command, tmp_path):
    (tmp_path / "empty").mkdir()
    for words, said in (
        ((tmp_path / "empty",), "holds nothing to report: none of a run (run.json), a comparison"),
        ((tmp_path / "nowhere",), "no such folder"),
    ):
        answer = command("report", *words)
        assert answer.status == 2 and said in answer.err and len(answer.err.splitlines()) == 1
    assert not (tmp_path / "empty" / "report.html").exists()


@pytest.mark.parametrize("text", ["{", "{}", "[]", '{"loop": 1}'])
def test_a_spoilt_file_is_named(command, tmp_path, text):
    (tmp_path / "run.json").write_text(text, encoding="utf-8")
    answer = command("report", tmp_path)
    assert answer.status == 2 and "run.json is not what this version writes" in answer.err
    assert len(answer.err.splitlines()) == 1


def test_a_stopped_sweep_is_told_to_go_on(command, tmp_path):
    (tmp_path / "sweep.toml").write_text("runs = 3\n", encoding="utf-8")
    answer = command("report", tmp_path)
    assert answer.status == 2 and "--resume` finishes it" in answer.err


@pytest.mark.fast
def test_text_of_a_user_is_no_markup():
    reader = read(html(BLANK))
    assert "<script>alert(1)</script>" in reader.text and "x < y" in reader.text
