"""The verifier: what must hold of every graph, whatever made it."""

import math
from collections.abc import Callable, Iterator
from typing import Any

from jaxstage.compiler.ir.graph import Graph
from jaxstage.compiler.ir.node import LIMITS, Node
from jaxstage.compiler.ir.operation import Op
from jaxstage.compiler.ir.ops import OPS

#: operations that only the graph of a kernel may hold
RICH = frozenset({"sum", "all_finite", "loop", "after"})
#: groups of the inputs of a round of an inner loop
_ROUND = ("L", "X")


class MalformedGraphError(Exception):
    """A graph that no pass may leave behind: the node, and what is wrong with it."""


def verify(graph: Graph) -> None:
    """Check the structure of a graph.

    Numbers of nodes are their places, arguments stand before their users, arity and kinds fit the
    operation, bounds are in order and within the kind, constants are what their bounds say, and
    bodies of loops fit what is carried and scanned.

    Raises:
        MalformedGraphError: Something does not hold.
    """
    for place, node in enumerate(graph.nodes):
        for problem in _problems(graph, node, place):
            raise MalformedGraphError(f"{node}: {problem}")


def _problems(graph: Graph, node: Node, place: int) -> Iterator[str]:
    """What is wrong with a node, first things first."""
    if node.id != place:
        yield f"it stands at place {place}"
    if node.op not in OPS:
        yield "no such operation"
        return
    for arg in node.args:
        if arg.id >= place or graph.nodes[arg.id] is not arg:
            yield f"its argument {arg} does not stand before it"
    if node.op in RICH and not graph.rich:
        yield "only a kernel may hold it"
    yield from _of_signature(OPS[node.op], node)
    yield from _of_bounds(node)
    check = _SPECIAL.get(node.op)
    if check is not None:
        yield from check(node)


def _of_signature(op: Op, node: Node) -> Iterator[str]:
    """Arity and kinds."""
    if op.arity is not None and len(node.args) != op.arity:
        yield f"{len(node.args)} arguments in place of {op.arity}"
        return
    if node.kind not in LIMITS:
        yield f"no kind {node.kind}"
    args = node.args[1:] if node.op == "select" else node.args
    if node.op == "select" and node.args[0].kind != "b":
        yield "its condition is no truth value"
    kinds = {a.kind for a in args}
    if not kinds <= {*op.takes}:
        yield f"arguments of the kinds {sorted(kinds)} in place of {op.takes}"
    if len(kinds) > 1 and node.op != "loop":
        yield f"arguments of different kinds {sorted(kinds)}"
    gives = op.gives or (args[-1].kind if args else "?")
    if gives not in ("?", node.kind):
        yield f"its kind is {node.kind} in place of {gives}"


def _of_bounds(node: Node) -> Iterator[str]:
    """Bounds in order, within the kind, whole where the kind is."""
    least, most = LIMITS[node.kind]
    if not least <= node.low <= node.high <= most:
        yield f"bounds {node.low} .. {node.high}"
    if node.nan and node.kind != "f":
        yield "only a real may be NaN"
    if node.kind != "f" and any(isinstance(bound, float) for bound in (node.low, node.high)):
        yield "bounds of an integer are whole numbers"


def _of_const(node: Node) -> Iterator[str]:
    value: Any = node.value
    expected = {"f": float, "b": bool}.get(node.kind, int)
    if type(value) is not expected:
        yield f"its value is of type {type(value).__name__}"
    elif math.isnan(value) != node.nan or (not node.nan and not node.low == value == node.high):
        yield f"its bounds are {node.low} .. {node.high}"


def _of_place(node: Node) -> Iterator[str]:
    if node.value is None or not isinstance(node.value[1], int):
        yield "it does not say where it stands"


def _of_load(node: Node) -> Iterator[str]:
    yield from _of_place(node)
    if math.isinf(node.args[0].low) or math.isinf(node.args[0].high):
        yield "its index has no bounds"


def _of_loop(node: Node) -> Iterator[str]:
    """The body gives what it is given, and reads nothing of a round that is not carried."""
    inner: Any = node.value
    if [n.kind for n in inner.begin] != [n.kind for n in inner.inside]:
        yield "the carry changes its kinds"
    reads = {a.id for a in node.args}
    if not {n.id for n in inner.begin} <= reads:
        yield "it does not read the carry before it"
    counts = {"L": len(inner.begin), "X": len(inner.scanned)}
    seen = set(reads)
    stack: list[Node] = [*inner.inside, *inner.rows]
    while stack:
        body = stack.pop()
        if body.id in seen:
            continue
        seen.add(body.id)
        stack += body.args
        if body.op == "in" and body.value[0][0] in _ROUND:
            (group, number), at = body.value
            if number == inner.number and at >= counts[group]:
                yield f"{body} is no cell of a round"


def _of_after(node: Node) -> Iterator[str]:
    loop, cell = node.args[0], node.value[-1]
    if loop.op != "loop":
        yield "it follows no loop"
        return
    inner: Any = loop.value
    cells = inner.inside if node.value[0] == "c" else inner.rows
    if cell >= len(cells):
        yield "the loop does not give it"
    elif cells[cell].kind != node.kind:
        yield f"its kind is {node.kind}, the loop gives {cells[cell].kind}"


_SPECIAL: dict[str, Callable[[Node], Iterator[str]]] = {
    "const": _of_const,
    "in": _of_place,
    "load": _of_load,
    "loop": _of_loop,
    "after": _of_after,
}
