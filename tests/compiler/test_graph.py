"""The graph keeps its promises: folding, simplification, intervals, structure."""

import collections
import dataclasses
import itertools
import math

import jax
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from jax import lax

from jaxstage.compiler.c99 import ops as c99
from jaxstage.compiler.cxx import ops as cxx
from jaxstage.compiler.cxx.kernels import kernel
from jaxstage.compiler.frontend.step_program import is_real
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.graph import new_graph
from jaxstage.compiler.ir.node import ordered
from jaxstage.compiler.ir.ops import OPS
from jaxstage.compiler.ir.verify import RICH, MalformedGraphError, verify
from jaxstage.compiler.passes.loop_reroll import LoopSearch, alike_nodes
from jaxstage.compiler.passes.store_forms import Cells, Put, Rolled, Store, plan
from tests.helpers.compiled_cases import case, program, shared_by_all
from tests.helpers.graph_values import compute, dtype_of, evaluate, same

pytestmark = pytest.mark.fast

REALS = (0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.5, -2.5, 3.5, 0.1, -0.3, 7.0, 1e-310, 3e9, -3e9, 1e30,
         2147483647.0, -2147483648.0, 1.7e308, math.inf, -math.inf, math.nan)  # fmt: skip
WHOLES = {
    "i": (0, 1, -1, 2, -2, 3, 7, 31, 32, 63, 64, 2**31 - 1, -(2**31)),
    "u": (0, 1, 2, 3, 7, 31, 32, 2**31, 2**32 - 1),
    "l": (0, 1, -1, 5, 63, 64, 2**31, 2**63 - 1, -(2**63), 2**53 + 1),
    "b": (False, True),
}
VALUES = {"f": REALS, **WHOLES}
#: what is rounded once, if at all
EXACT = frozenset(
    "add sub mul div rem neg abs sign min max floor ceil round sqrt eq ne lt le gt ge and or xor "
    "not shl shr is_finite select cast".split()
)
LAX = {
    "pow": lax.pow, "atan2": lax.atan2, "shl": lax.shift_left, "shr": lax.shift_right_logical,
    "and": lax.bitwise_and, "or": lax.bitwise_or, "xor": lax.bitwise_xor, "not": lax.bitwise_not,
    "is_finite": lax.is_finite, "min": lax.min, "max": lax.max,
    "round": lambda a: lax.round(a, lax.RoundingMethod.TO_NEAREST_EVEN),
    "select": lambda c, a, b: lax.select(c, a, b),
}  # fmt: skip


def cases():
    """Every operation with every kind that it takes, and values of its arguments in rows."""
    for op in OPS.values():
        if op.name in RICH or op.name in ("const", "in", "load", "cast", "erf", "erf_inv"):
            continue
        for kind in op.takes:
            rows = list(itertools.product(VALUES[kind], repeat=op.arity - (op.name == "select")))
            if op.name == "select":
                rows = [(c, *r) for c in (False, True) for r in rows]
            yield pytest.param(op, kind, rows, id=f"{op.name}-{kind}")


def kinds_of(op, kind):
    return ["b", kind, kind] if op.name == "select" else [kind] * op.arity


@pytest.mark.parametrize(("op", "kind", "rows"), [*cases()])
def test_the_values_here_are_those_of_jax(op, kind, rows):
    """Operations in numpy, which all other tests here compare with."""
    kinds = kinds_of(op, kind)
    with jax.enable_x64(True):
        columns = [
            np.array(c, dtype_of(k)) for c, k in zip(zip(*rows, strict=True), kinds, strict=True)
        ]
        function = LAX.get(op.name) or getattr(lax, op.name)
        theirs = np.asarray(function(*columns))
    ours = compute(op.name, op.gives or kind, columns)
    tiny = [
        np.any([(0 < abs(x) < 2.3e-308) for x in (*r, v)]) for r, v in zip(rows, ours, strict=True)
    ]
    normal = ~np.array(tiny)  # XLA flushes numbers below the smallest normal one
    if op.name in EXACT:
        pairs = zip(np.array(rows, object)[normal], ours[normal], theirs[normal], strict=True)
        assert not [(r, a, b) for r, a, b in pairs if not same(a, b)]
    else:
        np.testing.assert_allclose(ours[normal], theirs[normal], rtol=1e-13, atol=1e-300)


