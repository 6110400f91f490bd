"""A scalar graph as C99 statements.

A node that is used more than once gets a local constant, any other stands in the expression that
uses it; a maximum inside a minimum is one call. A store is issued as soon as nothing still reads
what it overwrites, so that few locals live at a time. Elements that an index selects for the same
value are one indexed store; elements of an array, or terms of a sum, that have one form are a loop.
"""

import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from jaxstage.compiler.c99.ops import (
    ADD,
    ATOM,
    TYPES,
    Text,
    bracketed,
    clamped,
    constant,
    kind_of,
    number,
    operation,
    wrapped,
)
from jaxstage.compiler.c99.patterns import OTHERS, Pattern, sums
from jaxstage.compiler.c99.stores import Places, Result, Store, reach, stores_of
from jaxstage.compiler.ir.node import Node, ordered

#: longest expression; parts of a longer one get names of their own
LONGEST = 80


class Statements(NamedTuple):
    """The lines of a function, and the small functions that they call, by name."""

    lines: tuple[str, ...]
    helpers: dict[str, str]


class _Writing(NamedTuple):
    """What is known while the lines are written. uses: of each node; sums: those that are loops;
    texts: of the nodes so far; born: the number of local constants that each text needs; named: the
    lines of these, and what each reads; arrays: names of local arrays; mark: part of a local name.
    """

    places: Places
    single: bool
    overwritten: frozenset[str]
    uses: Counter[int]
    sums: dict[int, Pattern]
    texts: dict[int, Text]
    born: dict[int, int]
    named: list[tuple[str, frozenset[str]]]
    arrays: dict[tuple[int, ...], str]
    helpers: dict[str, str]
    mark: str = ""


def statements(results: Sequence[Result], places: Places, single: bool) -> Statements:
    """All results as statements. Raises ValueError for an operation that C99 does not have."""
    results = [r for r in results if r.node.op != "in" or r.node.value != r.old]
    nodes = ordered(result.node for result in results)
    uses = Counter(arg.id for node in nodes for arg in node.args)
    uses.update(result.node.id for result in results)
    stores = stores_of(results, places, uses)
    overwritten = frozenset[str]().union(*(store.touches for store in stores))
    summed = sums(nodes, uses)
    written = _times_written(stores, summed)
    writing = _Writing(places, single, overwritten, written, summed, {}, {}, [], {}, {})
    lines = [_stored(writing, store) for store in stores]
    return Statements(tuple(_scheduled(writing.named, lines)), writing.helpers)


def _times_written(stores: Sequence[Store], summed: dict[int, Pattern]) -> Counter[int]:
    """How often each node stands in the text: one that all rounds of a loop share counts twice, so
    that it gets a name; one that a local array holds counts once for the array."""
    seen = ordered((node for store in stores for node in store.needs), _needs(summed))
    forms = [store.form for store in stores if store.form is not None]
    forms += [summed[node.id] for node in seen if node.id in summed]
    arrays = {nodes for form in forms for nodes in form.others}
    times = Counter(node.id for store in stores if store.form is None for node in store.needs)
    times.update(arg.id for node in seen if node.id not in summed for arg in node.args)
    times.update(2 * [node.id for form in forms for node in form.same])
    times.update(node.id for nodes in arrays for node in nodes)
    return times


def _needs(summed: dict[int, Pattern]) -> Callable[[Node], Iterable[Node]]:
    """What a node that is written down needs: a sum that is a loop, its patterns' nodes."""
    return lambda node: summed[node.id].needs if node.id in summed else node.args


def _stored(writing: _Writing, store: Store) -> tuple[int, frozenset[str], str]:
    """The line of a store, and after how many local constants it may stand."""
    if store.form is not None:
        place = f"{store.place}[{_shifted(store.offset, Text('i'))}]"
        text = _loop(writing, store.form, place, "=")
        return len(writing.named), store.touches, text
    place, text = store.place, _text(writing, store.node)
    if text.reads & (writing.overwritten - store.touches):
        text = _name(writing, store.node)
    born = writing.born[store.node.id]
    if store.index is not None:
        index = _known(writing, store.index)
        place = f"{place}[{_shifted(store.offset, index)}]"
        born = max(born, writing.born[store.index.id])
    return born, store.touches, _assigned(place, text.text)


def _known(writing: _Writing, node: Node) -> Text:
    """An expression that stays what it is when something is stored."""
    text = _text(writing, node)
    return _name(writing, node) if text.reads & writing.overwritten else text


def _loop(writing: _Writing, form: Pattern, left: str, sign: str) -> str:
    """The loop in which ``left`` gets the value of a form, or it is added to it."""
    arrays = [_array(writing, nodes) for nodes in form.others]
    same = {node.id: _known(writing, node) for node in form.same}

    def element(leaf: int, index: int) -> str:
        if leaf == OTHERS:
            return f"{arrays[index]}[i]"
        return f"{writing.places.array(leaf)}[{_shifted(index, Text('i'))}]"

    uses = Counter(arg.id for node in ordered([form.form]) for arg in node.args)
    inside = writing._replace(
        places=Places(element, writing.places.array), uses=uses, sums={}, texts=same, born={},
        named=[], mark="i",
    )  # fmt: skip
    value = _text(inside, form.form).text
    body = [line for line, _ in inside.named] + [_assigned(left, value, sign)]
    body = ["    " + line.replace("\n", "\n    ") for line in body]
    head = f"    for (int32_t i = 0; i < {form.count}; i++)"
    return "\n".join([f"{head} {{", *body, "    }"] if len(body) > 1 else [head, *body])


def _array(writing: _Writing, nodes: tuple[Node, ...]) -> str:
    """The name of a local array of nodes."""
    key = tuple(node.id for node in nodes)
    if key not in writing.arrays:
        texts = [_text(writing, node) for node in nodes]
        name = f"a{len(writing.named)}"
        kind = TYPES[max((kind_of(node) for node in nodes), key="biulf".index)]
        inner = "\n".join(wrapped([text.text for text in texts], " " * 8))
        line = f"    const {kind} {name}[{len(nodes)}] = {{\n{inner}\n    }};"
        writing.named.append((line, frozenset[str]().union(*(text.reads for text in texts))))
        writing.arrays[key] = name
    return writing.arrays[key]


def _text(writing: _Writing, root: Node) -> Text:
    """The expression of a node; what it needs is written first."""
    if root.id not in writing.texts:
        for node in ordered([root], _needs(writing.sums), writing.texts):
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
    elif node.id in writing.sums:
        _sum(writing, node, writing.sums[node.id])
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


def _sum(writing: _Writing, node: Node, form: Pattern) -> None:
    """Add up the terms of one form in a local variable."""
    places = writing.places
    reads = {
        places.element(leaf, first + k) for leaf, first in form.rows for k in range(form.count)
    }
    local = f"sum{list(writing.sums).index(node.id)}"
    loop = _loop(writing, form, local, "+=")
    line = f"    real {local} = {number(0.0, 'f', writing.single)};\n{loop}"
    writing.named.append((line, frozenset(reads)))
    writing.texts[node.id] = Text(local)
    writing.born[node.id] = len(writing.named)


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
    reads = {places.element(leaf, offset + k) for k in reach(index)}
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
    local = f"{letter}{writing.mark}{len(writing.named)}"
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


def _assigned(left: str, right: str, sign: str = "=") -> str:
    line = f"    {left} {sign} {right};"
    if len(line) <= 100:
        return line
    inner = textwrap.fill(
        f"{right};", 98, initial_indent=" " * 8, subsequent_indent=" " * 12,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
    return f"    {left} {sign}\n{inner}"
