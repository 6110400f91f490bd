"""How the project is built: who imports whom, what is documented, what a field knows of itself."""

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

import jaxstage.metrics
from jaxstage.blocks import Metric
from jaxstage.fields import DISPLAY, Quantity, leaves, parts, quantities
from jaxstage.metrics import columns
from jaxstage.plants import pmsm_table
from jaxstage.signals import Setpoint

ROOT = Path(__file__).parent.parent
FILES = sorted([*ROOT.glob("jaxstage/**/*.py"), *ROOT.glob("tuning/**/*.py")])
TREES = {file: ast.parse(file.read_text(encoding="utf-8")) for file in FILES}

#: a module imports from lower layers only, and from its own package
LAYERS = (
    ("fields", "files", "runtime"),
    ("signals",),
    ("blocks",),
    ("numerics",),
    ("plants", "references", "controllers", "loads", "sensors", "drives", "metrics", "settings"),
    ("check", "tick"),
    ("engine",),
    ("rollout",),
    ("tiles", "gradients", "stability", "testing", "explain"),
    ("batch",),
    ("studies",),
    ("plot",),
    ("tuning",),
)
RANK = {name: i for i, names in enumerate(LAYERS) for name in names}


def module(file: Path) -> str:
    """Dotted name of a file."""
    names = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(names[:-1] if names[-1] == "__init__" else names)


def block(name: str) -> str:
    """The part of the library that a module belongs to: ``plants``, ``tick``, ``tuning``, ..."""
    head, *rest = name.split(".")
    return rest[0] if head == "jaxstage" and rest else head


