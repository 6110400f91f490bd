"""A program as C++: which numbers the kernel gets, and what it computes of them."""

from typing import Any, NamedTuple

import numpy as np

from jaxstage.engine.graph import Graph, new_graph
from jaxstage.engine.node import Node, kind_of
from jaxstage.engine.parts import FIXED, RUN, TICK, Parts, Steps, counters, cut, in_line
from jaxstage.engine.program import Program
from jaxstage.engine.scalar import evaluate, lifted
from jaxstage.engine.spelling import constant
from jaxstage.engine.statements import Known, write
from jaxstage.engine.stores import COPY, Cells, Store
from jaxstage.engine.table import WRITTEN_OUT, Table

#: shared arrays of more elements stay in memory
TABLE = 64


class Slots(NamedTuple):
    """The elements of one group that a kernel reads: (array, element) -> its slot.

    Reals and integers stand in arrays of their own.
    """

    real: dict[tuple[int, int], int]
    whole: dict[tuple[int, int], int]

    def slot(self, node: Node) -> int:
        """The slot of an input, made if it is new."""
        (_, number), element = node.value
        table = self.real if node.kind == "f" else self.whole
        return table.setdefault((number, element), len(table))


class Lowered(NamedTuple):
    """A program as a graph, and what its kernel is to be given.

    graph, results: of a tick. parts: what JAX computes. counter: which carried integers count the
    ticks. tables: values of `parts` that are read in memory.
    """

    graph: Graph
    parts: Parts
    results: list[Any]
    counter: frozenset[int]
    tables: tuple[int, ...]
    single: bool


def lower(program: Program, closed: Any, own: tuple[bool, ...], groups: tuple[str, ...]) -> Lowered:
    """The graph of a jaxpr whose first arguments are the leaves of the program.

    own: of each shared leaf and each carried one, whether runs have it for themselves. groups: the
    names of further arguments' inputs, one an argument. Raises NotImplementedError with the reason.
    """
    steps = in_line(closed)
    carry = range(program.before, program.before + len(program.carry))
    inputs = len(program.inputs)
    counting = frozenset(n for n in counters(steps, carry) if not own[len(program.shared) + n])
    levels = [RUN] * inputs
    levels += [RUN if own[i] else FIXED for i in range(len(program.shared))]
    levels += [TICK if n in counting else RUN for n in range(len(program.carry))]
    levels += [RUN] * len(groups)
    parts = cut(steps, levels)
    graph = new_graph(program.single, rich=True)
    values, tables = _inputs(program, graph, parts, groups)
    for step in parts.own():
        reads = [_value(graph, values, v) for v in step.reads]
        values.update(zip(step.writes, evaluate(graph, step.equation, reads), strict=True))
    results = [_value(graph, values, v) for v in steps.results]
    return Lowered(graph, parts, results, counting, tables, program.single)


def _value(graph: Graph, values: dict[int, Any], value: Any) -> Any:
    return values[value] if isinstance(value, int) else lifted(graph, value.value)


def _shape_of(steps: Steps, leaves: Any) -> dict[int, Any]:
    shapes = dict(zip(steps.arguments, leaves, strict=False))
    for step in steps.steps:
        shapes.update((w, v.aval) for w, v in zip(step.writes, step.equation.outvars, strict=True))
    return shapes


