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
from jaxstage.compiler.cxx.layout import Layout, cells, layout
from jaxstage.compiler.cxx.translation_unit import Source, handler, heading, source_of, text_of
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
TOGETHER = 4
#: operations of a tick up to which so many vectors go together, kernel by kernel: more operations
#: keep a processor busy alone, and compile long. Two tapes fill a cache that four overflow.
MOST = {
    "forward": {4: 1000, 2: 2500},
    "tangent": {4: 1000},
    "pullback": {2: 1000},
}  # fmt: skip


class Kernel(NamedTuple):
    """A kernel as texts, and what it expects. texts: by the number of vectors that go through time
    together; rows: row leaves that it stores: whether among the reals, and the first slot. counts:
    of the slots of a row. nodes: operations of a tick."""

    texts: dict[int, str]
    lowered: Lowered
    layout: Layout
    rows: dict[int, tuple[bool, int]]
    counts: dict[str, int]
    nodes: int

    def text(self, vectors: int) -> str:
        """The text for a whole batch."""
        return self.texts[max(n for n in self.texts if vectors % n == 0)]


@functools.cache
def kernel(
    program: Program, what: str, own: tuple[bool, ...], moving: tuple[int, ...] = ()
) -> Kernel:
    """The kernel ``forward``, ``tangent`` or ``pullback``. own: see `lower`; moving: the leaves
    beside the carry that have derivatives. Raises LoweringError with the reason."""
    return _MAKERS[what](program, own, moving)


def _texts(
    source: Source, functions: Callable[[int], str], together: int, head: str, body: str
) -> dict[int, str]:
    """The texts of a kernel, for one vector at a time and several. functions: C++ by the number of
    vectors; body: of the handler."""

    def text(together: int) -> str:
        made = functions(together)
        return "".join((heading(source, together), made, handler(source, head, body)))

    return {n: text(n) for n in {1, together}}


def _together(what: str, nodes: int) -> int:
    return next((n for n, most in MOST[what].items() if nodes <= most), 1)


def _stepping(source: Source, stores: list[Store]) -> Callable[[int], str]:
    lines = write(stores, cells(source.where), source.hoisted.known, source.low.single)
    return lambda together: text_of(source, "step", copies(lines, together), together)


def _forward(program: Program, own: tuple[bool, ...], moving: tuple[int, ...]) -> Kernel:
    low = lower(program, forward_jaxpr(program), own, ())
    where = layout(program, low, ())
    stores = _carried(low, where, low.results)
    rows, counts = _rows(program, low, stores)
    source = source_of(program, low, where, stores)
    body = f"""{source.borders}
  for (int64_t b = 0; b < NB; b += TOGETHER * LANES) {{
    vec h[TOGETHER][NH], c[TOGETHER][NC];
    ints hi[TOGETHER][NHI], ci[TOGETHER][NCI];
    for (int u = 0; u < TOGETHER; u++) begin(b + u * LANES, h[u], hi[u], c[u], ci[u]);
    for (int64_t t = 0; t < N; t++)
      step(c, ci, 0, 0, h, hi, R + t * NR, RI + t * NRI, rows + t * {counts["row"]} * NB + b,
           rowsi + t * {counts["rowi"]} * NB + b, NB{source.tables});
    for (int u = 0; u < TOGETHER; u++) end(b + u * LANES, c[u], ci[u]);
  }}"""
    head = "real* C1 = out<real>(frame, 0); int32_t* CI1 = out<int32_t>(frame, 1);\n"
    head += "  real* rows = out<real>(frame, 2); int32_t* rowsi = out<int32_t>(frame, 3);"
    nodes = _work(stores)
    texts = _texts(source, _stepping(source, stores), _together("forward", nodes), head, body)
    return Kernel(texts, low, where, rows, counts, nodes)


