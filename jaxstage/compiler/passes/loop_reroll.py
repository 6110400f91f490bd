"""Loop rerolling: equal computations on the cells of arrays, written as one loop.

Nodes go into one loop where they have one form: they differ in nothing but cells that stand at
equal distances (anti-unification). Kernels look for such nodes anywhere (`alike_nodes`: in all but
the cells of long arrays they are the same), controllers among neighbours, whose leaves may also
differ at will: these are first put into a local array.
"""

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from jaxstage.compiler.ir.limits import LONG
from jaxstage.compiler.ir.node import Node

#: a node that is made of more cells than this stands for itself: it is no computation on one cell
CELLS = 12

#: the text of a cell with a place ``{}`` for its slot, and its slot
Slot = Callable[[Node], tuple[str, int]]


class Alike(NamedTuple):
    """What nodes have in common.

    Attributes:
        of: Number of a node -> number of its class; nodes of one class are alike.
        cells: Number of a node -> the cells of long arrays that it reads, none where it stands for
            itself.
    """

    of: dict[int, int]
    cells: dict[int, tuple[Node, ...]]


def alike_nodes(nodes: list[Node], known: Iterable[int]) -> Alike:
    """Value numbering modulo the cells of long arrays.

    Args:
        nodes: All nodes, arguments first.
        known: Numbers of those that stand for themselves.
    """
    inputs = Counter(n.value[0] for n in nodes if n.op == "in" and n.kind == "f")
    numbers: dict[Any, int] = {}
    alike, alone = Alike({}, {}), set(known)
    for node in nodes:
        cells = _cells(node, inputs, alike)
        if not cells or len(cells) > CELLS or node.id in alone:
            form: Any = "node", node.id
            cells = ()
        elif node.op == "in":
            form = "cell", node.value[0]
        else:
            parts = tuple(alike.of[a.id] for a in node.args)
            form = node.op, node.kind, repr(node.value), parts
        alike.cells[node.id] = cells
        alike.of[node.id] = numbers.setdefault(form, len(numbers))
    return alike


def _cells(node: Node, inputs: Counter[Any], alike: Alike) -> tuple[Node, ...]:
    if node.op == "in":
        return (node,) if inputs[node.value[0]] >= LONG else ()
    if node.op in ("loop", "after", "load", "all_finite"):
        return ()
    return tuple(c for a in node.args for c in alike.cells[a.id])[: CELLS + 1]


class LoopSearch(NamedTuple):
    """What a back end puts in loops.

    Attributes:
        rounds: Fewer are no loop.
        slot: How a cell is read.
        alike: Loops over nodes that are alike, wherever they are.
        uses: Of each node; in place of `alike`, loops over neighbours, which may read local arrays.
    """

    rounds: int
    slot: Slot
    alike: Alike | None = None
    uses: Counter[int] | None = None


class Row(NamedTuple):
    """Cells at equal distances: their text, the slot of the first and the step to the next."""

    text: str
    start: int
    step: int

    def cell(self, number: int) -> str:
        """The text of one of them."""
        return self.text.format(self.start + number * self.step)


class Roll(NamedTuple):
    """A loop.

    Attributes:
        form: The node of any round, in terms of the leaves below. Among alike nodes it has the
            numbers of the first round.
        members: Which of the nodes that were looked at it replaces, one a round.
        rows: Number of a leaf of the form -> the cells that it stands for.
        others: Number of a leaf of the form -> the nodes that it stands for, one a round.
        same: Nodes that all rounds read.
    """

    form: Node
    members: tuple[int, ...]
    rows: dict[int, Row]
    others: dict[int, tuple[Node, ...]]
    same: tuple[Node, ...]

    @property
    def needs(self) -> list[Node]:
        """What has to be known before the loop, cells apart."""
        return [*self.same, *(node for nodes in self.others.values() for node in nodes)]


def rolls(nodes: Sequence[Node], groups: Iterable[Sequence[int]], search: LoopSearch) -> list[Roll]:
    """The loops that replace groups of nodes, given by their places among the nodes."""
    loops: list[Roll] = []
    for members in groups:
        if len(members) >= search.rounds:
            roll = _rolled(nodes, tuple(members), search)
            if roll is not None:
                loops.append(roll)
    return loops


def groups_of_alike(nodes: Sequence[Node], keys: Sequence[Any], alike: Alike) -> list[list[int]]:
    """Places of nodes that are alike. keys: what their users must have in common."""
    groups: dict[Any, list[int]] = {}
    for number, (node, key) in enumerate(zip(nodes, keys, strict=True)):
        if alike.cells[node.id]:
            groups.setdefault((key, alike.of[node.id]), []).append(number)
    return list(groups.values())


