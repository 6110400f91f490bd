"""A graph as C++ statements on vectors of runs.

What a vector has for itself is named with `COPY`, which stands for its number among the vectors
that go through time together.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

from jaxstage.compiler.cxx.ops import constant, expression
from jaxstage.compiler.ir.node import Node, ordered
from jaxstage.compiler.passes.loop_reroll import Alike, LoopSearch, Roll, alike_nodes, gathered
from jaxstage.compiler.passes.store_forms import (
    COPY,
    Cells,
    Put,
    Rolled,
    Store,
    excluded,
    guarded,
    plan,
)

#: fewer rounds are no loop
ROUNDS = 16
#: operations of any number of arguments
GATHERED = ("all_finite", "sum")
TYPES = {"f": "vec", "i": "ints", "u": "ints", "l": "ints", "b": "mask"}


class Known(NamedTuple):
    """What needs no computing.

    Attributes:
        names: Texts of nodes by their numbers; of the place that an index means by ``~number``.
        reciprocals: Texts of the reciprocals that some divisions use, by the division's number.
    """

    names: dict[int, str]
    reciprocals: dict[int, str]


class _Kernel(NamedTuple):
    """What the statements of a function have in common.

    Attributes:
        names: C++ text of what is computed.
        alike: What nodes have in common.
        gathered: Number of a sum, or of a claim of many parts -> the loops in it.
    """

    cells: Cells
    known: Known
    single: bool
    prefix: str
    names: dict[int, str]
    alike: Alike
    gathered: dict[int, list[Roll]]

    def name(self, node: Node) -> str:
        """C text of a node that is computed already."""
        return constant(node) if node.op == "const" else self.names[node.id]

    def reads(self, node: Node) -> Iterable[Node]:
        """What must be computed before a node."""
        if node.id in self.known.reciprocals:
            return node.args[:1]
        loops = self.gathered.get(node.id, ())
        if not loops:
            return node.args
        inside = {m for loop in loops for m in loop.members}
        rest = [a for i, a in enumerate(node.args) if i not in inside]
        return [*rest, *(n for loop in loops for n in self.shared(loop.form))]

    def shared(self, first: Node) -> list[Node]:
        """What all rounds of a loop read."""
        inner = self.inside(first)
        return [a for n in inner for a in self.reads(n) if not self.alike.cells[a.id]]

    def inside(self, first: Node) -> list[Node]:
        """What a round of a loop computes."""
        return ordered([first], lambda n: [a for a in self.reads(n) if self.alike.cells[a.id]])

    def text(self, node: Node) -> str:
        """C text of an operation."""
        if node.id in self.known.reciprocals:
            return f"{self.name(node.args[0])} * {self.known.reciprocals[node.id]}"
        return expression(node, [self.name(a) for a in node.args], self.single)


def copies(statements: list[str], count: int) -> list[str]:
    """The statements for several vectors, one vector after the other in each: while one waits for a
    result, the others compute. What is not of a vector is said once."""
    return [s.replace(COPY, str(u)) for s in statements for u in range(count if COPY in s else 1)]


def write(
    stores: Iterable[Store], cells: Cells, known: Known, single: bool, prefix: str = f"t{COPY}_"
) -> list[str]:
    """The statements that compute and store, each whole.

    Args:
        stores: What becomes of the results.
        cells: Where inputs stand.
        known: What needs no computing.
        single: Whether reals are floats.
        prefix: Of the names of values.
    """
    stores = list(stores)
    w = _writing(ordered([n for s in stores for n in s.needs]), cells, known, single, prefix)
    loops, puts, plain = plan(stores, cells, _search(w.alike, cells))
    several, plain = guarded(plain, cells)
    roots = [n for s in [*plain, *puts] for n in s.needs]
    roots += [n for own in several for s in own for n in s.needs]
    roots += [n for loop in loops for n in w.shared(loop.roll.form)]
    roots += [loop.store.where for loop in loops if loop.store.where is not None]
    lines, at = _computed(w, ordered(roots, w.reads, known.names))
    placed = [(p, at(p.index)) for p in puts]
    for where in _conditions(several, loops):
        own = [s for group in several for s in group if s.where is where]
        never = [s for s in plain if excluded(s, where, cells)]
        plain = [s for s in plain if s not in never]
        puts_here = [p for p in placed if p[0].where is where]
        loops_here = [loop for loop in loops if loop.store.where is where]
        lines.append(_guarded_stores(w, where, _Guarded(own, puts_here, loops_here, never)))
        placed = [p for p in placed if p[0].where is not where]
    for put, place in placed:
        where = "every(true)" if put.where is None else w.name(put.where)
        lines.append(f"put({put.array}+{put.slot}, {place}, {where}, {w.name(put.value)});")
    lines += [_rolled(w, x, None) for x in loops if x.store.where is None]
    return [*lines, *(_stored(s, w.name(s.node)) for s in plain)]


def computed(
    nodes: list[Node], cells: Cells, known: Known, single: bool
) -> tuple[list[str], Known]:
    """The statements that compute nodes, and what is known after them."""
    w = _writing(ordered(nodes), cells, known, single, f"t{COPY}_")
    lines, _ = _computed(w, ordered(nodes, w.reads, known.names))
    return lines, known._replace(names=w.names)


def _search(alike: Alike, cells: Cells) -> LoopSearch | None:
    return None if cells.slot is None else LoopSearch(ROUNDS, cells.slot, alike)


def _writing(nodes: list[Node], cells: Cells, known: Known, single: bool, prefix: str) -> _Kernel:
    alike = alike_nodes(nodes, known.names)
    search = _search(alike, cells)
    loops: dict[int, list[Roll]] = {}
    if search is not None:
        new = [n for n in nodes if n.id not in known.names]
        loops = {number: rolled for number, (_, rolled) in gathered(new, search).items()}
    return _Kernel(cells, known, single, prefix, dict(known.names), alike, loops)


def _conditions(several: list[list[Store]], loops: list[Rolled]) -> list[Node]:
    conditions = [group[0].where for group in several] + [x.store.where for x in loops]
    return list(dict.fromkeys(n for n in conditions if n is not None))


def _computed(w: _Kernel, nodes: list[Node]) -> tuple[list[str], Callable[[Node], str]]:
    """The statements of the nodes, and how the place that an index means is named."""
    loads: dict[int, list[Node]] = {}
    for node in nodes:
        if node.op == "load":
            loads.setdefault(node.args[0].id, []).append(node)
    lines: list[str] = []

    def at(index: Node) -> str:
        if index.op == "const":
            return ""
        if ~index.id not in w.names:
            w.names[~index.id] = f"at{w.prefix}{index.id}"
            lines.append(f"const Place {w.names[~index.id]} = place({w.name(index)});")
        return w.names[~index.id]

    for node in nodes:
        if node.op == "const" or node.id in w.names:
            continue
        same_index = loads[node.args[0].id] if node.op == "load" else [node]
        for own in same_index:
            w.names[own.id] = f"{w.prefix}{own.id}"
            if own.op == "loop":
                lines.append(_loop_text(w, own, nodes))
                continue
            if own.op == "after":
                text = _after(own, w.prefix)
            elif own.op == "in":
                text = w.cells.read(own)
            elif own.op == "load":
                text = _load(own, w.cells, at(own.args[0]))
            elif own.op in GATHERED:
                before, text = _gathered(w, own)
                lines += before
            else:
                text = w.text(own)
            lines.append(f"const {TYPES[own.kind]} {w.names[own.id]} = {text};")
    return lines, at


def _round(w: _Kernel, roll: Roll) -> tuple[list[str], str]:
    """Statements of a round of a loop over ``k``, and the text of what it gives."""
    inner = w._replace(names=dict(w.names))
    lines = []
    for node in w.inside(roll.form):
        inner.names[node.id] = f"{w.prefix}{node.id}"
        if node.op == "in":
            row = roll.rows[node.id]
            text = row.text.format(f"({row.start}+{row.step}*k)")
        else:
            text = inner.text(node)
        lines.append(f"const {TYPES[node.kind]} {w.prefix}{node.id} = {text};")
    return lines, inner.name(roll.form)


def _gathered(w: _Kernel, node: Node) -> tuple[list[str], str]:
    """A sum, or the claim that all parts are finite: 0 x is 0, or NaN."""
    term = "all(0) * {}" if node.op == "all_finite" else "{}"
    loops = w.gathered.get(node.id, [])
    inside = {m for loop in loops for m in loop.members}
    rest = [term.format(w.name(a)) for i, a in enumerate(node.args) if i not in inside]
    total = " + ".join(rest) or "all(0)"
    lines = []
    if loops:
        parts = f"{w.prefix}s{node.id}"
        lines.append(f"vec {parts}[4] = {{{total}, all(0), all(0), all(0)}};")
        for loop in loops:
            own, text = _round(w, loop)
            added = f"{parts}[k & 3] = {parts}[k & 3] + {term.format(text)};"
            lines.append(block(f"for (int k = 0; k < {len(loop.members)}; k++)", [*own, added]))
        total = f"({parts}[0] + {parts}[1]) + ({parts}[2] + {parts}[3])"
    return lines, total if node.op == "sum" else f"finite({total})"


def block(head: str, statements: list[str]) -> str:
    """Statements in braces."""
    return "\n  ".join([head + " {", *statements, "}"])


def _rolled(w: _Kernel, loop: Rolled, where: str | None) -> str:
    """A loop of stores; only ``where``, if there is one."""
    store, roll = loop.store, loop.roll
    own, text = _round(w, roll)
    cell = f"{store.array}[{store.slot}+{loop.step}*k]"
    if where is not None:
        text = f"pick({where}, {text}, {cell})"
    put = f"{cell} {'+=' if store.add else '='} {text};"
    return block(f"for (int k = 0; k < {len(roll.members)}; k++)", [*own, put])


def _array_of(node: Node, name: str, prefix: str, number: int) -> str:
    return f"{prefix}{name}{'i' if node.kind != 'f' else ''}{number}"


def _after(node: Node, prefix: str) -> str:
    name, *at = node.value
    array = _array_of(node, name, prefix, node.args[0].value.number)
    text = array + "".join(f"[{i}]" for i in at)
    return f"as_mask({text})" if node.kind == "b" else text


def _truth(node: Node, text: str) -> str:
    return f"as_ints({text})" if node.kind == "b" else text


def _loop_text(w: _Kernel, loop: Node, nodes: list[Node]) -> str:
    """A loop inside a tick: its arrays, and one round of it in a C++ loop."""
    inner, number, prefix = loop.value, loop.value.number, w.prefix
    used = sorted(_rows_used(loop, nodes))
    lines = [
        f"{kind} {prefix}c{i}{number}[{len(inner.begin)}], {prefix}y{i}{number}[{inner.length}]"
        f"[{len(inner.rows)}], {prefix}x{i}{number}[{inner.length}][{len(inner.scanned)}];"
        for kind, i in (("vec", ""), ("ints", "i"))
    ]
    for at, node in enumerate(inner.begin):
        array = _array_of(node, "c", prefix, number)
        lines.append(f"{array}[{at}] = {_truth(node, w.name(node))};")
    for at, source in enumerate(inner.scanned):
        for t, node in enumerate(source[1] if source[0] == "own" else ()):
            array = _array_of(node, "x", prefix, number)
            lines.append(f"{array}[{t}][{at}] = {_truth(node, w.name(node))};")
    k = f"k{number}"
    steps = f"int {k} = 0; {k} < {inner.length}; {k}++"
    if inner.reverse:
        steps = f"int {k} = {inner.length - 1}; {k} >= 0; {k}--"

    def read(node: Node) -> str:
        (group, own), at = node.value
        if group not in ("L", "X") or own != number:
            return w.cells.read(node)
        if group == "L":
            text = f"{_array_of(node, 'c', prefix, number)}[{at}]"
        elif inner.scanned[at][0] == "count":
            _, first, step = inner.scanned[at]
            text = f"same((whole)({first} + {step} * {k}))"
        elif inner.scanned[at][0] == "rows":
            _, before, cell = inner.scanned[at]
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
    known = Known(dict(w.names), w.known.reciprocals)
    round_of = write(stores, Cells(read, w.cells.array), known, w.single, prefix)
    return "\n  ".join([*lines, block(f"for ({steps})", round_of)])


def _rows_used(loop: Node, nodes: list[Node]) -> set[int]:
    """The cells of the rows that somebody reads."""
    cells = set[int]()
    for node in nodes:
        if node.op == "after" and node.args[0] is loop and node.value[0] == "y":
            cells.add(node.value[2])
        if node.op == "loop":
            cells |= {s[2] for s in node.value.scanned if s[0] == "rows" and s[1] is loop}
    return cells


class _Guarded(NamedTuple):
    """What is stored under one condition.

    Attributes:
        stores: Single cells.
        puts: Updates at an index, with the text of the place that it means.
        loops: Cells in a loop.
        never: Stores that change nothing where the condition holds.
    """

    stores: list[Store]
    puts: list[tuple[Put, str]]
    loops: list[Rolled]
    never: list[Store]


def _guarded_stores(w: _Kernel, condition: Node, guarded: _Guarded) -> str:
    """Where the condition holds in every lane, as nearly always, there is nothing to select."""
    stores, puts, loops, never = guarded
    where, name = w.name(condition), w.name
    free = [f"{s.array}[{s.slot}] = {name(s.node)};" for s in stores]
    free += [f"put({p.array}+{p.slot}, {at}, every(true), {name(p.value)});" for p, at in puts]
    free += [_rolled(w, loop, None) for loop in loops]
    held = [
        f"{s.array}[{s.slot}] = pick({where}, {name(s.node)}, {s.array}[{s.slot}]);" for s in stores
    ]
    held += [f"put({p.array}+{p.slot}, {at}, {where}, {name(p.value)});" for p, at in puts]
    held += [_rolled(w, loop, where) for loop in loops]
    held += [_stored(s, name(s.node)) for s in never]
    head = f"if (__builtin_expect(everywhere({where}), 1))"
    return f"{block(head, free)} {block('else', held)}"


def _load(node: Node, cells: Cells, place: str) -> str:
    source, offset = node.value
    array, slot = cells.array(source)
    text = f"{array}+{slot + offset}"
    if not place:
        return f"look({text}, place(same({node.args[0].value})))"
    element = f"look({text}, {place})"
    return f"as_mask({element})" if node.kind == "b" else element


def _stored(store: Store, text: str) -> str:
    if store.node.kind == "b":
        text = f"as_ints({text})"
    if store.array.startswith("*"):  # a row of the output
        kind = "store_ints" if store.node.kind != "f" else "store"
        return f"{kind}({store.array[1:]}+{store.slot}*NB, {text});"
    return f"{store.array}[{store.slot}] {'+=' if store.add else '='} {text};"