@pytest.mark.parametrize("single", [False, True], ids=["double", "single"])
@pytest.mark.parametrize(("op", "kind", "rows"), [*cases()])
def test_what_is_folded_is_what_is_computed(op, kind, rows, single):
    kinds, folded = kinds_of(op, kind), 0
    for row in rows:
        g = new_graph(single)
        args = [g.const(x, k) for x, k in zip(row, kinds, strict=True)]
        node = g.op(op.name, *args)
        verify(g)
        if node.op != "const":
            continue
        folded += 1
        columns = [np.asarray(a.value, dtype_of(a.kind, single)) for a in args]
        value = compute(op.name, node.kind, columns, single)
        folded_value = np.asarray(node.value, dtype_of(node.kind, single))
        if op.name in EXACT:
            assert same(folded_value, value), (row, node.value, value)
        else:
            eps = np.finfo(dtype_of("f", single)).eps
            np.testing.assert_allclose(folded_value, value, rtol=8 * eps, atol=1e-300)
    assert folded or op.name in ("cbrt",)


# --- random graphs ----------------------------------------------------------------------------

BINARY = {
    "f": ("add", "sub", "mul", "div", "min", "max", "rem"),
    "i": ("add", "sub", "mul", "div", "rem", "min", "max", "and", "or", "xor", "shl", "shr"),
    "u": ("add", "sub", "mul", "min", "max", "and", "or", "xor"),
    "l": ("add", "sub", "mul", "div", "rem", "min", "max"),
    "b": ("and", "or", "xor"),
}
UNARY = {
    "f": ("neg", "abs", "sign", "floor", "ceil", "round", "sqrt"),
    "i": ("neg", "abs", "sign", "not"),
    "u": ("not",),
    "l": ("neg", "abs", "sign"),
    "b": ("not",),
}
COMPARISONS = ("eq", "ne", "lt", "le", "gt", "ge")


@dataclasses.dataclass
class Expression:
    """A graph, and beside it the same operations one by one, neither folded nor simplified."""

    graph: object
    nodes: list = dataclasses.field(default_factory=list)
    values: list = dataclasses.field(default_factory=list)
    inputs: dict = dataclasses.field(default_factory=dict)
    single: bool = False

    def of_kind(self, kind):
        return [i for i, n in enumerate(self.nodes) if n.kind == kind]

    def leaf(self, node, value):
        self.nodes.append(node)
        self.values.append(np.asarray(value, dtype_of(node.kind, self.single)))

    def op(self, name, *at, kind=""):
        args = [self.values[i] for i in at]
        kind = OPS[name].gives.strip("?") or kind or self.nodes[at[-1]].kind
        if name in ("div", "rem") and args[1].dtype.kind == "f":
            assume(args[1] != 0)  # the sign of a zero is not kept
        value = compute(name, kind, args, self.single)
        self.nodes.append(self.graph.op(name, *(self.nodes[i] for i in at), kind=kind))
        self.values.append(value)


