"""The documentation does what it says: its files run, its commands work, its pages are complete."""

import ast
import html
import importlib
import inspect
import os
import re
import runpy
import shlex
import subprocess
import sys
import zlib
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
    monkeypatch.setattr("tuning.app.commands.tune._tune", lambda plan, *_: plan.space)
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


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built anew; a warning is an error."""
    folder = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "-q", "--strict", "-d", str(folder)]
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(words, cwd=ROOT, env=quiet, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def entries(site):
    """Names of all objects that the site has an entry for, from the inventory that it publishes."""
    content = (site / "objects.inv").read_bytes()
    packed = content.split(b"\n", 4)[4]
    return {line.split()[0] for line in zlib.decompress(packed).decode().splitlines()}


def public_objects():
    """Where each object of the public surface is defined."""
    return {name for package in SURFACE for name in exported(importlib.import_module(package))}


def exported(module):
    """What a module defines, and what it takes from others as its own (``a as a``)."""
    names = set()
    for node in ast.parse(inspect.getsource(module)).body:
        if isinstance(node, ast.ImportFrom) and node.module.startswith(f"{module.__name__}."):
            taken = {f".{alias.name}" for alias in node.names if alias.asname == alias.name}
            source = exported(importlib.import_module(node.module)) if taken else ()
            names |= {name for name in source if name[name.rindex(".") :] in taken}
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(f"{module.__name__}.{node.name}")
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            names.add(f"{module.__name__}.{node.targets[0].id}")
        elif isinstance(node, ast.AnnAssign):
            names.add(f"{module.__name__}.{ast.unparse(node.target)}")
    return {name for name in names if not name.rpartition(".")[2].startswith("_")}


SURFACE = (
    "jaxstage",
    "jaxstage.controllers",
    "jaxstage.plants",
    "jaxstage.references",
    "jaxstage.hardware",
    "jaxstage.metrics",
    "jaxstage.studies",
    "jaxstage.testing",
)


def test_every_public_object_has_an_entry_on_the_site(site):
    there, wanted = entries(site), public_objects()
    assert len(wanted) > 150
    missing = sorted(wanted - there)
    assert not missing, missing
    assert {"jaxstage.hardware.sensors.encoder", "jaxstage.hardware.loads.sine_load"} <= there


def test_every_module_is_on_the_site(site):
    """But for what only the library itself uses."""
    modules = {
        ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for room in ("jaxstage", "tuning")
        for file in (ROOT / room).rglob("*.py")
    }
    inside = re.compile(
        r"jaxstage\.(studies\.\w+\.|compiler|c_export)|(jaxstage|tuning)$|tuning\.app"
    )
    packages = {"jaxstage.model"}
    assert {m for m in modules if not inside.match(m)} - packages <= entries(site)


def test_pages_show_signatures_units_and_arguments(site):
    page = (site / "reference" / "hardware.html").read_text(encoding="utf-8")
    text = re.sub(r"<[^>]+>", "", page)
    signature = "current_drive(max_delay: int = 0) -> Drive[CurrentDrive, CurrentMemory]"
    assert "".join(signature.split()) in "".join(html.unescape(text).split())
    assert "time constant of the current loop" in text, "fields are a table"


EXPLAINED = [DOCS / "questions.md", DOCS / "smooth.md", DOCS / "engine.md"]


@pytest.mark.parametrize("page", EXPLAINED, ids=lambda page: page.stem)
def test_the_code_of_a_page_runs_in_order(page, capsys):
    """All Python blocks of a page, one after the other, in one program."""
    code = [text for language, _, text in blocks(page) if language == "python"]
    assert len(code) >= 1
    exec(compile("\n".join(code), str(page), "exec"), {"__name__": "page"})
    assert len(capsys.readouterr().out.splitlines()) >= 3
