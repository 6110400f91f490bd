"""A graph as C++ statements on vectors of runs."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from jaxstage.engine.node import LIMITS, Node, ordered
from jaxstage.engine.spelling import constant, expression

TYPES = {"f": "vec", "i": "ints", "u": "ints", "l": "ints", "b": "mask"}


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
    a load reads, with the slot of its element 0."""

    read: Callable[[Node], str]
    array: Callable[[Any], tuple[str, int]]


class Known(NamedTuple):
    """Names of nodes that need no computing, and of the reciprocals that some divisions use."""

    names: dict[int, str]
    reciprocals: dict[int, str]


def write(
    stores: Iterable[Store], cells: Cells, known: Known, single: bool, prefix: str = "t"
) -> list[str]:
    """The statements that compute and store."""
    stores = list(stores)
    puts, plain = indexed(stores, cells)
    guarded, plain = _guarded(plain, cells)
    roots = [n for s in plain for n in s.needs] + [n for p in puts for n in p.needs]
    roots += [n for own in guarded for s in own for n in s.needs]
    names = dict(known.names)

    def reads(node: Node) -> Iterable[Node]:
        return node.args[:1] if node.id in known.reciprocals else node.args

    nodes = ordered(roots, reads, known.names)
    loads: dict[int, list[Node]] = {}
    for node in nodes:
        if node.op == "load":
            loads.setdefault(node.args[0].id, []).append(node)
    lines: list[str] = []
    places: set[int] = set()

    def name(node: Node) -> str:
        return constant(node) if node.op == "const" else names[node.id]

    def at(index: Node) -> str:
        if index.op == "const":
            return ""
        if index.id not in places:
            places.add(index.id)
            lines.append(f"const Place at{prefix}{index.id} = place({name(index)});")
        return f"at{prefix}{index.id}"

    for node in nodes:
        if node.op == "const" or node.id in names:
            continue
        same_index = loads[node.args[0].id] if node.op == "load" else [node]
        for own in same_index:
            names[own.id] = f"{prefix}{own.id}"
            if own.op == "loop":
                lines += loop_lines(own, nodes, names, cells, known, single, prefix)
                continue
            if own.op == "after":
                text = _after(own, prefix)
            elif own.op == "in":
                text = cells.read(own)
            elif own.op == "load":
                text = _load(own, cells, at(own.args[0]))
            elif own.id in known.reciprocals:
                text = f"{name(own.args[0])} * {known.reciprocals[own.id]}"
            else:
                text = expression(own, [name(a) for a in own.args], single)
            lines.append(f"const {TYPES[own.kind]} {names[own.id]} = {text};")
    placed = [(p, at(p.index)) for p in puts]
    for own in guarded:
        where = own[0].where
        never = [s for s in plain if _excluded(s, own[0].where, cells)]
        plain = [s for s in plain if s not in never]
        lines += _guarded_stores(own, [p for p in placed if p[0].where is where], never, name)
        placed = [p for p in placed if p[0].where is not where]
    for put, place in placed:
        where = "every(true)" if put.where is None else name(put.where)
        lines.append(f"put({put.array}+{put.slot}, {place}, {where}, {name(put.value)});")
    lines += [_stored(s, name(s.node)) for s in plain]
    return lines


def _array_of(node: Node, name: str, prefix: str, number: int) -> str:
    return f"{prefix}{name}{'i' if node.kind != 'f' else ''}{number}"


def _after(node: Node, prefix: str) -> str:
    name, *at = node.value
    array = _array_of(node, name, prefix, node.args[0].value.number)
    text = array + "".join(f"[{i}]" for i in at)
    return f"as_mask({text})" if node.kind == "b" else text


def _truth(node: Node, text: str) -> str:
    return f"as_ints({text})" if node.kind == "b" else text