def _tangent(program: Program, own: tuple[bool, ...], moving: tuple[int, ...]) -> Kernel:
    groups = [*(f"q{i}" for i in moving), *(f"d{i}" for i in program.real_carry)]
    low = lower(program, tangent_jaxpr(program, moving), own, tuple(groups))
    where = layout(program, low, moving)
    count = len(program.carry)
    stores = _carried(low, where, low.results[:count])
    stores += _derived(program, where, low.results[count:], "d", "d")
    source = source_of(program, low, where, stores)
    body = f"""{source.borders}
  for (int64_t b = 0; b < NB; b += TOGETHER * LANES) {{
    vec h[TOGETHER][NH], c[TOGETHER][NC], d[TOGETHER][ND];
    ints hi[TOGETHER][NHI], ci[TOGETHER][NCI];
    for (int u = 0; u < TOGETHER; u++) {{
      begin(b + u * LANES, h[u], hi[u], c[u], ci[u]);
      for (int i = 0; i < ND; i++) d[u][i] = load(D + i * NB + b + u * LANES);
    }}
    for (int64_t t = 0; t < N; t++)
      step(c, ci, d, 0, h, hi, R + t * NR, RI + t * NRI, 0, 0, NB{source.tables});
    for (int u = 0; u < TOGETHER; u++) {{
      end(b + u * LANES, c[u], ci[u]);
      for (int i = 0; i < ND; i++) store(D1 + i * NB + b + u * LANES, d[u][i]);
    }}
  }}"""
    first = 8 + len(low.tables)
    head = f"const real *Q = in<real>(frame, {first}), *D = in<real>(frame, {first + 1});\n"
    head += "  real* C1 = out<real>(frame, 0); int32_t* CI1 = out<int32_t>(frame, 1);\n"
    head += "  real* D1 = out<real>(frame, 2);"
    nodes = _work(stores)
    texts = _texts(source, _stepping(source, stores), _together("tangent", nodes), head, body)
    return Kernel(texts, low, where, {}, {}, nodes)


def _pullback(program: Program, own: tuple[bool, ...], moving: tuple[int, ...]) -> Kernel:
    groups = tuple(f"g{i}" for i in program.real_carry)
    low = lower(program, pullback_jaxpr(program, moving), own, groups)
    where = layout(program, low, moving)
    count = len(program.carry)
    step = _carried(low, where, low.results[:count])
    results = low.results[count:]
    back = [
        Store(f"a{COPY}", where.moving["a", i] + k, node, add=True)
        for i, array in zip(moving, results[: len(moving)], strict=True)
        for k, node in enumerate(flat(array))
        if not (node.op == "const" and node.value == 0)
    ]
    back += _derived(program, where, results[len(moving) :], "g", "g")
    tape = reverse_mode.tape_of(low.graph, step, back, cells(where))
    usual = [] if tape is None else [*tape.step, *tape.back]
    source = source_of(program, low, where, [*step, *back, *usual])
    body = reverse_mode.BODY.format(
        borders=source.borders, tables=source.tables, call="R + k * NR, RI + k * NRI"
    )
    first = 8 + len(low.tables)
    head = f"const real* G = in<real>(frame, {first});\n"
    head += "  real *A1 = out<real>(frame, 0), *G1 = out<real>(frame, 1), *C1 = 0;\n"
    head += "  int32_t* CI1 = 0;"
    nodes = _work(step + back)
    functions = reverse_mode.functions(source, tape, step, back)
    texts = _texts(source, functions, _together("pullback", nodes), head, body)
    return Kernel(texts, low, where, {}, {}, nodes)


def _carried(low: Lowered, where: Layout, results: list[Any]) -> list[Store]:
    stores = []
    for number, (real, first) in where.carry.items():
        name = f"{'c' if real else 'ci'}{COPY}"
        stores += [Store(name, first + k, n) for k, n in enumerate(flat(results[number]))]
    return stores


def _derived(
    program: Program, where: Layout, results: list[Any], name: str, group: str
) -> list[Store]:
    return [
        Store(f"{name}{COPY}", where.moving[group, i] + k, node)
        for i, array in zip(program.real_carry, results, strict=True)
        for k, node in enumerate(flat(array))
    ]


def _rows(
    program: Program, low: Lowered, stores: list[Store]
) -> tuple[dict[int, tuple[bool, int]], dict[str, int]]:
    """Which leaves of the row the kernel stores: those that the runs have for themselves."""
    _, leaves = row_structure(program)
    places, counts = {}, {"row": 0, "rowi": 0}
    for number, leaf in enumerate(leaves):
        position = len(program.carry) + number
        if low.staged.of(low.staged.program.results[position]) != RUN:
            continue
        real = kind_of(leaf.dtype) == "f"
        name = "row" if real else "rowi"
        places[number] = real, counts[name]
        nodes = flat(low.results[position])
        stores += [Store(f"*{name}{COPY}", counts[name] + k, n) for k, n in enumerate(nodes)]
        counts[name] += len(nodes)
    return places, counts


def _work(stores: list[Store]) -> int:
    def reads(node: Node) -> tuple[Node, ...]:
        rounds = (*node.value.inside, *node.value.rows) if node.op == "loop" else ()
        return (*node.args, *rounds)

    return len(ordered((s.node for s in stores), reads))


_MAKERS = {"forward": _forward, "tangent": _tangent, "pullback": _pullback}
