"""A scalar graph as C99 statements.

A node that is used more than once gets a local constant, any other stands in the expression that
uses it; a maximum inside a minimum is one call. A store is issued as soon as nothing still reads
what it overwrites, so that few locals live at a time. Elements that an index selects for the same
value are one indexed store; elements in a row that are copied, or set to one constant, are a loop.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from jaxstage.engine.c_text import (
    ADD,
    ATOM,
    TYPES,
    Text,
    bracketed,
    clamped,
    constant,
    kind_of,
    operation,
)
from jaxstage.engine.graph import Node
from jaxstage.engine.scalar import ordered

#: longest expression; parts of a longer one get names of their own
LONGEST = 80

#: as many elements in a row that are copied, or set to one constant, become a loop
LOOPED = 5


class Places(NamedTuple):
    """The C text of inputs. element(leaf, index): one number; array(leaf): what can be indexed."""

    element: Callable[[int, int], str]
    array: Callable[[int], str]


class Result(NamedTuple):
    """A node and its place: the element ``number`` of an array, or a scalar where that is None.

    old: leaf and number of the input that stands there, or None."""

    array: str
    number: int | None
    node: Node
    old: tuple[int, int] | None = None

    @property
    def place(self) -> str:
        """The left side of an assignment."""
        return self.array if self.number is None else f"{self.array}[{self.number}]"


class Statements(NamedTuple):
    """The lines of a function, and the small functions that they call, by name."""

    lines: tuple[str, ...]
    helpers: dict[str, str]


class _Store(NamedTuple):
    """place: left side; touches: all that may be overwritten. With an index, the place is an array,
    of which ``offset + index`` is meant. With a count, so many elements from ``offset`` on, which
    get those of an input from the node's on, or its constant."""

    place: str
    node: Node
    touches: frozenset[str]
    offset: int = 0
    index: Node | None = None
    count: int = 0


class _Writing(NamedTuple):
    """What is known while the lines are written. uses: of each node; texts: of the nodes so far;
    born: the number of local constants that each text needs; named: the lines of these, and what
    each reads."""

    places: Places
    single: bool
    uses: Counter[int]
    texts: dict[int, Text]
    born: dict[int, int]
    named: list[tuple[str, frozenset[str]]]
    helpers: dict[str, str]


def statements(results: Sequence[Result], places: Places, single: bool) -> Statements:
    """All results as statements. Raises ValueError for an operation that C99 does not have."""
    stores = _stores(results, places)
    roots = [s.node for s in stores] + [s.index for s in stores if s.index is not None]
    uses = Counter(arg.id for node in ordered(roots) for arg in node.args)
    uses.update(node.id for node in roots)
    writing = _Writing(places, single, uses, {}, {}, [], {})
    overwritten = frozenset[str]().union(*(s.touches for s in stores))
    lines = [_stored(writing, store, overwritten) for store in stores]
    return Statements(tuple(_scheduled(writing.named, lines)), writing.helpers)


def _stored(
    writing: _Writing, store: _Store, overwritten: frozenset[str]
) -> tuple[int, frozenset[str], str]:
    """The line of a store, and after how many local constants it may stand."""
    place, text = store.place, _text(writing, store.node)
    if store.count:
        return 0, store.touches, _loop(writing, store, text)
    if text.reads & (overwritten - store.touches):
        text = _name(writing, store.node)
    born = writing.born[store.node.id]
    if store.index is not None:
        index = _text(writing, store.index)
        index = _name(writing, store.index) if index.reads & overwritten else index
        place = f"{place}[{_shifted(store.offset, index)}]"
        born = max(born, writing.born[store.index.id])
    return born, store.touches, _assigned(place, text.text)


def _loop(writing: _Writing, store: _Store, text: Text) -> str:
    """The loop for elements that are copied or constant."""
    value = text.text
    if store.node.op == "in":
        leaf, first = store.node.value
        value = f"{writing.places.array(leaf)}[{_shifted(first - store.offset, Text('i'))}]"
    start = store.offset
    head = f"    for (int32_t i = {start}; i < {start + store.count}; i++)"
    return f"{head}\n        {store.place}[i] = {value};"


def _stores(results: Sequence[Result], places: Places) -> list[_Store]:
    """What has to be written, the elements of an indexed store together."""
    groups: dict[tuple[int, int, int, int], list[int]] = {}
    for result in results:
        key = _selected(result)
        if key is not None:
            groups.setdefault(key[0], []).append(key[1])
    results, stores = _without_runs(results, places)
    done = set()
    for result in results:
        node = result.node
        if node.op == "in" and node.value == result.old:
            continue
        key = _selected(result)
        if key is None or not _covered(groups[key[0]], node.args[0].args[0]):
            stores.append(_Store(result.place, node, frozenset({result.place})))
        elif key[0] not in done:
            done.add(key[0])
            leaf, offset = key[0][:2]
            index, value = node.args[0].args[0], node.args[1]
            touches = frozenset(places.element(leaf, offset + k) for k in groups[key[0]])
            stores.append(_Store(places.array(leaf), value, touches, offset, index))
    return stores


