"""Equal computations on the cells of long arrays, which a kernel does in a loop.

Nodes are alike where they differ in nothing but the cells of long arrays that they read: what they
share is one node, the same for all. A loop over them is possible where these cells stand at equal
distances.
"""

from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from jaxstage.compiler.ir.limits import LONG
from jaxstage.compiler.ir.node import Node

#: fewer rounds are no loop
ROUNDS = 16
#: a node that is made of more cells than this stands for itself: it is no computation on one cell
CELLS = 12


class Roll(NamedTuple):
    """first: the node of the first round. cells: of each cell that it reads, by the node's number,
    the text with a place for the slot, the first slot and the step to the next round. members:
    which of the given nodes it replaces, one a round."""

    first: Node
    cells: dict[int, tuple[str, int, int]]
    members: tuple[int, ...]


class Kinds(NamedTuple):
    """What nodes have in common. of: a number of each node, by its own; those that are alike have
    the same. cells: of long arrays that a node reads, none where it stands for itself."""

    of: dict[int, int]
    cells: dict[int, tuple[Node, ...]]


def kinds(nodes: list[Node], known: Iterable[int]) -> Kinds:
    """What nodes have in common. nodes: all that there are, arguments first; known: numbers of
    those that stand for themselves."""
    inputs = Counter(n.value[0] for n in nodes if n.op == "in" and n.kind == "f")
    numbers: dict[Any, int] = {}
    found, alone = Kinds({}, {}), set(known)
    for node in nodes:
        cells = _cells(node, inputs, found)
        if not cells or len(cells) > CELLS or node.id in alone:
            form: Any = "node", node.id
            cells = ()
        elif node.op == "in":
            form = "cell", node.value[0]
        else:
            alike = tuple(found.of[a.id] for a in node.args)
            form = node.op, node.kind, repr(node.value), alike
        found.cells[node.id] = cells
        found.of[node.id] = numbers.setdefault(form, len(numbers))
    return found


def _cells(node: Node, inputs: Counter[Any], found: Kinds) -> tuple[Node, ...]:
    if node.op == "in":
        return (node,) if inputs[node.value[0]] >= LONG else ()
    if node.op in ("loop", "after", "load", "all_finite"):
        return ()
    return tuple(c for a in node.args for c in found.cells[a.id])[: CELLS + 1]


def rolls(
    nodes: list[Node], keys: list[Any], alike: Kinds, slot: Callable[[Node], tuple[str, int]]
) -> list[Roll]:
    """The loops that there are. keys: what the users of the nodes must have in common; alike: what
    the nodes have; slot: the text of a cell with a place for its slot, and its slot."""
    groups: dict[Any, list[int]] = {}
    for number, (node, key) in enumerate(zip(nodes, keys, strict=True)):
        if alike.cells[node.id]:
            groups.setdefault((key, alike.of[node.id]), []).append(number)
    found = []
    for members in groups.values():
        if len(members) < ROUNDS:
            continue
        cells = _in_steps([alike.cells[nodes[m].id] for m in members], slot)
        if cells is not None:
            found.append(Roll(nodes[members[0]], cells, tuple(members)))
    return found


def _in_steps(
    rounds: list[tuple[Node, ...]], slot: Callable[[Node], tuple[str, int]]
) -> dict[int, tuple[str, int, int]] | None:
    """The cells of the first round, if those of the others follow at equal distances."""
    if len({len(r) for r in rounds}) > 1:
        return None
    found = {}
    for cells in zip(*rounds, strict=True):
        places = [slot(c) for c in cells]
        (text, start), (_, after) = places[0], places[1]
        step = after - start
        if places != [(text, start + i * step) for i in range(len(places))]:
            return None
        if found.setdefault(cells[0].id, (text, start, step)) != (text, start, step):
            return None
    return found