def _inputs(
    program: Program, graph: Graph, parts: Parts, groups: tuple[str, ...]
) -> tuple[dict[int, Any], tuple[int, ...]]:
    steps, leaves = parts.program, program.leaves
    values: dict[int, Any] = {n: lifted(graph, v) for n, v in steps.constants.items()}
    read = {v for step in parts.own() for v in step.reads if isinstance(v, int)}
    read |= {v for v in steps.results if isinstance(v, int)}
    for number, leaf in enumerate(leaves):
        value = steps.arguments[number]
        if parts.of(value) == RUN and value in read:
            if leaf.size > WRITTEN_OUT:
                raise NotImplementedError(
                    f"an array of {leaf.size} numbers that each run has for itself (a stored path)"
                )
            carried = number - program.before
            group = ("c", carried) if carried >= 0 else ("p", number)
            promised = carried >= 0 and program.finite
            values[value] = _array(graph, group, leaf, promised)
    extra = steps.arguments[len(leaves) :]
    for value, group in zip(extra, groups, strict=True):
        name, number = group[0], int(group[1:])
        leaf = leaves[number] if name == "q" else program.carry[number]
        values[value] = _array(graph, (name, number), leaf, False)
    shapes, tables = _shape_of(steps, leaves), []
    for value in parts.handed():
        shape = shapes[value]
        if parts.of(value) == FIXED and int(np.prod(shape.shape)) > TABLE:
            values[value] = Table(("t", len(tables)), tuple(shape.shape), kind_of(shape.dtype))
            tables.append(value)
        else:
            group = "s" if parts.of(value) == FIXED else "r"
            values[value] = _array(graph, (group, value), shape, False)
    return values, tuple(tables)


def _array(graph: Graph, group: Any, leaf: Any, finite: bool) -> np.ndarray:
    out = np.empty(leaf.shape, object)
    kind = kind_of(leaf.dtype)
    if kind == "k":
        return out
    if kind == "l" and group[0] in "cp":
        raise NotImplementedError("64-bit integers that each run has for itself")
    _check_width(leaf.dtype, graph)
    for number, index in enumerate(np.ndindex(*leaf.shape)):
        out[index] = graph.input(group, number, kind, finite)
    return out


def _check_width(dtype: Any, graph: Graph) -> None:
    width = 4 if graph.largest < 1e39 else 8
    if np.issubdtype(dtype, np.floating) and np.dtype(dtype).itemsize != width:
        raise NotImplementedError(f"{np.dtype(dtype).name} beside reals of {8 * width} bits")


def flat(array: np.ndarray) -> list[Node]:
    """The nodes of an array in C order."""
    return list(array.reshape(-1))


class Layout(NamedTuple):
    """Where everything stands in a kernel: the slots of each group that it reads.

    carry: slots of all carried cells (reals first in ``c``, integers in ``ci``), by (leaf, cell).
    """

    groups: dict[str, Slots]
    carry: dict[int, tuple[bool, int]]
    moving: dict[tuple[str, int], int]


def layout(program: Program, lowered: Lowered, moving: tuple[int, ...]) -> Layout:
    """Slots of the carry and of derivatives; the others are given as they are read."""
    carry, moved, counts = {}, {}, {True: 0, False: 0}
    for number, leaf in enumerate(program.carry):
        if number in lowered.counter:
            continue
        real = kind_of(leaf.dtype) == "f"
        carry[number] = real, counts[real]
        counts[real] += int(np.prod(leaf.shape))
    at = 0
    for number in program.real_carry:
        moved["d", number] = moved["g", number] = at
        at += int(np.prod(program.carry[number].shape))
    at = 0
    for number in moving:
        moved["q", number] = moved["a", number] = at
        at += int(np.prod(program.leaves[number].shape))
    groups = {name: Slots({}, {}) for name in ("p", "s", "r")}
    return Layout(groups, carry, moved)


def cells(where: Layout) -> Cells:
    """How inputs are read in C++."""

    def slot(node: Node) -> tuple[str, int]:
        (group, number), element = node.value
        whole = node.kind != "f"
        if group == "c":
            name = "ci" if whole else "c"
            return f"{name}{COPY}[{{}}]", where.carry[number][1] + element
        if group in "dg":
            return f"{group}{COPY}[{{}}]", where.moving[group, number] + element
        if group == "q":
            return "load(Q+{}*NB+b)", where.moving[group, number] + element
        return _READ[group, whole], where.groups[group].slot(node)

    def read(node: Node) -> str:
        form, number = slot(node)
        text = form.format(number)
        if node.kind == "u":
            return f"to_uint32({text})"
        return f"as_mask({text})" if node.kind == "b" else text

    def array(source: Any) -> tuple[str, int]:
        group, number = source
        if group == "t":
            return f"T{number}", 0
        if group == "c" and where.carry[number][0]:
            return f"c{COPY}", where.carry[number][1]
        if group in "dg":
            return f"{group}{COPY}", where.moving[group, number]
        raise NotImplementedError("an index into parameters that each run has for itself")

    return Cells(read, array, slot)


