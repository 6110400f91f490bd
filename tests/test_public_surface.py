"""What users may import, listed in one place: ``public_surface.txt``, a line of names a module.

After a change that is meant: ``python tests/test_public_surface.py`` writes the list anew.
"""

import ast
import importlib
import textwrap
from pathlib import Path

import pytest

LIST = Path(__file__).parent / "public_surface.txt"
MODULES = (
    "jaxstage",
    "jaxstage.controllers",
    "jaxstage.plants",
    "jaxstage.references",
    "jaxstage.hardware",
    "jaxstage.metrics",
    "jaxstage.studies",
    "jaxstage.testing",
    "jaxstage.model.fields",
    "tuning.uncertainty.uncertain_space",
    "tuning.sweeps.configuration",
    "tuning.sweeps.sweep",
    "tuning.tuner.problem.objective",
    "tuning.tuner.problem.problem",
    "tuning.tuner.problem.search_space",
    "tuning.tuner.search.optimise",
)


def public_names(module: str) -> list[str]:
    """What a module defines, and what it takes from others as its own (``a as a``)."""
    file = importlib.import_module(module).__file__
    names = set()
    for node in ast.parse(Path(str(file)).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            names |= {alias.name for alias in node.names if alias.asname == alias.name}
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
        elif isinstance(node, ast.AnnAssign):
            names.add(ast.unparse(node.target))
    return sorted(name for name in names if not name.startswith("_"))


def listed() -> dict[str, list[str]]:
    """The list: module -> names."""
    blocks = LIST.read_text(encoding="utf-8").strip().split("\n\n")
    return {block.split()[0].rstrip(":"): block.split()[1:] for block in blocks}


@pytest.mark.fast
@pytest.mark.parametrize("module", MODULES)
def test_the_surface_is_as_listed(module):
    assert public_names(module) == listed()[module]
    there = importlib.import_module(module)
    assert all(hasattr(there, name) for name in listed()[module])


@pytest.mark.fast
def test_nothing_else_is_listed():
    assert tuple(listed()) == MODULES
    assert {"encoder", "sine_load", "ideal_drive"} <= set(listed()["jaxstage.hardware"])


if __name__ == "__main__":
    texts = [
        f"{module}:\n" + textwrap.indent(textwrap.fill(" ".join(public_names(module)), 96), "  ")
        for module in MODULES
    ]
    LIST.write_text("\n\n".join(texts) + "\n", encoding="utf-8")
