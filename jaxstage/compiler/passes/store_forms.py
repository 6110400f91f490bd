"""Forms of stores: cells set one by one, at an index, under a condition, or in a loop."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from jaxstage.compiler.ir.node import LIMITS, Node
from jaxstage.compiler.passes.loop_reroll import (
    LoopSearch,
    Roll,
    Row,
    groups_of_alike,
    rolls,
)

#: in a C++ text: the number of a vector of runs
COPY = "@"


class Store(NamedTuple):
    """What becomes of a result.

    Attributes:
        array: Text of the array that it goes to.
        slot: Which cell of it.
        node: The value.
        add: Whether it is added to the cell, else it replaces it.
        where: Only where this holds; None for always.
    """

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
    """Where inputs stand.

    Attributes:
        read: Text of an input.
        array: Text of the array that a load reads, and the slot of its element 0.
        slot: Text of a real input with a place for its slot, and its slot; None where nothing is
            put in loops.
        scalars: Arrays that are no arrays: their only cell has their name.
    """

    read: Callable[[Node], str]
    array: Callable[[Any], tuple[str, int]]
    slot: Callable[[Node], tuple[str, int]] | None = None
    scalars: frozenset[str] = frozenset()

    def place(self, array: str, slot: int) -> str:
        """Text of a cell."""
        return array if array in self.scalars else f"{array}[{slot}]"

    def holds(self, store: Store, node: Node) -> bool:
        """Whether a node is what the cell of a store held before."""
        return node.op == "in" and self.read(node) == self.place(store.array, store.slot)


class Put(NamedTuple):
    """A value that goes to the cell ``slot + index`` of an array, only ``where``."""

    array: str
    slot: int
    index: Node
    value: Node
    where: Node | None

    @property
    def needs(self) -> list[Node]:
        """The nodes that it reads."""
        return [self.index, self.value, *([self.where] if self.where is not None else [])]

    @property
    def slots(self) -> range:
        """All cells that it may mean."""
        return range(self.slot + int(self.index.low), self.slot + int(self.index.high) + 1)


def changed(stores: Sequence[Store], cells: Cells) -> list[Store]:
    """Without stores of what a cell held already."""
    return [s for s in stores if s.add or not cells.holds(s, s.node)]


def indexed(
    stores: Sequence[Store], cells: Cells, kinds: str = "f"
) -> tuple[list[Put], list[Store]]:
    """The stores that are together one update at an index, and the rest.

    Cell k gets ``index == k ? value : what it held``, for every k that the index can mean. kinds:
    of the numbers that can be stored so.
    """
    groups: dict[Any, list[tuple[int, Store]]] = {}
    updates: dict[Any, Put] = {}
    rest: list[Store] = []
    for store in changed(stores, cells):
        update = _update(store, cells) if store.node.kind in kinds else None
        if update is None:
            rest.append(store)
            continue
        number, put = update
        key = put.array, put.slot, *(n.id for n in put.needs)
        updates[key] = put
        groups.setdefault(key, []).append((number, store))
    puts = []
    for key, members in groups.items():
        index = updates[key].index
        reach = int(index.high) - int(index.low) + 1
        numbers = {n for n, _ in members}
        if reach <= len(numbers) and numbers >= {*range(int(index.low), int(index.high) + 1)}:
            puts.append(updates[key])
        else:
            rest += [s for _, s in members]
    return puts, rest


def _update(store: Store, cells: Cells) -> tuple[int, Put] | None:
    """k and the whole update, of a store of ``index == k ? value : what the cell held``."""
    node = store.node
    if node.op != "select" or store.add or not cells.holds(store, node.args[2]):
        return None
    condition, value, _ = node.args
    sides = condition.args if condition.op == "and" else (condition,)
    for position, side in enumerate(sides):
        if side.op == "eq" and side.args[1].op == "const" and _bounded(side.args[0]):
            where = sides[1 - position] if len(sides) == 2 else None
            number = side.args[1].value
            return number, Put(store.array, store.slot - number, side.args[0], value, where)
    return None


def _bounded(index: Node) -> bool:
    return index.kind in "iul" and LIMITS["i"][0] < index.low <= index.high < LIMITS["i"][1]


def excluded(store: Store, condition: Node, cells: Cells) -> bool:
    """Whether a store is ``other condition ? value : what the cell held``, with a condition that
    never holds together with this one."""
    node = store.node
    if node.op != "select" or store.add or not cells.holds(store, node.args[2]):
        return False
    known = conjuncts(condition)
    return any(
        (part, not truth) in known or (not truth and conjuncts(part) <= known)
        for part, truth in conjuncts(node.args[0])
    )


def conjuncts(node: Node) -> set[tuple[Node, bool]]:
    """Conditions that that must all have these values for a condition to hold."""
    if node.op == "and":
        return conjuncts(node.args[0]) | conjuncts(node.args[1])
    return {(node.args[0], False)} if node.op == "not" else {(node, True)}


def _freed(store: Store, cells: Cells) -> Store:
    """A store of ``where ? value : what the cell held`` as one of the value, only ``where``."""
    node = store.node
    if node.op == "select" and node.kind == "f" and cells.holds(store, node.args[2]):
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
            places = {(o.array, o.slot) for o in group}
            rest += [s for s in stores if (s.array, s.slot) in places]
    return several, rest


class Rolled(NamedTuple):
    """Stores in a loop. store: that of the first round; step: of its slot to the next round."""

    store: Store
    step: int
    roll: Roll

    @property
    def slots(self) -> list[int]:
        """All cells that it sets."""
        first, step = self.store.slot, self.step
        return [first + k * step for k in range(len(self.roll.members))]


def rolled(
    stores: Sequence[Store], puts: Sequence[Put], search: LoopSearch, cells: Cells
) -> tuple[list[Rolled], list[Store]]:
    """The stores that are made in loops, and the rest.

    Loops store while they read: none may read what another store, an update at an index among
    them, or another round sets.
    """
    freed, groups = list(stores), _neighbours(stores)
    if search.alike is not None:
        freed = [_freed(s, cells) for s in stores]
        keys = [(s.array, s.add, s.where and s.where.id) for s in freed]
        groups = groups_of_alike([s.node for s in freed], keys, search.alike)
    written = {(p.array, slot): -1 for p in puts for slot in p.slots}
    written |= {(s.array, s.slot): i for i, s in enumerate(stores)}
    loops, used = [], set[int]()
    for roll in rolls([s.node for s in freed], groups, search):
        slots = [freed[m].slot for m in roll.members]
        loop = Rolled(freed[roll.members[0]], slots[1] - slots[0], roll)
        if slots == loop.slots and all(_alone(row, roll, written) for row in roll.rows.values()):
            loops.append(loop)
            used.update(roll.members)
    return loops, [s for i, s in enumerate(stores) if i not in used]


def _neighbours(stores: Sequence[Store]) -> list[list[int]]:
    """Places of stores to cells in a row of one array."""
    groups: list[list[int]] = []
    for number, store in enumerate(stores):
        last = stores[number - 1] if number else None
        if last is not None and (last.array, last.slot + 1) == (store.array, store.slot):
            groups[-1].append(number)
        else:
            groups.append([number])
    return groups


def _alone(row: Row, roll: Roll, written: dict[tuple[str, int], int]) -> bool:
    """Whether each round may read its cell: nobody sets it, or that round itself."""
    array = row.text.partition("[")[0]
    places = [written.get((array, row.start + i * row.step)) for i in range(len(roll.members))]
    return all(p is None or p == m for p, m in zip(places, roll.members, strict=True))


class Plan(NamedTuple):
    """What a back end writes. loops: over cells; puts: updates at an index; plain: the rest."""

    loops: list[Rolled]
    puts: list[Put]
    plain: list[Store]


def plan(
    stores: Sequence[Store], cells: Cells, search: LoopSearch | None, kinds: str = "f"
) -> Plan:
    """The forms of stores.

    Args:
        stores: What becomes of the results.
        cells: Where inputs stand.
        search: What becomes a loop; None for nothing.
        kinds: Kinds of numbers that can be stored at an index.
    """
    puts, rest = indexed(stores, cells, kinds)
    loops, plain = rolled(rest, puts, search, cells) if search is not None else ([], rest)
    return Plan(loops, puts, plain)
