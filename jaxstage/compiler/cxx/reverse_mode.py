"""Reverse mode in a kernel: forward once with checkpoints, then stretch by stretch forward again,
with a tape, and back.

In a usual tick, one in which the condition of `Tape` holds in every lane, the way forward leaves on
the tape what the way back reads of it. In others it leaves the carry, from which the way back
computes everything anew.
"""

from collections.abc import Callable, Collection
from typing import NamedTuple

from jaxstage.compiler.cxx.emit import block, computed, copies, write
from jaxstage.compiler.cxx.layout import cells
from jaxstage.compiler.cxx.translation_unit import Source, holds, text_of
from jaxstage.compiler.ir.graph import Graph
from jaxstage.compiler.ir.node import Node, ordered
from jaxstage.compiler.passes.loop_reroll import kinds
from jaxstage.compiler.passes.specialize import specialize
from jaxstage.compiler.passes.store_forms import COPY, Cells, Store, guarded, indexed


class Tape(NamedTuple):
    """The stores of a usual tick. condition: that it is one; step: forward; back: of cotangents."""

    condition: Node
    step: list[Store]
    back: list[Store]


def tape_of(graph: Graph, step: list[Store], back: list[Store], where: Cells) -> Tape | None:
    """The usual tick is one in which most cells change: all runs go on. None where there is no such
    condition, or where loops inside the tick read what a tape would have to hold."""
    groups, _ = guarded(step, where)
    condition = max(groups, key=len)[0].where if groups else None
    if condition is None:
        return None
    usual = [specialize(graph, stores, condition) for stores in (step, back)]
    if usual[0] is None or usual[1] is None:
        return None
    tape = Tape(condition, usual[0], usual[1])
    nodes = ordered(n for s in (*tape.step, *tape.back) for n in s.needs)
    in_loops = kinds(nodes, ()).cells
    return None if any(in_loops[n.id] for n in _forward(tape.back, where)) else tape


def _forward(back: list[Store], where: Cells, unread: Collection[int] = ()) -> list[Node]:
    """What the way back reads that does not depend on cotangents, in order. unread: divisions that
    read a reciprocal in place of the divisor."""
    puts, plain = indexed(back, where)
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


def _given(node: Node) -> bool:
    """Whether a node is there in both directions: a number of the tick."""
    return node.op == "in" and node.value[0][0] in "rs"


_ARRAYS = {"f": "v", "b": "vm"}


def functions(
    source: Source, tape: Tape | None, step: list[Store], back: list[Store]
) -> Callable[[int], str]:
    """C++ of ``step``, ``forth`` (a step that keeps), ``anew`` and ``back``, by the number of
    vectors that go through time together."""
    where, known, single = cells(source.where), source.hoisted.known, source.low.single
    plain, anew = (write(stores, where, known, single) for stores in (step, back))
    kept, usual = ({}, None) if tape is None else _with_tape(source, tape)

    def text(together: int) -> str:
        def function(name: str, lines: list[str], seldom: bool = False) -> str:
            more = ", Kept& s" if name in ("forth", "back") else ""
            return text_of(source, name, copies(lines, together), together, more, seldom)

        forth, backward = [_KEEP, _STEP.format(source.passed)], [_ANEW.format(source.passed)]
        if usual is not None:
            condition = holds(usual.condition, together)
            unusual = block("if (!s.usual)", [*forth, "return;"])
            forth = [*usual.head, f"s.usual = __builtin_expect({condition}, 1);", unusual]
            forth += usual.on
            backward = [block("if (!s.usual)", [*backward, "return;"]), _VALUES, *usual.then]
        return "".join((
            _types(kept), function("step", plain), function("anew", anew, usual is not None),
            function("forth", forth), function("back", backward),
        ))  # fmt: skip

    return text


class _Usual(NamedTuple):
    """Statements of a usual tick. head: find the condition; on: forward; then: back."""

    head: list[str]
    condition: str
    on: list[str]
    then: list[str]


def _with_tape(source: Source, tape: Tape) -> tuple[dict[str, int], _Usual]:
    """Slots of the arrays of the tape, and the statements that fill and read it."""
    where, known, single = cells(source.where), source.hoisted.known, source.low.single
    head, after = computed([tape.condition], where, known, single)
    read = _forward(tape.back, where, known.reciprocals)
    kept = [n for n in read if n.id not in known.names and not _given(n)]
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


def _types(counts: dict[str, int]) -> str:
    """What is kept of a tick. counts: of the slots of the arrays."""
    v, vi, vm = (counts.get(name, 0) for name in ("v", "vi", "vm"))
    return f"""
struct Values {{ vec v[TOGETHER][{v}]; ints vi[TOGETHER][{vi}]; mask vm[TOGETHER][{vm}]; }};
struct Kept {{ bool usual; union {{ State state; Values values; }}; }};
"""


#: the handler's work
BODY = """
  const int64_t L = std::max<int64_t>(1, (int64_t)std::sqrt((double)N)), M = (N + L - 1) / L;
  State* kept = (State*)std::aligned_alloc(64, sizeof(State) * M + sizeof(Kept) * L);
  if (!kept) return failed(frame, "no memory for the checkpoints of a gradient");
  Kept* stretch = (Kept*)(kept + M);
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
      if (k < (M - 1) * L) step(c, ci, 0, 0, h, hi, {call}, 0, 0, NB{tables});
      else break;
    }}
    for (int64_t q = M - 1; q >= 0; q--) {{
      const int64_t first = q * L, end = std::min(N, first + L);
      take(kept[q], c, ci);
      for (int64_t k = first; k < end; k++)
        forth(c, ci, 0, 0, h, hi, {call}, 0, 0, NB{tables}, stretch[k - first]);
      for (int64_t k = end - 1; k >= first; k--)
        back(0, 0, g, a, h, hi, {call}, 0, 0, NB{tables}, stretch[k - first]);
    }}
    for (int u = 0; u < TOGETHER; u++) {{
      for (int i = 0; i < NA; i++) store(A1 + i * NB + b + u * LANES, a[u][i]);
      for (int i = 0; i < ND; i++) store(G1 + i * NB + b + u * LANES, g[u][i]);
    }}
  }}
  std::free(kept);"""