@st.composite
def expressions(draw, single=False, kinds="fiulb", size=25):
    """Random operations on inputs, with and without bounds, and constants."""
    e = Expression(new_graph(single), single=single)
    for number, kind in enumerate(draw(st.lists(st.sampled_from(kinds), min_size=3, max_size=8))):
        special = [x for x in VALUES[kind] if not (single and 0 < abs(x) < 1e-40)]
        value = draw(st.sampled_from(special))
        if draw(st.booleans()):
            e.leaf(e.graph.const(value, kind), value)
            continue
        bounds, finite = None, bool(np.isfinite(dtype_of(kind, single)(value)))
        if draw(st.booleans()) and value == value:
            exact = float(dtype_of(kind, single)(value)) if kind == "f" else int(value)
            bounds = exact, exact + draw(st.integers(0, 9)) if kind == "f" else exact
        finite = finite and draw(st.booleans())
        if bounds is not None:
            finite = True
        e.leaf(e.graph.input("x", number, kind, finite, bounds), value)
        e.inputs["x", number] = e.values[-1]
    for _ in range(draw(st.integers(1, size))):
        kind = draw(st.sampled_from(kinds))
        own = e.of_kind(kind)
        if not own:
            continue
        one, two = (draw(st.sampled_from(own)) for _ in range(2))
        form = draw(st.sampled_from(("binary", "binary", "unary", "compare", "select", "cast")))
        if form == "binary":
            e.op(draw(st.sampled_from(BINARY[kind])), one, two)
        elif form == "unary":
            e.op(draw(st.sampled_from(UNARY[kind])), one)
        elif form == "compare":
            e.op(draw(st.sampled_from(COMPARISONS)), one, two)
        elif form == "select" and e.of_kind("b"):
            e.op("select", draw(st.sampled_from(e.of_kind("b"))), one, two)
        elif form == "cast":
            e.op("cast", one, kind=draw(st.sampled_from(kinds)))
        if draw(st.integers(0, 9)) == 0 and e.of_kind("f"):
            e.op("is_finite", draw(st.sampled_from(e.of_kind("f"))))
    return e


def holds(e):
    """Simplified values are the plain ones; every value is within the bounds of its node."""
    verify(e.graph)
    values = evaluate(e.graph.nodes, e.inputs, e.single)
    for node, plain in zip(e.nodes, e.values, strict=True):
        assert same(values[node.id], plain, zeros=False), (node, values[node.id], plain)
    for node in e.graph.nodes:
        value = values[node.id]
        if node.kind == "f" and np.isnan(value):
            assert node.nan, (node, node.low, node.high)
        else:
            assert node.low <= value <= node.high, (node, value, node.low, node.high)


@settings(max_examples=1000, deadline=None)
@given(expressions())
def test_simplified_is_plain_and_bounds_enclose_it(e):
    holds(e)


@settings(max_examples=500, deadline=None)
@given(expressions(single=True))
def test_simplified_is_plain_in_single_precision(e):
    holds(e)


# --- loops and updates at an index ------------------------------------------------------------

SIZE = 48
CELLS = Cells(
    read=lambda node: f"{node.value[0]}[{node.value[1]}]",
    array=lambda source: (source, 0),
    slot=lambda node: (f"{node.value[0]}[{{}}]", node.value[1]),
)


@dataclasses.dataclass
class Stores:
    """What becomes of an array ``c`` that also reads an array ``p`` of numbers."""

    graph: object
    stores: list
    inputs: dict


