"""Every notebook runs, in a small size, and its two files hold the same code."""

import ast
from pathlib import Path

import jupytext
import nbclient
import nbformat
import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "notebooks").glob("*.py"))
#: what stands in place of the numbers in the cell tagged ``parameters``
SMALL = {
    "02_contours_and_timing": "FEEDS = (4000.0,)",
    "03_published_systems": 'ONLY = ("pd",)',
    "04_tune_by_gradient": 'LOOP, GAINS = "pi-circle", ("slope", "proportional_gain")\n'
    "SECONDS, PLANTS, GRID, BUDGET = 0.05, 2, 5, 20.0",
    "05_fuzzy_rules": "from tuning.tuner.search.random_search import random_search\n"
    "SECONDS, PLANTS, METHOD, BUDGET = 0.1, 1, random_search(), 20.0",
    "06_monte_carlo": 'PLANTS, LOOPS, TIMING = 16, ("pi-circle",), ("lap_time=0.2", "laps=1")',
    "07_own_controller": "LAP_TIME = 0.5",
}
each = pytest.mark.parametrize("source", SOURCES, ids=lambda p: p.stem)
pytestmark = pytest.mark.long


def code(notebook):
    return [cell.source for cell in notebook.cells if cell.cell_type == "code"]


def text(notebook):
    return [cell.source for cell in notebook.cells if cell.cell_type == "markdown"]


def tagged(notebook):
    """Where the cell of parameters stands."""
    tags = [cell.metadata.get("tags", []) for cell in notebook.cells]
    return [index for index, found in enumerate(tags) if "parameters" in found]


@pytest.mark.fast
def test_there_are_notebooks():
    assert SOURCES and set(SMALL) <= {source.stem for source in SOURCES}


@pytest.mark.fast
@each
def test_pair_agrees_and_holds_no_outputs(source):
    script, paired = jupytext.read(source), jupytext.read(source.with_suffix(".ipynb"))
    assert code(script) == code(paired) and text(script) == text(paired)
    assert not any(cell.get("outputs") for cell in paired.cells)
    assert tagged(script) == tagged(paired)


@pytest.mark.fast
@each
def test_reads_easily(source):
    """Public names only, and no function over ten lines."""
    tree = ast.parse(source.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            assert node.end_lineno - node.lineno < 10, node.name
        names = [alias.name for alias in getattr(node, "names", []) if hasattr(alias, "name")]
        names += [node.attr] if isinstance(node, ast.Attribute) else []
        assert not [name for name in names if name.startswith("_")]


@each
def test_runs_and_shows_pictures(source):
    notebook = jupytext.read(source)
    if source.stem in SMALL:
        (place,) = tagged(notebook)
        notebook.cells.insert(place + 1, nbformat.v4.new_code_cell(SMALL[source.stem]))
    here = {"metadata": {"path": str(ROOT)}}
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3", resources=here).execute()
    outputs = [out for cell in notebook.cells for out in cell.get("outputs", [])]
    pictures = [out for out in outputs if "image/png" in out.get("data", {})]
    assert all(len(out["data"]["image/png"]) > 20_000 for out in pictures)
    assert pictures