def gathered(nodes: Sequence[Node], search: LoopSearch) -> dict[int, tuple[list[Node], list[Roll]]]:
    """Sums, and claims of many parts, that hold loops.

    Args:
        nodes: All nodes, arguments first.
        search: What becomes a loop. Neighbours are the terms of a whole sum.

    Returns:
        Number of the sum -> its terms, and the loops over some of them.
    """
    uses = search.uses
    inner = set[int]()
    if uses is not None:
        inner = {a.id for n in nodes if _adds(n) for a in n.args if _adds(a) and uses[a.id] == 1}
    sums: dict[int, tuple[list[Node], list[Roll]]] = {}
    for node in nodes:
        if node.op in ("sum", "all_finite"):
            terms = [*node.args]
        elif uses is not None and _adds(node) and node.id not in inner:
            terms = _terms(node, uses)
        else:
            continue
        groups = [[*range(len(terms))]]
        if search.alike is not None:
            groups = groups_of_alike(terms, [0] * len(terms), search.alike)
        loops = rolls(terms, groups, search)
        if loops:
            sums[node.id] = terms, loops
    return sums


def _adds(node: Node) -> bool:
    return node.op == "add" and node.kind == "f"


def _terms(node: Node, uses: Counter[int]) -> list[Node]:
    """The terms of a tree of additions whose partial sums nobody else reads."""
    terms: list[Node] = []
    todo = list(node.args[::-1])
    while todo:
        term = todo.pop()
        if _adds(term) and uses[term.id] == 1:
            todo += term.args[::-1]
        else:
            terms.append(term)
    return terms


# --- anti-unification ----------------------------------------------------------------------------

Together = tuple[Node, ...]


@dataclasses.dataclass
class _Forms:
    """The forms of nodes of all rounds together, as far as they are made."""

    search: LoopSearch
    made: dict[tuple[int, ...], Node] = dataclasses.field(default_factory=dict)
    taken: set[int] = dataclasses.field(default_factory=set)
    rows: dict[int, Row] = dataclasses.field(default_factory=dict)
    others: dict[int, Together] = dataclasses.field(default_factory=dict)
    same: list[Node] = dataclasses.field(default_factory=list)
    operations: int = 0


def _rolled(nodes: Sequence[Node], members: tuple[int, ...], search: LoopSearch) -> Roll | None:
    """The loop over some nodes, or None where they have no form or nothing is gained by it."""
    forms, whole = _Forms(search), tuple(nodes[m] for m in members)
    stack = [whole]
    while stack:
        together = stack[-1]
        parts = _parts(forms, together)
        missing = [p for p in parts if _key(p) not in forms.made]
        if missing:
            stack += reversed(missing)
            continue
        stack.pop()
        if _key(together) not in forms.made and not _make(forms, together, parts):
            return None
    others = forms.others.values()
    mixed = any(len({node.kind for node in together}) > 1 for together in others)
    if mixed or (others and forms.operations <= len(others)):
        return None
    return Roll(forms.made[_key(whole)], members, forms.rows, forms.others, tuple(forms.same))


def _key(together: Together) -> tuple[int, ...]:
    return tuple(node.id for node in together)


def _is_same(forms: _Forms, together: Together) -> bool:
    """Whether all rounds read one node, which is no cell of a long array."""
    first, alike = together[0], forms.search.alike
    if alike is not None:
        return not alike.cells[first.id]
    return all(node is first for node in together)


def _parts(forms: _Forms, together: Together) -> list[Together]:
    """The arguments of one operation in all rounds; none of a leaf."""
    first, uses = together[0], forms.search.uses
    if first.op in ("in", "const", "load") or _is_same(forms, together):
        return []
    shape = first.op, first.kind, len(first.args)
    if any((n.op, n.kind, len(n.args)) != shape for n in together):
        return []
    if uses is not None and any(uses[n.id] != 1 for n in together):
        return []
    return list(zip(*(n.args for n in together), strict=True))


def _make(forms: _Forms, together: Together, parts: list[Together]) -> bool:
    """Make the form of nodes whose parts have theirs; False where they have none."""
    first = together[0]
    if _is_same(forms, together):
        forms.same.append(first)
        forms.made[_key(together)] = first
        return True
    neighbours = forms.search.uses is not None
    number = -len(forms.made) - 1 if neighbours else first.id
    if number in forms.taken:  # it stands for another cell in the other rounds
        return False
    forms.taken.add(number)
    args = tuple(forms.made[_key(p)] for p in parts)
    value = None
    if args:
        forms.operations += 1
        value = first.value
    else:
        row = _row(together, forms.search.slot)
        if row is not None:
            forms.rows[number] = row
        elif neighbours:
            forms.others[number] = together
        else:
            return False
    op = first.op if args else "in"
    low, high = min(n.low for n in together), max(n.high for n in together)
    nan = any(n.nan for n in together)
    forms.made[_key(together)] = Node(op, first.kind, args, value, low, high, nan, number)
    return True


def _row(together: Together, slot: Slot) -> Row | None:
    """The cells of all rounds, if they stand at equal distances."""
    first = together[0]
    if any(n.op != "in" or n.kind != first.kind for n in together):
        return None
    places = [slot(n) for n in together]
    (text, start), (_, after) = places[0], places[1]
    step = after - start
    steady = places == [(text, start + i * step) for i in range(len(places))]
    return Row(text, start, step) if steady else None