@st.composite
def stores(draw):
    """Stretches of cells of one form, swaps and shifts, and updates at an index."""
    g = new_graph(rich=True)
    p, c = ([g.input(name, i, "f", True) for i in range(SIZE)] for name in "pc")
    inputs = {(name, i): 0.5 + 7 * i + (name == "c") / 3 for name in "pc" for i in range(SIZE)}
    shared, go = g.input("shared", 0, "f", True), g.input("go", 0, "b")
    inputs["shared", 0], inputs["go", 0] = 3.25, draw(st.booleans())
    forms = {
        "scale": lambda x, y: g.op("mul", x, shared),
        "add": lambda x, y: g.op("add", x, g.op("mul", y, y)),
        "decay": lambda x, y: g.op("sub", g.op("mul", x, g.const(0.5, "f")), y),
        "where": lambda x, y: g.op("select", go, g.op("add", y, shared), x),
        "copy": lambda x, y: y,
        "keep": lambda x, y: x,
    }
    made, at = [], 0
    while at < SIZE:
        form = forms[draw(st.sampled_from(sorted(forms)))]
        source = draw(st.sampled_from((p, c)))
        shift, step = draw(st.integers(-9, 9)), draw(st.sampled_from((1, 1, 2, -1)))
        for i in range(at, min(SIZE, at + draw(st.sampled_from((1, 3, 9, 17, 30))))):
            made.append(form(c[i], source[(shift + step * i) % SIZE]))
        at = len(made)
    if draw(st.booleans()):
        first, count = draw(st.integers(0, SIZE - 9)), draw(st.integers(1, 9))
        index = g.input("index", 0, "i", bounds=(0, count - 1))
        inputs["index", 0] = draw(st.integers(0, count - 1))
        put = made[draw(st.integers(0, SIZE - 1))] if draw(st.booleans()) else shared
        for k in range(count):
            here = g.op("eq", index, g.const(k, "i"))
            made[first + k] = g.op("select", here, put, c[first + k])
    verify(g)
    return Stores(g, [Store("c", i, node) for i, node in enumerate(made)], inputs)


def searched(s, near):
    """What a back end looks for: neighbours, or what is alike anywhere."""
    nodes = ordered(x.node for x in s.stores)
    if not near:
        return LoopSearch(16, CELLS.slot, alike=alike_nodes(nodes, ()))
    uses = collections.Counter(a.id for n in nodes for a in n.args)
    uses.update(x.node.id for x in s.stores)
    return LoopSearch(8, CELLS.slot, uses=uses)


def round_value(roll, k, values, memory):
    """The form of a loop in round k, its cells read from memory."""
    known = {node.id: values[node.id] for node in roll.same}
    known |= {leaf: values[nodes[k].id] for leaf, nodes in roll.others.items()}
    for leaf, row in roll.rows.items():
        array, _, slot = row.cell(k).rstrip("]").partition("[")
        known[leaf] = memory[array][int(slot)]
    for node in ordered([roll.form], known=known):
        known[node.id] = compute(node.op, node.kind, [np.asarray(known[a.id]) for a in node.args])
    return known[roll.form.id]


def stored(form, values, memory):
    """Memory after a store."""
    if isinstance(form, Rolled):
        for k, slot in enumerate(form.slots):
            if form.store.where is None or values[form.store.where.id]:
                memory["c"][slot] = round_value(form.roll, k, values, memory)
    elif isinstance(form, Put):
        if form.where is None or values[form.where.id]:
            memory["c"][form.slot + int(values[form.index.id])] = values[form.value.id]
    else:
        memory["c"][form.slot] = values[form.node.id]


@settings(max_examples=400, deadline=None)
@given(stores(), st.booleans(), st.randoms())
def test_rerolled_is_unrolled_in_any_order(s, near, random):
    """Loops read memory as they go, among all other stores in any order."""
    values = evaluate(s.graph.nodes, s.inputs)
    forms = plan(s.stores, CELLS, searched(s, near))
    memory = {name: [s.inputs[name, i] for i in range(SIZE)] for name in "pc"}
    every = [*forms.puts, *forms.loops, *forms.plain]
    random.shuffle(every)
    for form in every:
        stored(form, values, memory)
    expected = [float(values[x.node.id]) for x in s.stores]
    assert [float(x) for x in memory["c"]] == expected


@pytest.mark.parametrize("near", [False, True])
def test_what_is_one_loop_is_found(near):
    g = new_graph(rich=True)
    p, c = ([g.input(name, i, "f", True) for i in range(SIZE)] for name in "pc")
    nodes = [g.op("add", c[i], g.op("mul", p[SIZE - 1 - i], p[0])) for i in range(SIZE - 1)]
    s = Stores(g, [Store("c", i, n) for i, n in enumerate(nodes)], {})
    forms = plan(s.stores, CELLS, searched(s, near))
    assert not forms.puts and not forms.plain
    (loop,) = forms.loops
    assert len(loop.roll.members) == SIZE - 1
    assert {row.step for row in loop.roll.rows.values()} - {0} == {1, -1}