def loop_lines(
    loop: Node, nodes: list[Node], names: dict[int, str], cells: Cells, known: Known, single: bool,
    prefix: str,
) -> list[str]:  # fmt: skip
    """A loop inside a tick: its arrays, and one round of it in a C loop."""
    inner, number = loop.value, loop.value.number
    used = sorted(_rows_used(loop, nodes))
    lines = [
        f"{kind} {prefix}c{i}{number}[{len(inner.begin)}], {prefix}y{i}{number}[{inner.length}]"
        f"[{len(inner.rows)}], {prefix}x{i}{number}[{inner.length}][{len(inner.given)}];"
        for kind, i in (("vec", ""), ("ints", "i"))
    ]

    def name(node: Node) -> str:
        return constant(node) if node.op == "const" else names[node.id]

    for at, node in enumerate(inner.begin):
        lines.append(f"{_array_of(node, 'c', prefix, number)}[{at}] = {_truth(node, name(node))};")
    for at, source in enumerate(inner.given):
        for t, node in enumerate(source[1] if source[0] == "own" else ()):
            array = _array_of(node, "x", prefix, number)
            lines.append(f"{array}[{t}][{at}] = {_truth(node, name(node))};")
    k = f"k{number}"
    steps = (f"int {k} = {inner.length - 1}; {k} >= 0; {k}--" if inner.reverse
             else f"int {k} = 0; {k} < {inner.length}; {k}++")  # fmt: skip

    def read(node: Node) -> str:
        (group, own), at = node.value
        if group not in ("L", "X") or own != number:
            return cells.read(node)
        if group == "L":
            text = f"{_array_of(node, 'c', prefix, number)}[{at}]"
        elif inner.given[at][0] == "count":
            _, first, step = inner.given[at]
            text = f"same((whole)({first} + {step} * {k}))"
        elif inner.given[at][0] == "rows":
            _, before, cell = inner.given[at]
            text = f"{_array_of(node, 'y', prefix, before.value.number)}[{k}][{cell}]"
        else:
            text = f"{_array_of(node, 'x', prefix, number)}[{k}][{at}]"
        return f"as_mask({text})" if node.kind == "b" else text

    stores = [
        Store(_array_of(node, "c", prefix, number), at, node)
        for at, node in enumerate(inner.inside)
    ]
    stores += [
        Store(f"{_array_of(inner.rows[at], 'y', prefix, number)}[{k}]", at, inner.rows[at])
        for at in used
    ]
    round_of = write(
        stores, Cells(read, cells.array), Known(dict(names), known.reciprocals), single, prefix
    )
    return [*lines, f"for ({steps}) {{", *round_of, "}"]


def _rows_used(loop: Node, nodes: list[Node]) -> set[int]:
    """The cells of the rows that somebody reads."""
    found = set()
    for node in nodes:
        if node.op == "after" and node.args[0] is loop and node.value[0] == "y":
            found.add(node.value[2])
        if node.op == "loop":
            found |= {s[2] for s in node.value.given if s[0] == "rows" and s[1] is loop}
    return found


def _guarded_stores(
    stores: list[Store], puts: list["tuple[Put, str]"], never: list[Store],
    name: Callable[[Node], str],
) -> list[str]:  # fmt: skip
    """Where the condition holds in every lane, as nearly always, there is nothing to select.

    never: stores that change nothing where it holds.
    """
    where = name(stores[0].where)  # type: ignore[arg-type]
    free = [f"{s.array}[{s.slot}] = {name(s.node)};" for s in stores]
    free += [f"put({p.array}+{p.slot}, {at}, every(true), {name(p.value)});" for p, at in puts]
    held = [
        f"{s.array}[{s.slot}] = pick({where}, {name(s.node)}, {s.array}[{s.slot}]);" for s in stores
    ]
    held += [f"put({p.array}+{p.slot}, {at}, {where}, {name(p.value)});" for p, at in puts]
    held += [_stored(s, name(s.node)) for s in never]
    return [f"if (__builtin_expect(everywhere({where}), 1)) {{", *free, "} else {", *held, "}"]


def _excluded(store: Store, condition: Node | None, cells: Cells) -> bool:
    """Whether a store is ``other condition ? value : what the cell held``, with a condition that
    never holds together with this one."""
    node = store.node
    if node.op != "select" or store.add or not _holds(store, node.args[2], cells):
        return False
    given = _conjuncts(condition) if condition is not None else set()
    return any(
        (part, not truth) in given or (not truth and _conjuncts(part) <= given)
        for part, truth in _conjuncts(node.args[0])
    )


def _conjuncts(node: Node) -> set[tuple[Node, bool]]:
    """Conditions that must all be as given for a condition to hold."""
    if node.op == "and":
        return _conjuncts(node.args[0]) | _conjuncts(node.args[1])
    return {(node.args[0], False)} if node.op == "not" else {(node, True)}


def _guarded(stores: list[Store], cells: Cells) -> tuple[list[list[Store]], list[Store]]:
    """Stores of ``where ? value : what the cell held`` under one condition, and the rest."""
    groups: dict[int, list[Store]] = {}
    rest = []
    for store in stores:
        node = store.node
        if node.op == "select" and node.kind == "f" and _holds(store, node.args[2], cells):
            own = store._replace(node=node.args[1], where=node.args[0])
            groups.setdefault(node.args[0].id, []).append(own)
        else:
            rest.append(store)
    several = [g for g in groups.values() if len(g) > 2]
    for group in groups.values():
        if len(group) <= 2:
            rest += [
                s for s in stores if any(s.array == o.array and s.slot == o.slot for o in group)
            ]
    return several, rest


def _load(node: Node, cells: Cells, place: str) -> str:
    source, offset = node.value
    array, slot = cells.array(source)
    text = f"{array}+{slot + offset}"
    if not place:
        return f"look({text}, place(same({node.args[0].value})))"
    found = f"look({text}, {place})"
    return f"as_mask({found})" if node.kind == "b" else found


def _stored(store: Store, text: str) -> str:
    if store.node.kind == "b":
        text = f"as_ints({text})"
    if store.array.startswith("*"):  # a row of the output
        kind = "store_ints" if store.node.kind != "f" else "store"
        return f"{kind}({store.array[1:]}+{store.slot}*NB, {text});"
    return f"{store.array}[{store.slot}] {'+=' if store.add else '='} {text};"


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
