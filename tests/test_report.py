"""`jaxstage report`: one file, nothing outside it, the verdict first."""

import json
import re
from html.parser import HTMLParser

import jax
import pytest
from commanding import command as command

from tuning.reports.page import Page, html

SHORT = ("--set", "lap_time=0.02", "--set", "laps=1", "--set", "scored=0")
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of one run, made by the first test that needs it."""
    return tmp_path_factory.mktemp("run") / "out"


def test_of_a_run(command, folder):
    assert command("run", "dfcmac-circle", *SHORT, "--out", folder).status == 0
    answer = command("report", folder)
    assert answer.status == 0 and answer.out.strip() == str(folder / "report.html")
    reader = read((folder / "report.html").read_text(encoding="utf-8"))
    result = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    shown = reader.text
    assert shown.index(result["verdict"]) < shown.index("Pictures") < shown.index("Figures")
    assert set(reader.pictures) == {file.stem for file in folder.glob("*.png")}
    assert reader.captions == len(reader.pictures)
    assert (folder / "gains.toml").read_text(encoding="utf-8").strip() in "\n".join(shown)
    assert f"jaxstage {result['version']}, jax {jax.__version__}" in shown
    assert shown[shown.index("seed") + 1] == "0"


def test_of_a_sweep(command):
    sweep = ("sweep", "pi-circle", "cascade-circle", "-n", "8", *SHORT, "--out", "swept")
    asked = ("--spec", "contour_max_um < 60 and finite", "--target", "0.5")
    assert command(*sweep, *asked).status == 0
    assert command("report", "swept", "--out", "one.html").status == 0
    reader = read(open("one.html", encoding="utf-8").read())
    found = json.load(open("swept/summary.json", encoding="utf-8"))
    share = found["loops"][0]["yield"]
    verdict = next(text for text in reader.text if text.startswith("pi-circle: "))
    assert f"{share['value']:.2%} ({share['low']:.2%} to {share['high']:.2%})" in verdict
    assert found["loops"][0]["claim"]["verdict"] in verdict
    assert "contour_max_um < 60 and finite" in reader.text
    assert {"distribution", "pi-circle-against-cascade-circle"} <= set(reader.pictures)
    assert "cascade-circle gains.toml" in reader.text


def test_of_a_comparison(command, monkeypatch):
    from test_studies import small_study

    study = small_study(10.5)
    monkeypatch.setattr("tuning.comparisons.known_studies", lambda: (study,))
    monkeypatch.setattr("tuning.reports.comparison.known_studies", lambda: (study,))
    assert command("compare", study.name, "--out", "compared").status == 0
    assert command("report", "compared").status == 0
    reader = read(open("compared/report.html", encoding="utf-8").read())
    assert any("claims of the paper hold" in text for text in reader.text)
    assert "claims" in reader.pictures
    assert {claim.text for claim in study.claims} <= set(reader.text)


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
    page = Page(
        title="<script>alert(1)</script>", subtitle="a & b", good=None, verdict=("x < y",),
        facts={}, tables=(), pictures=(), files={}, settings={},
    )  # fmt: skip
    reader = read(html(page))
    assert "<script>alert(1)</script>" in reader.text and "x < y" in reader.text
