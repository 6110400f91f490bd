"""How the project is built: who imports whom, what is documented, what a field knows of itself."""

import ast
import importlib
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

import jaxstage.metrics
from jaxstage.metrics import columns
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import DISPLAY, Quantity, leaves, parts, quantities
from jaxstage.model.signals import Setpoint
from jaxstage.plants import pmsm_table

ROOT = Path(__file__).parents[1]
FILES = sorted([*ROOT.glob("jaxstage/**/*.py"), *ROOT.glob("tuning/**/*.py")])
TREES = {file: ast.parse(file.read_text(encoding="utf-8")) for file in FILES}

#: a room imports from those below it, and from itself
LAYERS = (
    ("jaxstage.system",),
    ("jaxstage.model",),
    ("jaxstage.numerics",),
    (
        "jaxstage.plants",
        "jaxstage.controllers",
        "jaxstage.references",
        "jaxstage.hardware",
        "jaxstage.metrics",
    ),
    ("jaxstage.compiler",),
    ("jaxstage.c_export",),
    ("jaxstage.simulate",),
    ("jaxstage.testing",),
    ("jaxstage.studies",),
    ("jaxstage.frequency",),
    ("jaxstage.plot",),
    ("tuning.uncertainty",),
    ("tuning.store",),
    ("tuning.sweeps", "tuning.tuner"),
    ("tuning.app",),
)
#: rooms inside a room, with the same rule among themselves
INNER = (
    (
        "jaxstage.compiler.ir",
        "jaxstage.compiler.frontend",
        "jaxstage.compiler.passes",
        "jaxstage.compiler.cxx",
        "jaxstage.compiler.c99",
        "jaxstage.compiler.runtime",
    ),
    ("tuning.tuner.problem", "tuning.tuner.search", "tuning.tuner.evidence"),
)
RANKS = [{name: i for i, names in enumerate(LAYERS) for name in names}]
RANKS += [{name: i for i, name in enumerate(names)} for names in INNER]


def module(file: Path) -> str:
    """Dotted name of a file."""
    names = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(names[:-1] if names[-1] == "__init__" else names)


def room(name: str, ranks: dict[str, int]) -> str | None:
    """The room that a module stands in: ``jaxstage.plants``, ``tuning.app``, ..."""
    return next((r for r in ranks if f"{name}.".startswith(f"{r}.")), None)


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
    """True when a module of one room may not import another."""
    if used == "jaxstage":  # the public surface: only for what stands above it
        return RANKS[0][room(name, RANKS[0])] < RANKS[0]["jaxstage.plot"]
    for ranks in RANKS:
        own, other = room(name, ranks), room(used, ranks)
        if own and other and own != other and ranks[other] >= ranks[own]:
            return True
    return False


@pytest.mark.fast
def test_every_module_has_a_room():
    free = {"jaxstage", "tuning"}
    assert not [name for name in USED if name not in free and not room(name, RANKS[0])]


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
    assert wrong_way("jaxstage.compiler.ir.node", "jaxstage.compiler.cxx.emit")
    assert wrong_way("jaxstage.simulate.rollout", "tuning.store.prepare")
    assert wrong_way("tuning.tuner.session", "tuning.app.main")
    assert not wrong_way("jaxstage.simulate.tick", "jaxstage.model.blocks")


@pytest.mark.fast
def test_the_picture_of_imports_has_no_circle():
    """Rooms and arrows: at most 20 rooms, and an order in which every arrow goes down."""
    rooms = {room(name, RANKS[0]) for name in USED} - {None}
    assert len(rooms) <= 20
    below = {r: set() for r in rooms}
    for name, every in USED.items():
        own = room(name, RANKS[0])
        below.get(own, set()).update({room(u, RANKS[0]) for u in every} - {None, own})
    assert tuple(TopologicalSorter(below).static_order())


@pytest.mark.fast
def test_the_compiler_knows_no_control():
    """It imports numerics and the machine that it runs on, nothing else of the library."""
    allowed = ("jaxstage.compiler", "jaxstage.numerics", "jaxstage.system")
    for name, every in USED.items():
        if room(name, RANKS[0]) == "jaxstage.compiler":
            ours = {used for used in every if used.split(".")[0] in ("jaxstage", "tuning")}
            assert all(used.startswith(allowed) for used in ours), (name, ours)


@pytest.mark.fast
def test_the_tick_knows_no_machine_and_no_law():
    for name in ("tick", "rollout", "batch", "gradients"):
        used = {room(used, RANKS[0]) for used in USED[f"jaxstage.simulate.{name}"]}
        assert not used & set(LAYERS[3]) - {"jaxstage.metrics"}, name


@pytest.mark.fast
@pytest.mark.parametrize(
    ("package", "where"),
    [
        ("matplotlib", "jaxstage.plot"),
        ("typer", "tuning"),
        ("rich", "tuning"),
        ("jinja2", "tuning.app.reports"),
        ("tuning", "tuning"),
    ],
)
def test_only_one_part_imports(package, where):
    users = {name for name, every in USED.items() if any(u.split(".")[0] == package for u in every)}
    assert all(f"{name}.".startswith(f"{where}.") for name in users), users


def test_importing_computes_nothing():
    """JAX has not started after the import: precision and devices can still be chosen."""
    program = (
        "import gc, sys, tuning.app.main, jaxstage\n"
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


@pytest.mark.fast
def test_a_class_name_is_defined_once():
    where: dict[str, list[str]] = {}
    for file, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                where.setdefault(node.name, []).append(module(file))
    assert not {name: files for name, files in where.items() if len(files) > 1}


@each_file
def test_the_formatter_decides_the_layout(file):
    assert "fmt: " + "skip" not in file.read_text(encoding="utf-8")


@each_file
def test_two_kinds_of_object_nothing_else(file):
    """No inheritance but by what is raised, no work in constructors, no rule that forward mode
    cannot use."""
    text = file.read_text(encoding="utf-8")
    for node in ast.walk(TREES[file]):
        if isinstance(node, ast.ClassDef):
            bases = {ast.unparse(base).partition("[")[0] for base in node.bases}
            assert bases <= {"NamedTuple", "Exception", "Generic", "Protocol"}, node.name
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
    factories = {"effort": (), "quadrant_glitch": (), "sliding_metrics": (_surface,)}
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
    with pytest.raises(ValueError, match="two metrics are called"):
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


@pytest.mark.fast
def test_one_version_which_the_changelog_explains():
    """Stored results are compared by the version, so each one says what changed."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = re.findall(r"^## (\S+)$", text, re.MULTILINE)[0]
    assert newest == jaxstage.__version__
    stated = [
        file
        for file in (*FILES, ROOT / "pyproject.toml", ROOT / "CITATION.cff")
        if re.search(rf"""["']{re.escape(newest)}["']""", file.read_text(encoding="utf-8"))
    ]
    assert stated == [ROOT / "jaxstage" / "__init__.py"]


@pytest.mark.fast
def test_the_readme_is_one_page():
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 150
    links = re.findall(r"\]\(([^)#:]+)\)", "\n".join(lines))
    assert links and all((ROOT / link).exists() for link in links)