_READ = {
    ("p", False): "load(P+{}*NB+b)", ("p", True): "load_ints(PI+{}*NB+b)",
    ("s", False): "all(S[{}])", ("s", True): "same(SI[{}])",
    ("r", False): "all(r[{}])", ("r", True): "same(ri[{}])",
}  # fmt: skip


def _fixed(node: Node, fixed: dict[int, bool]) -> bool:
    """Whether a node is the same in every tick."""
    known = fixed.get(node.id)
    if known is None:
        if node.op == "in":
            known = node.value[0][0] in "psq"
        elif node.op == "load":
            known = node.value[0][0] == "t" and _fixed(node.args[0], fixed)
        else:
            known = all([_fixed(a, fixed) for a in node.args])
        fixed[node.id] = known
    return known


def _invertible(node: Node, fixed: dict[int, bool], exact: set[int]) -> bool:
    """Whether a division may be a product with the reciprocal of what is the same in every tick."""
    divides = node.op == "div" and node.kind == "f" and node.id not in exact
    return divides and node.id in fixed and not fixed[node.id] and fixed[node.args[1].id]


def _quantised(nodes: list[Node]) -> set[int]:
    """Divisions whose quotient is rounded and multiplied again, as an encoder does: one rounding
    more would move whole steps."""
    rounded = ("floor", "ceil", "round")
    stack = [x for n in nodes if n.op == "mul" for x in n.args if x.op in rounded]
    found: set[int] = set()
    while stack:
        node = stack.pop()
        if node.op == "div":
            found.add(node.id)
        elif node.op in (*rounded, "add", "sub", "neg"):
            stack.extend(node.args)
    return found


class Hoisted(NamedTuple):
    """What is computed before the time loop, into ``h`` and ``hi``: statements and names."""

    lines: list[str]
    known: Known
    reals: int
    wholes: int


def hoist(low: Lowered, stores: list[Store], where: Cells) -> Hoisted:
    """Take out of the loop what is the same in every tick, and reciprocals of such divisors."""
    g, fixed = low.graph, {}
    for node in g.nodes:  # arguments first: no deep recursion
        _fixed(node, fixed)
    exact = _quantised(g.nodes)
    outer: dict[int, Node] = {}
    inverse: dict[int, Node] = {}
    seen: set[int] = set()
    stack = [s.node for s in stores]
    while stack:
        node = stack.pop()
        if node.id in seen or node.op == "const":
            continue
        seen.add(node.id)
        if fixed[node.id]:
            outer[node.id] = node
            continue
        if _invertible(node, fixed, exact):
            inverse[node.args[1].id] = g.op("div", g.const(1, "f"), node.args[1])
            stack.append(node.args[0])
            continue
        stack.extend(node.args)
        if node.op == "loop":
            stack.extend((*node.value.inside, *node.value.rows))
    names, made, counts = {}, [], {True: 0, False: 0}
    for node in [*outer.values(), *inverse.values()]:
        if node.op == "const" or node.id in names:
            continue
        real = node.kind == "f"
        name = "h" if real else "hi"
        made.append(Store(name, counts[real], node))
        text = f"{name}{COPY}[{counts[real]}]"
        names[node.id] = f"as_mask({text})" if node.kind == "b" else text
        counts[real] += 1
    lines = write(made, where, Known({}, {}), low.single, "p")
    texts = {y: constant(n) if n.op == "const" else names[n.id] for y, n in inverse.items()}
    reciprocals = {
        n.id: texts[n.args[1].id] for n in g.nodes
        if n.op == "div" and n.args[1].id in texts and _invertible(n, fixed, exact)
    }  # fmt: skip
    return Hoisted(lines, Known(names, reciprocals), counts[True], counts[False])