def _without_runs(results: Sequence[Result], places: Places) -> tuple[list[Result], list[_Store]]:
    """The results that stand alone, and the loops for those in a row.

    What is copied must be written nowhere."""
    written = {result.place for result in results}
    runs: list[list[Result]] = []
    for result in results:
        node = result.node
        simple = node.op == "const" or (
            node.op == "in" and places.element(*node.value) not in written
        )
        if simple and runs and _goes_on(runs[-1][-1], result):
            runs[-1].append(result)
        else:
            runs.append([result])
    loops = [
        _Store(
            place=run[0].array, node=run[0].node, touches=frozenset(r.place for r in run),
            offset=run[0].number or 0, count=len(run),
        )
        for run in runs if len(run) >= LOOPED
    ]  # fmt: skip
    return [result for run in runs if len(run) < LOOPED for result in run], loops


def _goes_on(last: Result, result: Result) -> bool:
    """Whether a result goes on with the copy or the constant of the one before."""
    old, new = last.node, result.node
    if result.array != last.array or result.number is None or old.op != new.op:
        return False
    if old.op == "const":
        return old is new
    return old.op == "in" and new.value == (old.value[0], old.value[1] + 1)


def _selected(result: Result) -> tuple[tuple[int, int, int, int], int] | None:
    """For an element that is ``index == k ? value : old``: (leaf, number - k, index, value), k."""
    node = result.node
    if result.old is None or node.op != "select":
        return None
    test, value, old = node.args
    if old.op != "in" or old.value != result.old or test.op != "eq":
        return None
    index, k = test.args
    if k.op != "const" or index.kind not in "iul":
        return None
    leaf, number = result.old
    return (leaf, number - k.value, index.id, value.id), k.value


def _reach(index: Node) -> range:
    """All that an index can be."""
    return range(int(index.low), int(index.high) + 1)


def _covered(numbers: list[int], index: Node) -> bool:
    reach = _reach(index)
    return len(reach) <= len(numbers) and set(numbers) >= set(reach)


def _text(writing: _Writing, root: Node) -> Text:
    """The expression of a node; what it needs is written first."""
    for node in ordered([root]):
        if node.id not in writing.texts:
            _write(writing, node)
    return writing.texts[root.id]


def _write(writing: _Writing, node: Node) -> None:
    texts = writing.texts
    writing.born[node.id] = len(writing.named)
    if node.op == "const":
        texts[node.id] = constant(node, writing.single)
    elif node.op == "in":
        place = writing.places.element(*node.value)
        texts[node.id] = Text(place, ATOM, frozenset({place}))
    else:
        parts = sorted(_operands(writing, node), key=lambda arg: -len(texts[arg.id].text))
        text = _expression(writing, node)
        for part in parts:
            inside = texts[part.id].text
            if len(text.text) > LONGEST and ("(" in inside or " " in inside):
                _name(writing, part)
                text = _expression(writing, node)
        texts[node.id] = text
        writing.born[node.id] = len(writing.named)
        if writing.uses[node.id] > 1:
            _name(writing, node)


def _clamp(writing: _Writing, node: Node) -> tuple[Node, Node, Node] | None:
    """(low, a, high) of a minimum that is min(high, max(low, a)), where the maximum is its own."""
    if node.op == "min" and node.kind == "f":
        for inner, high in (node.args, node.args[::-1]):
            if inner.op == "max" and writing.uses[inner.id] == 1:
                return inner.args[0], inner.args[1], high
    return None


def _operands(writing: _Writing, node: Node) -> tuple[Node, ...]:
    """What an expression is made of."""
    return _clamp(writing, node) or node.args


def _expression(writing: _Writing, node: Node) -> Text:
    args = [writing.texts[arg.id] for arg in _operands(writing, node)]
    if _clamp(writing, node):
        return clamped(node, args, writing.single, writing.helpers)
    if node.op != "load":
        return operation(node, args, writing.single, writing.helpers)
    (leaf, offset), index, places = node.value, node.args[0], writing.places
    reads = {places.element(leaf, offset + k) for k in _reach(index)}
    place = f"{places.array(leaf)}[{_shifted(offset, args[0])}]"
    return Text(place, ATOM, args[0].reads | reads)


def _shifted(offset: int, index: Text) -> str:
    if not offset:
        return index.text
    inside = bracketed(index, ADD)
    return f"{offset} + {inside}" if offset > 0 else f"{inside} - {-offset}"


def _name(writing: _Writing, node: Node) -> Text:
    """Give a node a local constant."""
    text = writing.texts[node.id]
    letter = {"f": "x", "b": "is"}.get(node.kind, "n")
    local = f"{letter}{len(writing.named)}"
    line = _assigned(f"const {TYPES[kind_of(node)]} {local}", text.text)
    writing.named.append((line, text.reads))
    writing.texts[node.id] = Text(local)
    writing.born[node.id] = len(writing.named)
    return writing.texts[node.id]


def _scheduled(
    named: Sequence[tuple[str, frozenset[str]]],
    stores: Sequence[tuple[int, frozenset[str], str]],
) -> Iterable[str]:
    """Local constants in order, each store as early as its value and its place allow."""
    last_read = {place: i + 1 for i, (_, reads) in enumerate(named) for place in reads}
    ready: dict[int, list[str]] = {}
    for born, touches, line in stores:
        when = max(born, *(last_read.get(place, 0) for place in touches))
        ready.setdefault(when, []).append(line)
    for position in range(len(named) + 1):
        yield from ready.get(position, ())
        if position < len(named):
            yield named[position][0]


def _assigned(left: str, right: str) -> str:
    line = f"    {left} = {right};"
    return line if len(line) <= 100 else f"    {left} =\n        {right};"
