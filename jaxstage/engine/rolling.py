"""Equal computations on the cells of long arrays, which a kernel does in a loop.

Nodes are alike where they differ in nothing but the cells of long arrays that they read: what they
share is one node, the same for all. A loop over them is possible where these cells stand at equal
distances.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from jaxstage.engine.node import Node

#: fewer cells are no long array, and fewer rounds no loop
LONG = 32
#: a node that is made of more cells than this stands for itself: it is no computation on one cell
CELLS = 12


class Roll(NamedTuple):
    """first: the node of the first round. cells: of each cell that it reads, by the node's number,
    the text with a place for the slot, the first slot and the step to the next round. members:
    which of the given nodes it replaces, one a round."""

    first: Node
    cells: dict[int, tuple[str, int, int]]
    members: tuple[int, ...]


class Kinds:
    """What nodes have in common, by number: equal ones are alike."""

    def __init__(self, nodes: Iterable[Node], known: Iterable[int]) -> None:
        """nodes: all that there are, arguments first. known: those that stand for themselves."""
        nodes, known = list(nodes), set(known)
        counts: dict[Any, int] = {}
        for node in nodes:
            if node.op == "in" and node.kind == "f":
                counts[node.value[0]] = counts.get(node.value[0], 0) + 1
        self._numbers: dict[Any, int] = {}
        self.of: dict[int, int] = {}
        self.cells: dict[int, tuple[Node, ...]] = {}
        for node in nodes:
            own = self._cells_of(node, counts)
            alone = not own or len(own) > CELLS or node.id in known
            self.cells[node.id] = () if alone else own
            self.of[node.id] = self._number(("node", node.id) if alone else self._form(node, own))

    def _cells_of(self, node: Node, counts: dict[Any, int]) -> tuple[Node, ...]:
        if node.op == "in":
            return (node,) if counts.get(node.value[0], 0) >= LONG else ()
        if node.op in ("loop", "after", "load", "all_finite"):
            return ()
        return tuple(c for a in node.args for c in self.cells[a.id])[: CELLS + 1]

    def _form(self, node: Node, own: tuple[Node, ...]) -> Any:
        if node.op == "in":
            return "cell", node.value[0]
        return node.op, node.kind, repr(node.value), tuple(self.of[a.id] for a in node.args)

    def _number(self, form: Any) -> int:
        return self._numbers.setdefault(form, len(self._numbers))


def rolls(
    nodes: list[Node], keys: list[Any], kinds: Kinds, slot: Callable[[Node], tuple[str, int]]
) -> list[Roll]:
    """The loops that there are. keys: what the users of the nodes must have in common; slot: the
    text of a cell with a place for its slot, and its slot."""
    groups: dict[Any, list[int]] = {}
    for number, (node, key) in enumerate(zip(nodes, keys, strict=True)):
        if kinds.cells[node.id]:
            groups.setdefault((key, kinds.of[node.id]), []).append(number)
    found = []
    for members in groups.values():
        cells = _in_steps([kinds.cells[nodes[m].id] for m in members], slot)
        if len(members) >= LONG // 2 and cells is not None:
            found.append(Roll(nodes[members[0]], cells, tuple(members)))
    return found


def _in_steps(
    rounds: list[tuple[Node, ...]], slot: Callable[[Node], tuple[str, int]]
) -> dict[int, tuple[str, int, int]] | None:
    """The cells of the first round, if those of the others follow at equal distances."""
    if len({len(r) for r in rounds}) > 1 or len(rounds) < 2:
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
