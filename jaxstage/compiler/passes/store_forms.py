"""What a tick stores: cells set one by one, at an index, under a condition, or in a loop."""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxstage.compiler.ir.node import LIMITS, Node
from jaxstage.compiler.passes.loop_reroll import Kinds, Roll, rolls

#: in a C++ text: the number of a vector of runs
COPY = "@"


class Store(NamedTuple):
    """What becomes of a result: cell ``slot`` of an array, set or added to; only ``where``."""

    array: str
    slot: int
    node: Node
    add: bool = False
    where: Node | None = None

    @property
    def needs(self) -> list[Node]:
        """The nodes that it reads."""
        return [self.node, *([self.where] if self.where is not None else [])]


class Cells(NamedTuple):
    """Where inputs stand. read(node): C text of an input; array(source): C text of the array that
    a load reads, with the slot of its element 0; slot(node): C text of a real input with a place
    for its slot, and its slot, or None where nothing is put in loops."""

    read: Callable[[Node], str]
    array: Callable[[Any], tuple[str, int]]
    slot: Callable[[Node], tuple[str, int]] | None = None


class Put(NamedTuple):
    """A value that goes to one cell of an array, whose index the run knows."""

    array: str
    slot: int
    index: Node
    value: Node
    where: Node | None

    @property
    def needs(self) -> list[Node]:
        """The nodes that it reads."""
        return [self.index, self.value, *([self.where] if self.where is not None else [])]


def indexed(stores: list[Store], cells: Cells) -> tuple[list[Put], list[Store]]:
    """The stores that are together one update at an index, and the rest.

    Cell k gets ``index == k ? value : what it held``, for every k that the index can mean.
    Stores of what a cell held already are left out.
    """
    groups: dict[Any, list[tuple[int, Store]]] = {}
    rest: list[Store] = []
    parts: dict[Any, tuple[Node, Node, Node | None]] = {}
    for store in stores:
        if _holds(store, store.node, cells) and not store.add:
            continue
        found = _update(store, cells)
        if found is None:
            rest.append(store)
            continue
        index, number, value, where = found
        key = (store.array, store.slot - number, index.id, value.id, where and where.id)
        parts[key] = index, value, where
        groups.setdefault(key, []).append((number, store))
    puts = []
    for key, members in groups.items():
        index, value, where = parts[key]
        if {n for n, _ in members} >= set(range(int(index.low), int(index.high) + 1)):
            puts.append(Put(key[0], key[1], index, value, where))
        else:
            rest += [s for _, s in members]
    return puts, rest


def _holds(store: Store, node: Node, cells: Cells) -> bool:
    return node.op == "in" and cells.read(node) == f"{store.array}[{store.slot}]"


def _update(store: Store, cells: Cells) -> tuple[Node, int, Node, Node | None] | None:
    node = store.node
    if (
        node.op != "select"
        or store.add
        or node.kind != "f"
        or not _holds(store, node.args[2], cells)
    ):
        return None
    condition, value, _ = node.args
    where = None
    sides = condition.args if condition.op == "and" else (condition,)
    for position, side in enumerate(sides):
        if side.op == "eq" and side.args[1].op == "const" and _bounded(side.args[0]):
            if len(sides) == 2:
                where = sides[1 - position]
            return side.args[0], side.args[1].value, value, where
    return None


def _bounded(index: Node) -> bool:
    return index.kind in "il" and LIMITS["i"][0] < index.low <= index.high < LIMITS["i"][1]


def excluded(store: Store, condition: Node, cells: Cells) -> bool:
    """Whether a store is ``other condition ? value : what the cell held``, with a condition that
    never holds together with this one."""
    node = store.node
    if node.op != "select" or store.add or not _holds(store, node.args[2], cells):
        return False
    given = conjuncts(condition)
    return any(
        (part, not truth) in given or (not truth and conjuncts(part) <= given)
        for part, truth in conjuncts(node.args[0])
    )


def conjuncts(node: Node) -> set[tuple[Node, bool]]:
    """Conditions that must all be as given for a condition to hold."""
    if node.op == "and":
        return conjuncts(node.args[0]) | conjuncts(node.args[1])
    return {(node.args[0], False)} if node.op == "not" else {(node, True)}


def _freed(store: Store, cells: Cells) -> Store:
    """A store of ``where ? value : what the cell held`` as one of the value, only ``where``."""
    node = store.node
    if node.op == "select" and node.kind == "f" and _holds(store, node.args[2], cells):
        return store._replace(node=node.args[1], where=node.args[0])
    return store


def guarded(stores: list[Store], cells: Cells) -> tuple[list[list[Store]], list[Store]]:
    """Stores of ``where ? value : what the cell held`` under one condition, and the rest."""
    groups: dict[int, list[Store]] = {}
    rest = []
    for store in stores:
        own = _freed(store, cells)
        if own.where is not None:
            groups.setdefault(own.where.id, []).append(own)
        else:
            rest.append(store)
    several = [g for g in groups.values() if len(g) > 2]
    for group in groups.values():
        if len(group) <= 2:
            rest += [
                s for s in stores if any(s.array == o.array and s.slot == o.slot for o in group)
            ]
    return several, rest


class Rolled(NamedTuple):
    """Stores in a loop. store: that of the first round; step: of its slot to the next round."""

    store: Store
    step: int
    roll: Roll


def rolled(stores: list[Store], kinds: Kinds, cells: Cells) -> tuple[list[Rolled], list[Store]]:
    """The stores that are made in loops, and the rest.

    Loops store while they read: none may read what another store, or another round, sets.
    """
    freed = [_freed(s, cells) for s in stores]
    keys = [(s.array, s.add, s.where and s.where.id) for s in freed]
    written = {(s.array, s.slot): i for i, s in enumerate(stores)}
    found, used = [], set()
    for roll in rolls([s.node for s in freed], keys, kinds, cells.slot):  # type: ignore[arg-type]
        slots = [freed[m].slot for m in roll.members]
        step = slots[1] - slots[0]
        steady = slots == [slots[0] + i * step for i in range(len(slots))]
        if steady and all(_alone(c, roll, written) for c in roll.cells.values()):
            found.append(Rolled(freed[roll.members[0]], step, roll))
            used.update(roll.members)
    return found, [s for i, s in enumerate(stores) if i not in used]


def _alone(cell: tuple[str, int, int], roll: Roll, written: dict[tuple[str, int], int]) -> bool:
    text, start, step = cell
    array = text.partition("[")[0]
    places = [written.get((array, start + i * step)) for i in range(len(roll.members))]
    return all(p is None or p == m for p, m in zip(places, roll.members, strict=True))
