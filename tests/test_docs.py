"""The documentation does what it says: its files run, its commands work, its pages are complete."""

import os
import re
import runpy
import shlex
import sys
from pathlib import Path

import pytest

from tests.helpers.commanding import command as command
from tests.helpers.commanding import few_figures

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
HOWTO = sorted((DOCS / "howto").glob("*.md"))
pytestmark = pytest.mark.long

FENCE = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```', re.MULTILINE | re.DOTALL)


def blocks(page):
    """Language, title and text of every block of a page."""
    return [match.groups() for match in FENCE.finditer(page.read_text(encoding="utf-8"))]


def files(page):
    return {title: text for _, title, text in blocks(page) if title and title.endswith(".py")}


@pytest.fixture
def folder(command, monkeypatch):
    """An empty folder in which files of a page can import each other, forgotten afterwards.

    Tunings are only begun: the search is tested elsewhere.
    """
    few_figures(monkeypatch)
    monkeypatch.setattr("tuning.app.tune_command._tune", lambda plan, *_: plan.space)
    monkeypatch.syspath_prepend(os.getcwd())
    monkeypatch.setattr(
        "tuning.sweeps.pictures.pictures", lambda found, folder: []
    )  # drawn elsewhere
    before = set(sys.modules)
    yield command
    for name in set(sys.modules) - before:
        if Path(getattr(sys.modules[name], "__file__", None) or "/").parent == Path.cwd():
            del sys.modules[name]


@pytest.mark.parametrize("page", HOWTO, ids=lambda page: page.stem)
def test_a_page_can_be_followed(page, folder, monkeypatch):
    """Every file is written as it stands, then every command runs and says what it should."""
    for name, text in files(page).items():
        Path(name).write_text(text, encoding="utf-8")
    loops = {}
    for name in files(page):
        found = runpy.run_path(name)
        loops[name] = [entry.name for entry in found["study"].loops] if "study" in found else []
    for language, _, text in blocks(page):
        if language == "console":
            for line in text.splitlines():
                follow(line, folder, monkeypatch, loops)


def follow(line, call, monkeypatch, loops):
    """One line of a console block."""
    words = shlex.split(line.removeprefix("$ "))
    assert line.startswith("$ ") and words[0] in ("export", "jaxstage"), line
    if words[0] == "export":
        name, _, value = words[1].partition("=")
        monkeypatch.setenv(name, value)
        return
    answer = call(*words[1:])
    assert answer.status == 0, answer.err
    if words[1] == "list":
        own = loops[os.environ["JAXSTAGE_STUDIES"]]
        assert own and all(loop in answer.out.split() for loop in own)
    if words[1] == "run":
        assert "complete; contour error" in answer.out


@pytest.mark.fast
def test_there_are_pages():
    assert {page.stem for page in HOWTO} == {
        "friction", "controller", "plant", "reference", "metric",
    }  # fmt: skip


@pytest.mark.fast
def test_every_module_is_in_the_reference():
    """Pages name modules by hand; none is forgotten, none is left over."""
    text = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "reference").glob("*.md"))
    named = re.findall(r"^::: (\S+)$", text, re.MULTILINE)
    assert len(named) == len(set(named))
    there = {
        ".".join(file.relative_to(ROOT).with_suffix("").parts)
        for file in (ROOT / "jaxstage").rglob("*.py")
        if file.stem != "__init__"
    }
    inside = {
        name
        for name in there
        if re.match(r"jaxstage\.(studies\.\w+\.|compiler\.|c_export\.)", name)
    }
    assert there - inside - set(named) == UNDOCUMENTED
    assert set(named) - there == {"jaxstage.studies"}


#: helpers that nobody calls by name
UNDOCUMENTED = {
    "jaxstage.system.files",
    "jaxstage.simulate.tiles",
    "jaxstage.plot.style",
    "jaxstage.plot.numbers",
    "jaxstage.studies.figures",
    "jaxstage.studies.packaged",
}


EXPLAINED = [DOCS / "questions.md", DOCS / "smooth.md", DOCS / "engine.md"]


@pytest.mark.parametrize("page", EXPLAINED, ids=lambda page: page.stem)
def test_the_code_of_a_page_runs_in_order(page, capsys):
    """All Python blocks of a page, one after the other, in one program."""
    code = [text for language, _, text in blocks(page) if language == "python"]
    assert len(code) >= 1
    exec(compile("\n".join(code), str(page), "exec"), {"__name__": "page"})
    assert len(capsys.readouterr().out.splitlines()) >= 3
