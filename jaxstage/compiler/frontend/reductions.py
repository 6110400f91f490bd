"""Elementwise operations, reductions and products of arrays of nodes."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxstage.compiler.ir.graph import Graph
from jaxstage.compiler.ir.limits import LONG
from jaxstage.compiler.ir.node import Node, kind_of


def elementwise(f: Callable[..., Node], *arrays: np.ndarray) -> np.ndarray:
    """Broadcast arrays and apply a function.

    Args:
        f: Of one node of each array.
        arrays: Object arrays of nodes.
    """
    shape = np.broadcast_shapes(*(a.shape for a in arrays))
    wide = [np.broadcast_to(a, shape) for a in arrays]
    out = np.empty(shape, object)
    for index in np.ndindex(*shape):
        out[index] = f(*(a[index] for a in wide))
    return out


def tree_sum(g: Graph, name: str, nodes: list[Node]) -> Node:
    """Pairwise reduction by an operation."""
    while len(nodes) > 1:
        pairs = [nodes[i : i + 2] for i in range(0, len(nodes), 2)]
        nodes = [g.op(name, *pair) if len(pair) == 2 else pair[0] for pair in pairs]
    return nodes[0]


def long_sum(g: Graph, nodes: list[Node]) -> Node:
    """The sum of nodes.

    Returns:
        A node `sum` where a kernel may make a loop of it, else a tree of additions.
    """
    nodes = [n for n in nodes if not (n.op == "const" and n.value == 0)] or nodes[:1]
    if g.rich and len(nodes) >= LONG and nodes[0].kind == "f":
        return g.special("sum", tuple(nodes), None, "f")
    return tree_sum(g, "add", nodes)


def conjunction(g: Graph, nodes: list[Node]) -> Node:
    """True where all are. A claim on each cell of an indexed update is one on what was put."""
    kept: dict[int, Node] = {}
    claims: dict[tuple[int, int], list[Node]] = {}
    for node in nodes:
        parts = _claim(node)
        if parts is None:
            kept[node.id] = node
        else:
            claims.setdefault((parts[0].id, parts[2].id), []).append(node)
    for same in claims.values():
        index, _, what = _claim(same[0])  # type: ignore[misc]
        reached = {_claim(n)[1] for n in same}  # type: ignore[index]
        if reached >= set(range(int(index.low), int(index.high) + 1)):
            same = [what]
        kept.update((n.id, n) for n in same)
    return tree_sum(g, "and", _finite_together(g, list(kept.values())))


def _finite_together(g: Graph, nodes: list[Node]) -> list[Node]:
    """Without claims that follow from others: what a finite sum or product is made of is finite.

    Claims under one condition, ``condition or is_finite(x)``, are together, too.

    Args:
        g: Gets the nodes.
        nodes: Truth values that must all hold.

    Returns:
        Fewer truth values that must all hold.
    """
    conditions: dict[Node | None, list[Node]] = {}
    rest = []
    for node in nodes:
        condition, claimed = _under(node)
        if claimed is None:
            rest.append(node)
        else:
            conditions.setdefault(condition, []).append(claimed)
    for condition, claimed in conditions.items():
        left = _not_implied(claimed)
        if g.rich and len(left) > 1:
            left = [g.op("all_finite", *left)]
        else:
            left = [g.op("is_finite", c) for c in left]
        rest += [n if condition is None else g.op("or", condition, n) for n in left]
    return rest


def _under(node: Node) -> tuple[Node | None, Node | None]:
    """(condition, x) of ``condition or is_finite(x)``, with None for what there is not."""
    if node.op == "is_finite":
        return None, node.args[0]
    if node.op == "or" and node.kind == "b":
        for condition, claim in (node.args, node.args[::-1]):
            if claim.op == "is_finite":
                return condition, claim.args[0]
    return None, None


def _not_implied(claimed: list[Node]) -> list[Node]:
    implied: set[int] = set()
    stack = [a for c in claimed for a in _made_of(c)]
    while stack:
        node = stack.pop()
        if node.id not in implied:
            implied.add(node.id)
            stack.extend(_made_of(node))
    return [c for c in claimed if c.id not in implied]


def _made_of(node: Node) -> tuple[Node, ...]:
    return node.args if node.op in ("add", "sub", "mul", "neg", "abs", "sqrt", "sum") else ()


def _claim(node: Node) -> tuple[Node, int, Node] | None:
    """(index, k, what) of ``not (index == k) or what``."""
    if node.op != "or" or node.args[0].op != "not" or node.args[0].args[0].op != "eq":
        return None
    index, k = node.args[0].args[0].args
    if k.op != "const" or not -1e6 < index.low <= index.high < 1e6:
        return None
    return index, k.value, node.args[1]


def _reduced(array: np.ndarray, axes: Any, f: Callable[[list[Node]], Node]) -> np.ndarray:
    kept = [d for d in range(array.ndim) if d not in axes]
    shape = [array.shape[d] for d in kept]
    flat = array.transpose([*kept, *axes]).reshape([*shape, -1])
    out = np.empty(shape, object)
    for index in np.ndindex(*shape):
        out[index] = f(list(flat[index]))
    return out


def _reduction(name: str, empty: Any) -> Callable[..., Any]:
    def rule(g: Graph, equation: Any, args: list[Any]) -> list[Any]:
        kind = kind_of(equation.outvars[0].aval.dtype)

        def one(nodes: list[Node]) -> Node:
            if not nodes:
                return g.const(empty, kind)
            if name == "and":
                return conjunction(g, nodes)
            return long_sum(g, nodes) if name == "add" else tree_sum(g, name, nodes)

        return [_reduced(args[0], equation.params["axes"], one)]

    return rule


def _argument(better: str) -> Callable[..., Any]:
    def rule(g: Graph, equation: Any, args: list[Any]) -> list[Any]:
        kind = kind_of(equation.outvars[0].aval.dtype)

        def one(nodes: list[Node]) -> Node:
            best, at = nodes[0], g.const(0, kind)
            for number, node in enumerate(nodes[1:], 1):
                beats = g.op(better, node, best)
                if node.kind == "f":  # the first NaN is taken
                    nan = g.op("and", g.op("ne", node, node), g.op("eq", best, best))
                    beats = g.op("or", beats, nan) if node.nan else beats
                best = g.op("select", beats, node, best)
                at = g.op("select", beats, g.const(number, kind), at)
            return at

        return [_reduced(args[0], equation.params["axes"], one)]

    return rule


def _cumulative(name: str) -> Callable[..., Any]:
    def rule(g: Graph, equation: Any, args: list[Any]) -> list[Any]:
        axis = equation.params["axis"]
        rows = list(np.moveaxis(args[0], axis, 0))
        if equation.params["reverse"]:
            rows.reverse()
        for i in range(1, len(rows)):
            rows[i] = elementwise(
                lambda a, b: g.op(name, a, b), np.asarray(rows[i - 1]), np.asarray(rows[i])
            )
        if equation.params["reverse"]:
            rows.reverse()
        out = np.empty(np.moveaxis(args[0], axis, 0).shape, object)
        for i, row in enumerate(rows):
            out[i] = row if out.ndim > 1 else np.asarray(row, object).reshape(())[()]
        return [np.moveaxis(out, 0, axis)]

    return rule


def dot(g: Graph, equation: Any, args: list[Any]) -> list[Any]:
    """``dot_general``."""
    (lc, rc), (lb, rb) = equation.params["dimension_numbers"]
    left, right = args
    lf = [d for d in range(left.ndim) if d not in (*lc, *lb)]
    rf = [d for d in range(right.ndim) if d not in (*rc, *rb)]
    a, b = left.transpose([*lb, *lf, *lc]), right.transpose([*rb, *rf, *rc])
    batch, rows = len(lb), len(lf)
    count = math.prod(left.shape[d] for d in lc)
    a = a.reshape([*a.shape[: batch + rows], count])
    b = b.reshape([*b.shape[: batch + len(rf)], count])
    out = np.empty(equation.outvars[0].aval.shape, object)
    for index in np.ndindex(*out.shape):
        x, y = a[index[: batch + rows]], b[(*index[:batch], *index[batch + rows :])]
        out[index] = long_sum(g, [g.op("mul", p, q) for p, q in zip(x, y, strict=True)])
    return [out]


#: every reduction by the name of its primitive
REDUCTIONS: dict[str, Callable[..., list[Any]]] = {
    "reduce_sum": _reduction("add", 0),
    "reduce_prod": _reduction("mul", 1),
    "reduce_max": _reduction("max", -math.inf),
    "reduce_min": _reduction("min", math.inf),
    "reduce_and": _reduction("and", True),
    "reduce_or": _reduction("or", False),
    "argmax": _argument("gt"),
    "argmin": _argument("lt"),
    "cumsum": _cumulative("add"),
    "cumprod": _cumulative("mul"),
    "cummax": _cumulative("max"),
    "cummin": _cumulative("min"),
}
