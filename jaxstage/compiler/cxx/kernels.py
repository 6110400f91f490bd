"""The three kernels of a program: run it, push tangents through it, pull cotangents back.

Each gets its arrays in this order (reals, then integers): P, PI parameters of the runs (slots,
lanes); S, SI numbers that all runs share; R, RI numbers of each tick (ticks, slots); C, CI the
carry (slots, lanes); then the tables; then the tangents Q of parameters and D of the carry, or
the cotangents G of the carry. The lanes are a multiple of a vector.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

from jaxstage.compiler.cxx import reverse_mode
from jaxstage.compiler.cxx.emit import copies, write
from jaxstage.compiler.cxx.layout import Layout, cells, lay_out
from jaxstage.compiler.cxx.translation_unit import (
    Source,
    function_text,
    handler,
    heading,
    source_of,
)
from jaxstage.compiler.frontend.binding_time import RUN
from jaxstage.compiler.frontend.lower import Lowered, flat, lower
from jaxstage.compiler.frontend.step_program import (
    Program,
    forward_jaxpr,
    pullback_jaxpr,
    row_structure,
    tangent_jaxpr,
)
from jaxstage.compiler.ir.node import Node, kind_of, ordered
from jaxstage.compiler.passes.store_forms import COPY, Store

#: the most vectors of runs that go through time together: while one waits for a result, the others
#: compute
INTERLEAVE = 4
#: operations of a tick up to which so many vectors go together, kernel by kernel: more operations
#: keep a processor busy alone, and compile long. Two tapes fill a cache that four overflow.
MOST = {"forward": {4: 1000, 2: 2500}, "tangent": {4: 1000}, "pullback": {2: 1000}}


class Kernel(NamedTuple):
    """A kernel as C++ texts, and what it expects.

    Attributes:
        texts: Translation units, by the number of vectors that go through time together.
        lowered: One control period as a graph.
        layout: Slots of its inputs.
        rows: Row leaves that it stores: whether among the reals, and the first slot.
        counts: Slots of a row, of reals ``row`` and integers ``rowi``.
        nodes: Operations of a control period.
    """

    texts: dict[int, str]
    lowered: Lowered
    layout: Layout
    rows: dict[int, tuple[bool, int]]
    counts: dict[str, int]
    nodes: int

    def text(self, vectors: int) -> str:
        """The unit for a batch of so many vectors."""
        return self.texts[max(n for n in self.texts if vectors % n == 0)]


@functools.cache
def kernel(
    program: Program, what: str, own: tuple[bool, ...], moving: tuple[int, ...] = ()
) -> Kernel:
    """Generate a kernel, once for equal arguments.

    Args:
        program: The loop.
        what: ``forward``, ``tangent`` or ``pullback``.
        own: Of each shared leaf and each carried one, whether runs have it for themselves.
        moving: Leaves beside the carry that have derivatives.

    Returns:
        The kernel, not compiled yet.

    Raises:
        LoweringError: With the reason why there is none.
    """
    return _GENERATORS[what](program, own, moving)


def _forward(program: Program, own: tuple[bool, ...], moving: tuple[int, ...]) -> Kernel:
    lowered = lower(program, forward_jaxpr(program), own, ())
    layout = lay_out(program, lowered, ())
    stores = _carried(lowered, layout, lowered.results)
    rows, counts = _rows(program, lowered, stores)
    source = source_of(program, lowered, layout, stores)
    return _assembled("forward", source, stores, _stepping(source, stores), rows, counts)


def _tangent(program: Program, own: tuple[bool, ...], moving: tuple[int, ...]) -> Kernel:
    groups = [*(f"q{i}" for i in moving), *(f"d{i}" for i in program.real_carry)]
    lowered = lower(program, tangent_jaxpr(program, moving), own, tuple(groups))
    layout = lay_out(program, lowered, moving)
    count = len(program.carry)
    stores = _carried(lowered, layout, lowered.results[:count])
    stores += _derived(program, layout, lowered.results[count:], "d")
    source = source_of(program, lowered, layout, stores)
    return _assembled("tangent", source, stores, _stepping(source, stores))


def _pullback(program: Program, own: tuple[bool, ...], moving: tuple[int, ...]) -> Kernel:
    groups = tuple(f"g{i}" for i in program.real_carry)
    lowered = lower(program, pullback_jaxpr(program, moving), own, groups)
    layout = lay_out(program, lowered, moving)
    count = len(program.carry)
    step = _carried(lowered, layout, lowered.results[:count])
    results = lowered.results[count:]
    back = [
        Store(f"a{COPY}", layout.moving["a", i] + k, node, add=True)
        for i, array in zip(moving, results[: len(moving)], strict=True)
        for k, node in enumerate(flat(array))
        if not (node.op == "const" and node.value == 0)
    ]
    back += _derived(program, layout, results[len(moving) :], "g")
    tape = reverse_mode.tape_of(lowered.graph, step, back, cells(layout))
    usual = [] if tape is None else [*tape.step, *tape.back]
    source = source_of(program, lowered, layout, [*step, *back, *usual])
    functions = reverse_mode.functions(source, tape, step, back)
    return _assembled("pullback", source, step + back, functions)


def _assembled(
    what: str,
    source: Source,
    stores: list[Store],
    functions: Callable[[int], str],
    rows: dict[int, tuple[bool, int]] | None = None,
    counts: dict[str, int] | None = None,
) -> Kernel:
    """The units of a kernel, for one vector at a time and for several.

    functions: C++ of the functions of a period, by the number of vectors that go together.
    """
    rows, counts, nodes = rows or {}, counts or {}, _operations(stores)
    interleave = next((n for n, most in MOST[what].items() if nodes <= most), 1)

    def text(interleave: int) -> str:
        written = functions(interleave)  # before the heading, which counts what they read
        return heading(source, interleave) + written + handler(source, what, **counts)

    texts = {n: text(n) for n in {1, interleave}}
    return Kernel(texts, source.lowered, source.layout, rows, counts, nodes)


def _stepping(source: Source, stores: list[Store]) -> Callable[[int], str]:
    """C++ of ``step``, by the number of vectors that go together."""
    lines = write(stores, cells(source.layout), source.hoisted.known, source.lowered.single)
    return lambda interleave: function_text(source, "step", copies(lines, interleave), interleave)


def _carried(lowered: Lowered, layout: Layout, results: list[Any]) -> list[Store]:
    """Stores of the carry after a period."""
    return [
        Store(f"{'c' if real else 'ci'}{COPY}", first + k, node)
        for number, (real, first) in layout.carry.items()
        for k, node in enumerate(flat(results[number]))
    ]


def _derived(program: Program, layout: Layout, results: list[Any], group: str) -> list[Store]:
    """Stores of tangents ``d`` or cotangents ``g`` of the carry."""
    return [
        Store(f"{group}{COPY}", layout.moving[group, i] + k, node)
        for i, array in zip(program.real_carry, results, strict=True)
        for k, node in enumerate(flat(array))
    ]


def _rows(
    program: Program, lowered: Lowered, stores: list[Store]
) -> tuple[dict[int, tuple[bool, int]], dict[str, int]]:
    """Add the stores of the row leaves that runs have for themselves; their places and counts."""
    _, leaves = row_structure(program)
    places, counts = {}, {"row": 0, "rowi": 0}
    for number, leaf in enumerate(leaves):
        position = len(program.carry) + number
        if lowered.staged.of(lowered.staged.program.results[position]) != RUN:
            continue
        real = kind_of(leaf.dtype) == "f"
        name = "row" if real else "rowi"
        places[number] = real, counts[name]
        nodes = flat(lowered.results[position])
        stores += [Store(f"*{name}{COPY}", counts[name] + k, n) for k, n in enumerate(nodes)]
        counts[name] += len(nodes)
    return places, counts


def _operations(stores: list[Store]) -> int:
    """Operations of a control period, those inside a loop once."""

    def reads(node: Node) -> tuple[Node, ...]:
        rounds = (*node.value.inside, *node.value.rows) if node.op == "loop" else ()
        return (*node.args, *rounds)

    return len(ordered((s.node for s in stores), reads))


_GENERATORS = {"forward": _forward, "tangent": _tangent, "pullback": _pullback}
