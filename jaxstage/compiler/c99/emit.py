"""A scalar graph as C99 statements.

A node that is used more than once gets a local constant, any other stands in the expression that
uses it; a maximum inside a minimum is one call. A store is issued as soon as nothing still reads
what it overwrites, so that few locals live at a time. Updates at an index are one indexed store;
elements of an array, or terms of a sum, that have one form are a loop.
"""

import dataclasses
import textwrap
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from jaxstage.compiler.c99.ops import (
    ADD,
    ATOM,
    MUL,
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
from jaxstage.compiler.ir.node import Node, ordered
from jaxstage.compiler.passes.loop_reroll import LoopSearch, Roll, Row, gathered
from jaxstage.compiler.passes.store_forms import Cells, Plan, Put, Rolled, Store, changed, plan

#: longest expression; parts of a longer one get names of their own
LONGEST = 80
#: fewer rounds are no loop
ROUNDS = 8


class Statements(NamedTuple):
    """The lines of a function, and the small functions that they call, by name."""

    lines: tuple[str, ...]
    helpers: dict[str, str]


class _Line(NamedTuple):
    """A store. born: local constants that it needs; touches: cells that it may overwrite."""

    born: int
    touches: frozenset[str]
    text: str


@dataclasses.dataclass
class _Function:
    """What is known while the lines of a function, or of a loop in it, are written.

    Attributes:
        cells: Where inputs stand.
        single: Whether reals are floats.
        overwritten: Cells that some store sets.
        uses: How often each node stands in the text.
        sums: Sums that are loops, by their number.
        texts: Text of the nodes that are written, by number.
        born: How many local constants each text needs.
        named: The lines of local constants, and the cells that each reads.
        arrays: Names of local arrays, by the numbers of their nodes.
        helpers: Small functions that are called, by name.
        mark: Part of the names of local constants.
    """

    cells: Cells
    single: bool
    overwritten: frozenset[str]
    uses: Counter[int]
    sums: dict[int, Roll]
    helpers: dict[str, str]
    texts: dict[int, Text] = dataclasses.field(default_factory=dict)
    born: dict[int, int] = dataclasses.field(default_factory=dict)
    named: list[tuple[str, frozenset[str]]] = dataclasses.field(default_factory=list)
    arrays: dict[tuple[int, ...], str] = dataclasses.field(default_factory=dict)
    mark: str = ""

    def needs(self, node: Node) -> Sequence[Node]:
        """What a node that is written needs before it: of a sum that is a loop, what that needs."""
        return self.sums[node.id].needs if node.id in self.sums else node.args

    def places(self, array: str, slots: Iterable[int]) -> frozenset[str]:
        """Texts of cells."""
        return frozenset(self.cells.place(array, slot) for slot in slots)


def statements(stores: Sequence[Store], cells: Cells, single: bool) -> Statements:
    """All results as statements.

    Args:
        stores: Where each result goes.
        cells: Where inputs stand.
        single: Whether reals are floats.

    Raises:
        LoweringError: C99 does not have an operation.
    """
    assert cells.slot is not None, "controllers have loops"
    stores = changed(stores, cells)
    nodes = ordered(store.node for store in stores)
    uses = Counter(arg.id for node in nodes for arg in node.args)
    uses.update(store.node.id for store in stores)
    search = LoopSearch(ROUNDS, cells.slot, uses=uses)
    forms = plan(stores, cells, search, kinds="fiulb")
    sums = {number: loops[0] for number, (_, loops) in gathered(nodes, search).items()}
    everything = frozenset(cells.place(s.array, s.slot) for s in stores)
    function = _Function(cells, single, everything, Counter(), sums, {})
    function.uses = _times_written(function, forms)
    order = {(s.array, s.slot): position for position, s in enumerate(stores)}
    lines: list[tuple[int, _Line]] = []
    by_position = [(min(order[p.array, s] for s in p.slots), p) for p in forms.puts]
    by_position += [(order[x.store.array, x.store.slot], x) for x in forms.loops]
    by_position += [(order[s.array, s.slot], s) for s in forms.plain]
    for position, form in sorted(by_position, key=lambda pair: pair[0]):
        lines.append((position, _stored(function, form)))
    scheduled = _scheduled(function.named, [line for _, line in lines])
    return Statements(tuple(scheduled), function.helpers)


def _times_written(function: _Function, forms: Plan) -> Counter[int]:
    """How often each node stands in the text: one that all rounds of a loop share counts twice, so
    that it gets a name; one that a local array holds counts once for the array."""
    loops = [x.roll for x in forms.loops]
    alone = [node for store in (*forms.puts, *forms.plain) for node in store.needs]
    roots = [*alone, *(node for loop in loops for node in loop.needs)]
    seen = ordered(roots, function.needs)
    loops += [function.sums[node.id] for node in seen if node.id in function.sums]
    arrays = {nodes for loop in loops for nodes in loop.others.values()}
    times = Counter(node.id for node in alone)
    times.update(arg.id for node in seen if node.id not in function.sums for arg in node.args)
    times.update(2 * [node.id for loop in loops for node in loop.same])
    times.update(node.id for nodes in arrays for node in nodes)
    return times


# --- stores --------------------------------------------------------------------------------------


def _stored(function: _Function, form: Put | Rolled | Store) -> _Line:
    """The line of a store."""
    if isinstance(form, Rolled):
        store = form.store
        place = f"{store.array}[{_of_round(Row('', store.slot, form.step))}]"
        text = _loop(function, form.roll, place, "=")
        return _Line(len(function.named), function.places(store.array, form.slots), text)
    if isinstance(form, Put):
        return _put(function, form)
    touches = function.places(form.array, [form.slot])
    text = _value(function, form.node, touches)
    place = function.cells.place(form.array, form.slot)
    return _Line(function.born[form.node.id], touches, _assigned(place, text.text))


def _put(function: _Function, put: Put) -> _Line:
    touches = function.places(put.array, put.slots)
    value = _value(function, put.value, touches)
    index = _known(function, put.index)
    place = f"{put.array}[{_shifted(put.slot, index)}]"
    line = _assigned(place, value.text)
    if put.where is not None:
        line = f"    if ({_known(function, put.where).text})\n    {line}".replace("\n", "\n    ")
    return _Line(max(function.born[node.id] for node in put.needs), touches, line)


def _value(function: _Function, node: Node, touches: frozenset[str]) -> Text:
    """The expression of what is stored; it may read what the store itself overwrites."""
    text = _text(function, node)
    return _name(function, node) if text.reads & (function.overwritten - touches) else text


def _known(function: _Function, node: Node) -> Text:
    """An expression that stays what it is when something is stored."""
    text = _text(function, node)
    return _name(function, node) if text.reads & function.overwritten else text


# --- loops ---------------------------------------------------------------------------------------


def _loop(function: _Function, roll: Roll, left: str, sign: str) -> str:
    """The loop in which ``left`` gets the value of a form, or it is added to it."""
    texts = {leaf: Text(f"{_array(function, n)}[i]") for leaf, n in roll.others.items()}
    texts |= {node.id: _known(function, node) for node in roll.same}
    texts |= {leaf: Text(row.text.format(_of_round(row))) for leaf, row in roll.rows.items()}
    uses = Counter(arg.id for node in ordered([roll.form]) for arg in node.args)
    inside = _Function(
        function.cells,
        function.single,
        function.overwritten,
        uses,
        {},
        function.helpers,
        texts,
        mark="i",
    )
    value = _text(inside, roll.form).text
    body = [line for line, _ in inside.named] + [_assigned(left, value, sign)]
    body = ["    " + line.replace("\n", "\n    ") for line in body]
    head = f"    for (int32_t i = 0; i < {len(roll.members)}; i++)"
    return "\n".join([f"{head} {{", *body, "    }"] if len(body) > 1 else [head, *body])


def _of_round(row: Row) -> str:
    """The slot of the cell of round ``i``."""
    if row.step == -1:
        return f"{row.start} - i"
    return _shifted(row.start, Text("i") if row.step == 1 else Text(f"{row.step} * i", MUL))


def _array(function: _Function, nodes: tuple[Node, ...]) -> str:
    """The name of a local array of nodes."""
    key = tuple(node.id for node in nodes)
    if key not in function.arrays:
        texts = [_text(function, node) for node in nodes]
        name = f"a{len(function.named)}"
        kind = TYPES[max((kind_of(node) for node in nodes), key="biulf".index)]
        inner = "\n".join(wrapped([text.text for text in texts], " " * 8))
        line = f"    const {kind} {name}[{len(nodes)}] = {{\n{inner}\n    }};"
        function.named.append((line, frozenset[str]().union(*(text.reads for text in texts))))
        function.arrays[key] = name
    return function.arrays[key]


def _sum(function: _Function, node: Node) -> None:
    """Add up terms of one form in a local variable."""
    roll = function.sums[node.id]
    reads = {row.cell(k) for row in roll.rows.values() for k in range(len(roll.members))}
    local = f"sum{list(function.sums).index(node.id)}"
    loop = _loop(function, roll, local, "+=")
    line = f"    real {local} = {number(0.0, 'f', function.single)};\n{loop}"
    function.named.append((line, frozenset(reads)))
    function.texts[node.id] = Text(local)
    function.born[node.id] = len(function.named)


# --- expressions ---------------------------------------------------------------------------------


def _text(function: _Function, root: Node) -> Text:
    """The expression of a node; what it needs is written first."""
    if root.id not in function.texts:
        for node in ordered([root], function.needs, function.texts):
            _write(function, node)
    return function.texts[root.id]


def _write(function: _Function, node: Node) -> None:
    texts = function.texts
    function.born[node.id] = len(function.named)
    if node.op == "const":
        texts[node.id] = constant(node, function.single)
    elif node.op == "in":
        place = function.cells.read(node)
        texts[node.id] = Text(place, ATOM, frozenset({place}))
    elif node.id in function.sums:
        _sum(function, node)
    else:
        operands = sorted(_operands(function, node), key=lambda arg: -len(texts[arg.id].text))
        text = _expression(function, node)
        for operand in operands:
            inside = texts[operand.id].text
            if len(text.text) > LONGEST and ("(" in inside or " " in inside):
                _name(function, operand)
                text = _expression(function, node)
        texts[node.id] = text
        function.born[node.id] = len(function.named)
        if function.uses[node.id] > 1:
            _name(function, node)


def _clamp(function: _Function, node: Node) -> tuple[Node, Node, Node] | None:
    """(low, a, high) of a minimum that is min(high, max(low, a)), where the maximum is its own."""
    if node.op == "min" and node.kind == "f":
        for inner, high in (node.args, node.args[::-1]):
            if inner.op == "max" and function.uses[inner.id] == 1:
                return inner.args[0], inner.args[1], high
    return None


def _operands(function: _Function, node: Node) -> tuple[Node, ...]:
    """What an expression is made of."""
    return _clamp(function, node) or node.args


def _expression(function: _Function, node: Node) -> Text:
    args = [function.texts[arg.id] for arg in _operands(function, node)]
    if _clamp(function, node):
        return clamped(node, args, function.single, function.helpers)
    if node.op != "load":
        return operation(node, args, function.single, function.helpers)
    source, offset = node.value
    array, first = function.cells.array(source)
    reach = range(int(node.args[0].low), int(node.args[0].high) + 1)
    reads = function.places(array, (first + offset + k for k in reach))
    return Text(f"{array}[{_shifted(first + offset, args[0])}]", ATOM, args[0].reads | reads)


def _shifted(offset: int, index: Text) -> str:
    if not offset:
        return index.text
    inside = bracketed(index, ADD)
    return f"{offset} + {inside}" if offset > 0 else f"{inside} - {-offset}"


def _name(function: _Function, node: Node) -> Text:
    """Give a node a local constant."""
    text = function.texts[node.id]
    letter = {"f": "x", "b": "is"}.get(node.kind, "n")
    local = f"{letter}{function.mark}{len(function.named)}"
    line = _assigned(f"const {TYPES[kind_of(node)]} {local}", text.text)
    function.named.append((line, text.reads))
    function.texts[node.id] = Text(local)
    function.born[node.id] = len(function.named)
    return function.texts[node.id]


# --- lines ---------------------------------------------------------------------------------------


def _scheduled(
    named: Sequence[tuple[str, frozenset[str]]], stores: Sequence[_Line]
) -> Iterable[str]:
    """Local constants in order, each store as early as its value and its place allow."""
    last_read = {place: i + 1 for i, (_, reads) in enumerate(named) for place in reads}
    ready: dict[int, list[str]] = {}
    for store in stores:
        when = max(store.born, *(last_read.get(place, 0) for place in store.touches))
        ready.setdefault(when, []).append(store.text)
    for position in range(len(named) + 1):
        yield from ready.get(position, ())
        if position < len(named):
            yield named[position][0]


def _assigned(left: str, right: str, sign: str = "=") -> str:
    """An assignment, in two lines and more where it is long."""
    line = f"    {left} {sign} {right};"
    if len(line) <= 100:
        return line
    inner = textwrap.fill(
        f"{right};",
        98,
        initial_indent=" " * 8,
        subsequent_indent=" " * 12,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return f"    {left} {sign}\n{inner}"