def test_an_update_at_an_index_is_one_store():
    g = new_graph(rich=True)
    c = [g.input("c", i, "f", True) for i in range(4)]
    index, go = g.input("index", 0, "i", bounds=(0, 3)), g.input("go", 0, "b")
    value = g.const(7.0, "f")
    made = []
    for k in range(4):
        here = g.op("and", g.op("eq", index, g.const(k, "i")), go)
        made.append(Store("c", k, g.op("select", here, value, c[k])))
    assert plan(made, CELLS, None) == ([], [Put("c", 0, index, value, go)], [])
    assert len(plan(made[:3], CELLS, None).plain) == 3  # the index may mean a fourth cell


# --- structure ---------------------------------------------------------------------------------


def broken(change):
    g = new_graph()
    x = g.input("x", 0, "f", True)
    g.op("add", x, g.op("mul", x, g.const(2.0, "f")))
    g.nodes[-1] = dataclasses.replace(g.nodes[-1], **change(g))
    return g


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda g: {"id": 9}, "stands at place 3"),
        (lambda g: {"op": "plus"}, "no such operation"),
        (lambda g: {"op": "sum"}, "only a kernel"),
        (lambda g: {"args": (new_graph().const(1.0, "f"), g.nodes[0])}, "does not stand before it"),
        (lambda g: {"args": g.nodes[:1]}, "1 arguments in place of 2"),
        (lambda g: {"kind": "i", "low": 0, "high": 1}, "its kind is i in place of f"),
        (lambda g: {"low": 2.0, "high": 1.0}, "bounds 2.0 .. 1.0"),
        (lambda g: {"low": math.nan}, "bounds nan"),
        (lambda g: {"op": "const", "args": (), "value": 3}, "its value is of type int"),
        (lambda g: {"op": "const", "args": (), "value": 3.0}, "its bounds are"),
        (lambda g: {"op": "is_finite", "args": g.nodes[:1], "kind": "b"}, "bounds"),
        (lambda g: {"op": "select", "args": (g.nodes[0],) * 3}, "no truth value"),
    ],
)
def test_a_malformed_graph_is_refused(change, said):
    with pytest.raises(MalformedGraphError, match=said):
        verify(broken(change))


def test_every_operation_has_a_text_or_a_reason():
    """Both back ends write each operation of each kind, or refuse it by name."""
    refused = {"cxx": set(), "c99": set()}
    for param in cases():
        op, kind, _ = param.values
        g = new_graph(rich=True)
        args = [g.input("x", i, k) for i, k in enumerate(kinds_of(op, kind))]
        node = g.op(op.name, *args)
        if node.op != op.name:
            continue
        for target, text in (
            ("cxx", lambda n=node: cxx.expression(n, [f"a{a.id}" for a in n.args], False)),
            ("c99", lambda n=node: c99.operation(n, [c99.Text("a")] * len(n.args), False, {}).text),
        ):
            try:
                assert "a" in text()
            except LoweringError as reason:
                assert op.name in str(reason)
                refused[target].add(f"{op.name}-{kind}")
    assert refused["c99"] == set()
    assert refused["cxx"] == {"rem-u", "lt-b", "le-b"}


@pytest.mark.parametrize("name", ["cascade-circle", "dfcmac-star"])
def test_the_graphs_of_kernels_are_well_formed(name):
    """After lowering, specialisation and hoisting: a graph holds the nodes of all passes."""
    one = program(case(name))
    moving = tuple(i for i, x in enumerate(one.inputs) if is_real(x))
    for what in ("forward", "tangent", "pullback"):
        made = kernel(one, what, shared_by_all(one), () if what == "forward" else moving)
        verify(made.lowered.graph)
        assert len(made.lowered.graph.nodes) > 100