def imports(tree: ast.AST) -> set[str]:
    """Every module imported anywhere in a file, inside functions too."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports are absolute"
            found |= {node.module or ""}
            if node.module in ("jaxstage", "tuning"):
                found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


USED = {module(file): imports(tree) for file, tree in TREES.items()}
each_file = pytest.mark.parametrize("file", FILES, ids=module)


def wrong_way(name: str, used: str) -> bool:
    """True when a module of one part may not import another."""
    while block(used) not in RANK and "." in used:  # an attribute: its module counts
        used = used.rpartition(".")[0]
    own, other = block(name), block(used)
    if used.split(".")[0] not in ("jaxstage", "tuning") or own == other:
        return False
    if used == "jaxstage":  # the public surface: only for what stands above it
        return RANK[own] < RANK["plot"]
    return RANK[other] >= RANK[own]


@pytest.mark.fast
def test_every_module_has_a_layer():
    unknown = {block(name) for name in USED} - {"jaxstage"} - set(RANK)
    assert not unknown, "give it a place in LAYERS"


@pytest.mark.fast
def test_imports_go_one_way():
    wrong = [
        f"{name} imports {used}"
        for name, every in USED.items()
        if name != "jaxstage"
        for used in every
        if wrong_way(name, used)
    ]
    assert not wrong, wrong


@pytest.mark.fast
def test_the_import_rule_can_fail():
    assert wrong_way("jaxstage.plants.pmsm_table", "jaxstage.controllers.pi")
    assert wrong_way("jaxstage.tick", "jaxstage.rollout")
    assert wrong_way("jaxstage.rollout", "tuning.runs")
    assert not wrong_way("jaxstage.tick", "jaxstage.blocks")


@pytest.mark.fast
def test_the_tick_knows_no_machine_and_no_law():
    for name in ("jaxstage.tick", "jaxstage.rollout", "jaxstage.check"):
        known = {block(used) for used in USED[name]}
        assert not known & {"plants", "controllers", "references", "loads", "sensors", "drives"}


@pytest.mark.fast
@pytest.mark.parametrize(
    ("package", "where"),
    [
        ("matplotlib", "jaxstage.plot"),
        ("dataclasses", "jaxstage.fields"),
        ("typer", "tuning"),
        ("rich", "tuning"),
        ("jinja2", "tuning.reports"),
        ("tuning", "tuning"),
    ],
)
def test_only_one_part_imports(package, where):
    users = {name for name, every in USED.items() if any(u.split(".")[0] == package for u in every)}
    assert all(f"{name}.".startswith(f"{where}.") for name in users), users


def test_importing_computes_nothing():
    """JAX has not started after the import: precision and devices can still be chosen."""
    program = (
        "import gc, sys, tuning.cli, jaxstage\n"
        "assert 'matplotlib' not in sys.modules\n"
        "jaxstage.configure(precision='double', cores=3, cache=None)\n"
        "import jax\n"
        "print(len(jax.devices('cpu')), jax.numpy.zeros(()).dtype, gc.get_threshold()[0])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert done.stdout.split() == ["3", "float64", "100000"], done.stderr


# --- text ------------------------------------------------------------------------------------


def public(tree: ast.AST) -> list[ast.AST]:
    """Public functions, classes and methods of a module, not those inside functions."""
    found, todo = [], list(tree.body)
    while todo:
        node = todo.pop()
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            found.append(node)
            todo += node.body if isinstance(node, ast.ClassDef) else []
    return found


@each_file
def test_what_is_public_is_documented(file):
    assert ast.get_docstring(TREES[file]), "the module has no docstring"
    bare = [node.name for node in public(TREES[file]) if not ast.get_docstring(node)]
    assert not bare


@each_file
def test_no_module_is_long(file):
    assert len(file.read_text(encoding="utf-8").splitlines()) <= 400


@each_file
def test_two_kinds_of_object_nothing_else(file):
    """No inheritance but by what is raised, no work in constructors, no rule that forward mode
    cannot use."""
    text = file.read_text(encoding="utf-8")
    for node in ast.walk(TREES[file]):
        if isinstance(node, ast.ClassDef):
            assert {ast.unparse(base) for base in node.bases} <= {"NamedTuple", "Exception"}, (
                node.name
            )
            methods = {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
            assert not methods & {"__init__", "__post_init__", "__call__"}, node.name
    assert not re.search(r"\bcustom_vjp\b", text) and "pure_callback" not in text


# --- fields ----------------------------------------------------------------------------------


def decorated(name: str) -> list[tuple[str, str]]:
    """Module and name of every class with the decorator ``name``."""
    return [
        (module(file), node.name)
        for file, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        and name in [ast.unparse(decorator) for decorator in node.decorator_list]
    ]


DATA = decorated("pytree")
UNITS = {"1", "m", "s", "kg", "N", "A", "V", "W", "J", "rad", "ohm", "Hz", "command"}


def is_unit(text: str) -> bool:
    """``N s/m``, ``1/(m s)``: known units with whole powers, one stroke at most, and brackets where
    several units stand below it."""
    top, *below = text.split("/")
    bottom = "".join(below)
    clear = bottom == f"({bottom.strip('()')})" if " " in bottom else "(" not in bottom
    factors = [
        re.sub(r"\d+$", "", f) if f != "1" else f for f in f"{top} {bottom.strip('()')}".split()
    ]
    return bool(text) and len(below) <= 1 and clear and all(f in UNITS for f in factors)


@pytest.mark.fast
@pytest.mark.parametrize(("where", "name"), DATA, ids=[name for _, name in DATA])
def test_every_field_knows_what_it_is(where, name):
    cls = getattr(importlib.import_module(where), name)
    nested = {data for _, data in DATA}
    for field, quantity in quantities(cls).items():
        assert is_unit(quantity.unit), f"{field} has the unit '{quantity.unit}'"
        assert quantity.doc, f"{field} has no meaning"
        assert quantity.role in ("gain", "param", "known", "signal")
        assert quantity.shown == quantity.unit or DISPLAY[quantity.shown][0] == quantity.unit
    for field in parts(cls):
        described = cls.__dataclass_fields__[field].metadata.get("part")
        kind = cls.__annotations__[field]
        assert described or getattr(kind, "__name__", kind) in nested, f"{field} has no meaning"


@pytest.mark.fast
def test_what_is_data_is_traced_and_what_is_defined_is_not():
    assert len(DATA) > 20
    for where, name in decorated("definition"):
        cls = getattr(importlib.import_module(where), name)
        values = {field: 0 for field in cls.__dataclass_fields__}
        one, other = cls(**values), cls(**values)
        assert jax.tree.leaves(one)[0] is one, "a definition is a leaf"
        if name != "Node":  # a graph makes equal nodes once, and compares them by identity
            assert one == other and hash(one) == hash(other)
    for where, name in DATA:
        cls = getattr(importlib.import_module(where), name)
        values = {field: float(i) for i, field in enumerate(cls.__dataclass_fields__)}
        assert sorted(jax.tree.leaves(cls(**values))) == sorted(values.values())


@pytest.mark.fast
def test_a_wrong_unit_is_noticed():
    assert is_unit("A2 s2/m2") and is_unit("1/s2")
    assert not is_unit("N/m/s") and not is_unit("mm") and not is_unit("")


def _surface(memory):
    return memory


@pytest.mark.fast
def test_figures_have_names_of_their_own():
    """Reports of all public metrics flatten into one table without two equal keys."""
    exported = {n: v for n, v in vars(jaxstage.metrics).items() if not n.startswith("_")}
    metrics = [v for v in exported.values() if isinstance(v, Metric)]
    factories = {"effort": (), "quadrant_glitch": (), "sliding_figures": (_surface,)}
    metrics += [exported[name](*arguments) for name, arguments in factories.items()]
    assert len(metrics) >= 9
    two = jnp.zeros(2)
    first = Setpoint(
        position=two, velocity=two, acceleration=two, tangent=two, curvature=jnp.zeros(())
    )
    seen: list[str] = []
    for metric in metrics:
        report = metric.finish(metric.init(first))
        seen += [path.rsplit(".", 1)[-1] for path, _, _ in leaves(report)]
        assert all(isinstance(q, Quantity) and q.doc for _, q, _ in leaves(report))
    assert sorted(seen) == sorted(set(seen))
    both = {"a": metrics[0].finish(metrics[0].init(first))}
    with pytest.raises(ValueError, match="two figures are called"):
        columns(both | {"b": both["a"]}, pmsm_table())


# --- the gate --------------------------------------------------------------------------------


@pytest.mark.fast
def test_the_gate_runs_the_commands_of_the_readme():
    readme, gate = ROOT / "README.md", ROOT / ".ci" / "run"
    if not readme.exists() or not gate.exists():
        pytest.skip("no README or no gate in this checkout")
    lines = readme.read_text(encoding="utf-8").splitlines()
    wanted = re.findall(r'readme_command "([^"]+)"', gate.read_text(encoding="utf-8"))
    assert len(wanted) == 2
    found = [next((line for line in lines if text in line), None) for text in wanted]
    assert all(found), wanted
    assert "pytest" in found[0] and "jaxstage run" in found[1]
