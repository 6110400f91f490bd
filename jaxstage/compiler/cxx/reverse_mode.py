"""Reverse mode with checkpoints and a tape.

A run of N ticks goes forward once and keeps its carry every sqrt(N) ticks. Then stretch by stretch,
the last first, it goes forward again with a tape, and back. In a usual tick, one in which the
condition of `Tape` holds in every lane, the way forward leaves on the tape what the way back reads
of it. In others it leaves the carry, from which the way back computes everything anew.
"""

from collections.abc import Callable, Collection
from typing import NamedTuple

from jaxstage.compiler.cxx.emit import block, computed, copies, write
from jaxstage.compiler.cxx.layout import cells
from jaxstage.compiler.cxx.translation_unit import Source, function_text, holds, template
from jaxstage.compiler.ir.graph import Graph
from jaxstage.compiler.ir.node import Node, ordered
from jaxstage.compiler.passes.loop_reroll import alike_nodes
from jaxstage.compiler.passes.specialize import specialize
from jaxstage.compiler.passes.store_forms import COPY, Cells, Store, guarded, indexed


class Tape(NamedTuple):
    """The stores of a usual tick.

    Attributes:
        condition: That a tick is a usual one.
        step: Stores of the carry.
        back: Stores of the cotangents.
    """

    condition: Node
    step: list[Store]
    back: list[Store]


def tape_of(graph: Graph, step: list[Store], back: list[Store], cells: Cells) -> Tape | None:
    """Specialise a tick and its way back to the usual case, in which most cells change.

    Args:
        graph: The graph that all stores belong to.
        step: Stores of the carry.
        back: Stores of the cotangents.
        cells: How inputs are read.

    Returns:
        The specialised stores; None where there is no such condition, or where loops inside the
        tick read what a tape would have to hold.
    """
    groups, _ = guarded(step, cells)
    condition = max(groups, key=len)[0].where if groups else None
    if condition is None:
        return None
    usual = [specialize(graph, stores, condition) for stores in (step, back)]
    if usual[0] is None or usual[1] is None:
        return None
    tape = Tape(condition, usual[0], usual[1])
    nodes = ordered(n for s in (*tape.step, *tape.back) for n in s.needs)
    in_loops = alike_nodes(nodes, ()).cells
    return None if any(in_loops[n.id] for n in _taped(tape.back, cells)) else tape


def _taped(back: list[Store], cells: Cells, unread: Collection[int] = ()) -> list[Node]:
    """What the way back reads that does not depend on cotangents, in order. unread: divisions that
    read a reciprocal in place of the divisor."""
    puts, plain = indexed(back, cells)
    roots = [n for s in (*plain, *puts) for n in s.needs]

    def reads(node: Node) -> tuple[Node, ...]:
        return node.args[:1] if node.id in unread else node.args

    nodes, moved = ordered(roots, reads), set()
    for node in nodes:
        cotangent = node.op in ("in", "load") and node.value[0][0] == "g"
        if cotangent or any(a.id in moved for a in reads(node)):
            moved.add(node.id)
    read = [a for n in nodes if n.id in moved for a in reads(n)] + roots
    return [n for n in dict.fromkeys(read) if n.id not in moved and n.op != "const"]


def _of_tick(node: Node) -> bool:
    """Whether a node is a number of the tick, which both directions read."""
    return node.op == "in" and node.value[0][0] in "rs"


_ARRAYS = {"f": "v", "b": "vm"}


def functions(
    source: Source, tape: Tape | None, step: list[Store], back: list[Store]
) -> Callable[[int], str]:
    """The functions of a tick: ``step``, ``forth`` (a step that keeps), ``anew`` and ``back``.

    Args:
        source: The unit that they stand in.
        tape: What a usual tick stores, or None.
        step: Stores of the carry.
        back: Stores of the cotangents.

    Returns:
        C++ text, by the number of vectors that go through time together.
    """
    where, known = cells(source.layout), source.hoisted.known
    plain, anew = (write(stores, where, known, source.lowered.single) for stores in (step, back))
    slots, usual = ({}, None) if tape is None else _with_tape(source, tape)

    def text(interleave: int) -> str:
        def function(name: str, lines: list[str], cold: bool = False) -> str:
            more = ", Kept& s" if name in ("forth", "back") else ""
            return function_text(source, name, copies(lines, interleave), interleave, more, cold)

        forth, backward = [_KEEP, _STEP.format(source.passed)], [_ANEW.format(source.passed)]
        if usual is not None:
            condition = holds(usual.condition, interleave)
            unusual = block("if (!s.usual)", [*forth, "return;"])
            forth = [*usual.head, f"s.usual = __builtin_expect({condition}, 1);", unusual]
            forth += usual.on
            backward = [block("if (!s.usual)", [*backward, "return;"]), _VALUES, *usual.then]
        reals, wholes, masks = (slots.get(name, 0) for name in ("v", "vi", "vm"))
        texts = (
            template("tape").substitute(reals=reals, wholes=wholes, masks=masks),
            function("step", plain),
            function("anew", anew, cold=usual is not None),
            function("forth", forth),
            function("back", backward),
        )
        return "".join(texts)

    return text


class _Usual(NamedTuple):
    """Statements of a usual tick.

    Attributes:
        head: Find the condition.
        condition: C text of it.
        on: The way forward, which fills the tape.
        then: The way back, which reads it.
    """

    head: list[str]
    condition: str
    on: list[str]
    then: list[str]


def _with_tape(source: Source, tape: Tape) -> tuple[dict[str, int], _Usual]:
    """Slots of the arrays of the tape, and the statements that fill and read it."""
    where, known, single = cells(source.layout), source.hoisted.known, source.lowered.single
    head, after = computed([tape.condition], where, known, single)
    needed = _taped(tape.back, where, known.reciprocals)
    kept = [n for n in needed if n.id not in known.names and not _of_tick(n)]
    rest, whole = computed(kept, where, after, single)
    counts: dict[str, int] = {}
    names, leaves = dict(known.names), []
    for node in kept:
        array = _ARRAYS.get(node.kind, "vi")
        slot = counts.get(array, 0)
        counts[array] = slot + 1
        names[node.id] = f"{array}{COPY}[{slot}]"
        leaves.append(f"s.values.{array}[{COPY}][{slot}] = {whole.names[node.id]};")
    on = [*rest, *leaves, *write(tape.step, where, whole, single)]
    then = write(tape.back, where, known._replace(names=names), single)
    return counts, _Usual(head, after.names[tape.condition.id], on, then)


_KEEP = "keep(s.state, c, ci);"
_STEP = "step(c, ci, d, a, h, hi, {0});"
_ANEW = "anew(s.state.c, s.state.ci, d, a, h, hi, {0});"
_VALUES = (
    f"const vec* __restrict v{COPY} = s.values.v[{COPY}]; "
    f"const ints* __restrict vi{COPY} = s.values.vi[{COPY}]; "
    f"const mask* __restrict vm{COPY} = s.values.vm[{COPY}];"
)
