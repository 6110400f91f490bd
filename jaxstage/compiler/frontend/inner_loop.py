"""A loop inside a tick that stays a loop: too long to be written out.

The node ``loop`` has an `Inner` as its value and everything that it reads from outside as its
arguments. What it gives are nodes ``after`` it, whose value is (``c``, cell of the carry) or
(``y``, round, cell of the row).
"""

from typing import Any, NamedTuple

import numpy as np

from jaxstage.compiler.ir.graph import Graph
from jaxstage.compiler.ir.node import Node


class Inner(NamedTuple):
    """The body of a loop.

    Attributes:
        number: Its number.
        length: Rounds.
        reverse: Whether the last row comes first.
        begin: Cells of the carry before it.
        inside: Cells of the carry after a round.
        rows: Cells of the row of a round.
        scanned: Where each scanned cell comes from: (``count``, first, step), (``rows``, loop,
            cell) or (``own``, its nodes).
    """

    number: int
    length: int
    reverse: bool
    begin: tuple[Node, ...]
    inside: tuple[Node, ...]
    rows: tuple[Node, ...]
    scanned: tuple[Any, ...]


def inputs(g: Graph, number: int, name: str, like: list[np.ndarray], bounds: Any) -> list[Any]:
    """Arrays of inputs of a round.

    Args:
        g: Gets the inputs.
        number: Of the loop.
        name: ``L`` for the carry, ``X`` for what is scanned.
        like: Arrays of the same shapes and kinds.
        bounds: Bounds of an input, by its place among all of them.
    """
    out, at = [], 0
    for array in like:
        cells = np.empty(array.shape, object)
        for index in np.ndindex(*array.shape):
            cells[index] = g.input((name, number), at, _kind(array[index]), bounds=bounds(at))
            at += 1
        out.append(cells)
    return out


def source_of(nodes: list[Node]) -> Any:
    """Where one scanned cell comes from.

    Args:
        nodes: The cell in every round.

    Returns:
        (``count``, first, step), (``rows``, loop, cell), or (``own``, the nodes).
    """
    first = nodes[0]
    if first.op == "const" and first.kind in "il":
        step = nodes[1].value - first.value if len(nodes) > 1 else 0
        if all(n.op == "const" and n.value == first.value + i * step for i, n in enumerate(nodes)):
            return "count", first.value, step
    if first.op == "after" and first.value[0] == "y":
        loop, cell = first.args[0], first.value[2]
        same = [
            n.op == "after" and n.args[0] is loop and n.value == ("y", i, cell)
            for i, n in enumerate(nodes)
        ]
        if all(same) and len(nodes) == loop.value.length:
            return "rows", loop, cell
    return "own", tuple(nodes)


def bounds_of(source: Any, length: int) -> Any:
    """The range of a counted cell."""
    if source[0] != "count":
        return None
    ends = source[1], source[1] + (length - 1) * source[2]
    return min(ends), max(ends)


def loop_node(g: Graph, inner: Inner, since: int) -> Node:
    """The node of a loop, which reads what its body reads from outside.

    Args:
        g: Gets the node.
        inner: The body.
        since: Nodes from this one on may be inside.
    """
    number = inner.number
    within: dict[int, bool] = {}

    def is_inside(node: Node) -> bool:
        if node.id < since:
            return False
        if node.id not in within:
            own = node.op == "in" and node.value[0] in (("L", number), ("X", number))
            within[node.id] = own or any([is_inside(a) for a in node.args])
        return within[node.id]

    for node in g.nodes[since:]:
        is_inside(node)
    reads: dict[int, Node] = {n.id: n for n in inner.begin}
    for source in inner.scanned:
        if source[0] == "rows":
            reads[source[1].id] = source[1]
        elif source[0] == "own":
            reads.update((n.id, n) for n in source[1])
    seen: set[int] = set()
    stack = [*inner.inside, *inner.rows]
    while stack:
        node = stack.pop()
        if node.id in seen:
            continue
        seen.add(node.id)
        if is_inside(node):
            stack.extend(node.args)
        else:
            reads[node.id] = node
    return g.special("loop", tuple(reads.values()), inner, "f")


def after(g: Graph, loop: Node, value: Any, kind: str) -> Node:
    """A result of a loop."""
    return g.special("after", (loop,), value, kind)


def _kind(node: Any) -> str:
    return node.kind


def results(
    g: Graph, loop: Node, carry: list[np.ndarray], rows: list[np.ndarray]
) -> list[np.ndarray]:
    """The arrays that a scan gives: the last carry, and the rows of all rounds."""
    out, at = [], 0
    for array in carry:
        cells = np.empty(array.shape, object)
        for index in np.ndindex(*array.shape):
            cells[index] = after(g, loop, ("c", at), _kind(array[index]))
            at += 1
        out.append(cells)
    at = 0
    for array in rows:
        cells = np.empty((loop.value.length, *array.shape), object)
        for index in np.ndindex(*array.shape):
            for t in range(loop.value.length):
                cells[(t, *index)] = after(g, loop, ("y", t, at), _kind(array[index]))
            at += 1
        out.append(cells)
    return out
