"""Loop-invariant code motion: what is the same in every tick is computed before the time loop."""

from typing import NamedTuple

from jaxstage.compiler.cxx.emit import Known, write
from jaxstage.compiler.cxx.ops import constant
from jaxstage.compiler.frontend.lower import Lowered
from jaxstage.compiler.ir.node import Node
from jaxstage.compiler.passes.store_forms import COPY, Cells, Store


def _fixed(node: Node, fixed: dict[int, bool]) -> bool:
    """Whether a node is the same in every tick."""
    known = fixed.get(node.id)
    if known is None:
        if node.op == "in":
            known = node.value[0][0] in "psq"
        elif node.op == "load":
            known = node.value[0][0] == "t" and _fixed(node.args[0], fixed)
        else:
            known = all([_fixed(a, fixed) for a in node.args])
        fixed[node.id] = known
    return known


def _invertible(node: Node, fixed: dict[int, bool], exact: set[int]) -> bool:
    """Whether a division may be a product with the reciprocal of what is the same in every tick."""
    divides = node.op == "div" and node.kind == "f" and node.id not in exact
    return divides and node.id in fixed and not fixed[node.id] and fixed[node.args[1].id]


def _quantised(nodes: list[Node]) -> set[int]:
    """Divisions whose quotient is rounded and multiplied again, as an encoder does: one rounding
    more would move whole steps."""
    rounded = ("floor", "ceil", "round")
    stack = [x for n in nodes if n.op == "mul" for x in n.args if x.op in rounded]
    divisions: set[int] = set()
    while stack:
        node = stack.pop()
        if node.op == "div":
            divisions.add(node.id)
        elif node.op in (*rounded, "add", "sub", "neg"):
            stack.extend(node.args)
    return divisions


class Hoisted(NamedTuple):
    """What is computed before the time loop, into ``h`` and ``hi``.

    Attributes:
        lines: Statements.
        known: Names of what they compute.
        reals: Slots of ``h``.
        wholes: Slots of ``hi``.
    """

    lines: list[str]
    known: Known
    reals: int
    wholes: int


def hoist(low: Lowered, stores: list[Store], where: Cells) -> Hoisted:
    """Take out of the loop what is the same in every tick, and reciprocals of such divisors."""
    g, fixed = low.graph, {}
    for node in g.nodes:  # arguments first: no deep recursion
        _fixed(node, fixed)
    exact = _quantised(g.nodes)
    outer: dict[int, Node] = {}
    inverse: dict[int, Node] = {}
    seen: set[int] = set()
    stack = [s.node for s in stores]
    while stack:
        node = stack.pop()
        if node.id in seen or node.op == "const":
            continue
        seen.add(node.id)
        if fixed[node.id]:
            outer[node.id] = node
            continue
        if _invertible(node, fixed, exact):
            inverse[node.args[1].id] = g.op("div", g.const(1, "f"), node.args[1])
            stack.append(node.args[0])
            continue
        stack.extend(node.args)
        if node.op == "loop":
            stack.extend((*node.value.inside, *node.value.rows))
    names, stored, counts = {}, [], {True: 0, False: 0}
    for node in [*outer.values(), *inverse.values()]:
        if node.op == "const" or node.id in names:
            continue
        real = node.kind == "f"
        name = "h" if real else "hi"
        stored.append(Store(name, counts[real], node))
        text = f"{name}{COPY}[{counts[real]}]"
        names[node.id] = f"as_mask({text})" if node.kind == "b" else text
        counts[real] += 1
    lines = write(stored, where, Known({}, {}), low.single, "p")
    texts = {y: constant(n) if n.op == "const" else names[n.id] for y, n in inverse.items()}
    reciprocals = {
        n.id: texts[n.args[1].id]
        for n in g.nodes
        if n.op == "div" and n.args[1].id in texts and _invertible(n, fixed, exact)
    }
    return Hoisted(lines, Known(names, reciprocals), counts[True], counts[False])
