"""The three kernels of a program: run it, push tangents through it, pull cotangents back.

Each gets its arrays in this order (reals, then integers): P, PI parameters of the runs (slots,
lanes); S, SI numbers that all runs share; R, RI numbers of each tick (ticks, slots); C, CI the
carry (slots, lanes); then the tables; then the tangents Q of parameters and D of the carry, or
the cotangents G of the carry. The lanes are a multiple of a vector.
"""

import functools
from typing import Any, NamedTuple

from jaxstage.engine.assuming import assuming
from jaxstage.engine.lowering import Layout, Lowered, cells, flat, layout, lower
from jaxstage.engine.node import Node, kind_of, ordered
from jaxstage.engine.parts import RUN
from jaxstage.engine.program import (
    Program,
    forward_jaxpr,
    pullback_jaxpr,
    row_structure,
    tangent_jaxpr,
)
from jaxstage.engine.source import (
    Function,
    Source,
    function_of,
    handler,
    heading,
    source_of,
    text_of,
)
from jaxstage.engine.stores import COPY, Store, guarded

#: vectors of runs that go through time together, where there are so many: while one waits for a
#: result, the others compute
TOGETHER = 4
#: operations of a tick up to which they do: more keep a processor busy alone, and compile long
INTERLEAVED = 1000


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
    beside the carry that have derivatives. Raises NotImplementedError with the reason."""
    return _MAKERS[what](program, own, moving)


def _texts(
    source: Source, functions: dict[str, Function], nodes: int, head: str, body: str
) -> dict[int, str]:
    """The texts of a kernel of so many operations a tick. body: of the handler."""

    def text(together: int) -> str:
        made = [text_of(source, name, f, together) for name, f in functions.items()]
        return "".join((heading(source, together), *made, handler(source, head, body)))

    return {n: text(n) for n in ({1, TOGETHER} if nodes <= INTERLEAVED else {1})}


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
           rowsi + t * {counts["rowi"]} * NB + b, NB{source.passed});
    for (int u = 0; u < TOGETHER; u++) end(b + u * LANES, c[u], ci[u]);
  }}"""
    head = "real* C1 = out<real>(frame, 0); int32_t* CI1 = out<int32_t>(frame, 1);\n"
    head += "  real* rows = out<real>(frame, 2); int32_t* rowsi = out<int32_t>(frame, 3);"
    nodes = _work(stores)
    texts = _texts(source, {"step": function_of(source, stores)}, nodes, head, body)
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
      step(c, ci, d, 0, h, hi, R + t * NR, RI + t * NRI, 0, 0, NB{source.passed});
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
    texts = _texts(source, {"step": function_of(source, stores)}, nodes, head, body)
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
    condition = _guard(step, where)
    usual = None if condition is None else assuming(low.graph, back, condition)
    source = source_of(program, low, where, [*step, *back, *(usual or [])])
    body = _REVERSE.format(
        borders=source.borders, passed=source.passed, call="R + k * NR, RI + k * NRI"
    )
    first = 8 + len(low.tables)
    head = f"const real* G = in<real>(frame, {first});\n"
    head += "  real *A1 = out<real>(frame, 0), *G1 = out<real>(frame, 1), *C1 = 0;\n"
    head += "  int32_t* CI1 = 0;"
    functions = {
        "step": function_of(source, step),
        "back": function_of(source, back, condition, usual),
    }
    nodes = _work(step + back)
    return Kernel(_texts(source, functions, nodes, head, body), low, where, {}, {}, nodes)


def _guard(stores: list[Store], where: Layout) -> Node | None:
    """The condition under which most cells change, or None."""
    groups, _ = guarded(stores, cells(where))
    return max(groups, key=len)[0].where if groups else None


#: forward once, keeping every L-th carry; then stretch by stretch forward again and back
_REVERSE = """
  const int64_t L = std::max<int64_t>(1, (int64_t)std::sqrt((double)N)), M = (N + L - 1) / L;
  const size_t room = sizeof(State);
  State* kept = (State*)std::aligned_alloc(64, room * (M + L + 1));
  if (!kept) return failed(frame, "no memory for the checkpoints of a gradient");
  State* stretch = kept + M;
  {borders}
  for (int64_t b = 0; b < NB; b += TOGETHER * LANES) {{
    vec h[TOGETHER][NH], c[TOGETHER][NC], g[TOGETHER][ND], a[TOGETHER][NA];
    ints hi[TOGETHER][NHI], ci[TOGETHER][NCI];
    for (int u = 0; u < TOGETHER; u++) {{
      begin(b + u * LANES, h[u], hi[u], c[u], ci[u]);
      for (int i = 0; i < ND; i++) g[u][i] = load(G + i * NB + b + u * LANES);
      for (int i = 0; i < NA; i++) a[u][i] = all(0);
    }}
    for (int64_t k = 0; k < N; k++) {{
      if (k % L == 0) keep(kept[k / L], c, ci);
      if (k < (M - 1) * L) step(c, ci, 0, 0, h, hi, {call}, 0, 0, NB{passed});
      else break;
    }}
    for (int64_t q = M - 1; q >= 0; q--) {{
      const int64_t end = std::min(N, (q + 1) * L);
      take(kept[q], c, ci);
      for (int64_t k = q * L; k < end; k++) {{
        keep(stretch[k - q * L], c, ci);
        if (k + 1 < end) step(c, ci, 0, 0, h, hi, {call}, 0, 0, NB{passed});
      }}
      for (int64_t k = end - 1; k >= q * L; k--) {{
        State& s = stretch[k - q * L];
        back(s.c, s.ci, g, a, h, hi, {call}, 0, 0, NB{passed});
      }}
    }}
    for (int u = 0; u < TOGETHER; u++) {{
      for (int i = 0; i < NA; i++) store(A1 + i * NB + b + u * LANES, a[u][i]);
      for (int i = 0; i < ND; i++) store(G1 + i * NB + b + u * LANES, g[u][i]);
    }}
  }}
  std::free(kept);"""


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
        if low.parts.of(low.parts.program.results[position]) != RUN:
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
