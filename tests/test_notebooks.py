"""Every notebook runs, and its two files hold the same code."""

from pathlib import Path

import jupytext
import nbclient
import pytest

ROOT = Path(__file__).parent.parent
SOURCES = sorted((ROOT / "notebooks").glob("*.py"))


def code(notebook):
    return [cell.source for cell in notebook.cells if cell.cell_type == "code"]


def text(notebook):
    return [cell.source for cell in notebook.cells if cell.cell_type == "markdown"]


def test_there_are_notebooks():
    assert SOURCES


@pytest.mark.parametrize("source", SOURCES, ids=lambda p: p.stem)
def test_pair_agrees_and_holds_no_outputs(source):
    script, paired = jupytext.read(source), jupytext.read(source.with_suffix(".ipynb"))
    assert code(script) == code(paired) and text(script) == text(paired)
    assert not any(cell.get("outputs") for cell in paired.cells)


@pytest.mark.parametrize("source", SOURCES, ids=lambda p: p.stem)
def test_runs_and_shows_pictures(source):
    notebook = jupytext.read(source)
    place = {"metadata": {"path": str(ROOT)}}
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3", resources=place).execute()
    outputs = [out for cell in notebook.cells for out in cell.get("outputs", [])]
    pictures = [out for out in outputs if "image/png" in out.get("data", {})]
    assert all(len(out["data"]["image/png"]) > 20_000 for out in pictures)
    assert pictures
