"""Algebraic simplification: operations that are equal to something simpler.

A rule takes the graph, the kind of the result and the arguments, and gives a node or None. Values
are kept to the bit, NaN and infinity too, with one licence that XLA takes as well: a zero may come
out with the other sign (``x + 0`` is ``x``).
"""

import math
from typing import TYPE_CHECKING

from jaxstage.compiler.ir.node import LIMITS, Node
from jaxstage.compiler.ir.operation import Rewrite

if TYPE_CHECKING:
    from jaxstage.compiler.ir.graph import Graph

Args = tuple[Node, ...]


def _is(node: Node, number: float) -> bool:
    return node.op == "const" and node.value == number and not (number == 0 and _negative(node))


def _negative(node: Node) -> bool:
    return node.kind == "f" and math.copysign(1.0, node.value) < 0


def add(g: "Graph", kind: str, a: Args) -> Node | None:
    """x + y: constants of integers together, subtraction, and sums of selections as one."""
    x, y = a
    if _zero(x):
        return y
    if _zero(y):
        return x
    if kind in "il" and y.op == "const":
        if x.op == "add" and x.args[1].op == "const":
            return g.op("add", x.args[0], g.op("add", x.args[1], y))
    if kind in "il" and x.op == "const":
        return g.op("add", y, x)
    if x.op == "neg" and y.op != "neg":
        return g.op("sub", y, x.args[0])
    if y.op == "neg":
        return g.op("sub", x, y.args[0])
    if x.op == y.op == "select":
        return _joined(g, x, y)
    return None


def _zero(node: Node) -> bool:
    return node.op == "const" and node.value == 0


def _joined(g: "Graph", x: Node, y: Node) -> Node | None:
    """(c ? 0 : p) + (c ? q : 0) = c ? q : p."""
    if x.args[0] is not y.args[0]:
        return None
    if _zero(x.args[1]) and _zero(y.args[2]):
        return g.op("select", x.args[0], y.args[1], x.args[2])
    if _zero(x.args[2]) and _zero(y.args[1]):
        return g.op("select", x.args[0], x.args[1], y.args[2])
    return None


def sub(g: "Graph", kind: str, a: Args) -> Node | None:
    """x - y."""
    x, y = a
    if _zero(y):
        return x
    if kind in "il" and y.op == "const" and y.value > -(2**31):
        return g.op("add", x, g.const(-y.value, kind))
    if _zero(x) and kind == "f":
        return g.op("neg", y)
    if y.op == "neg":
        return g.op("add", x, y.args[0])
    if x is y and (kind != "f" or x.finite):
        return g.const(0, kind)
    return None


def mul(g: "Graph", kind: str, a: Args) -> Node | None:
    """x y; a zero only where the other is finite."""
    for x, y in (a, a[::-1]):
        if _is(x, 1):
            return y
        if _is(x, -1) and kind == "f":
            return g.op("neg", y)
        if _zero(x) and (kind != "f" or y.finite):
            return g.const(0, kind)
        if x.op == "neg" and kind == "f":
            return g.op("neg", g.op("mul", x.args[0], y))
    return None


def div(g: "Graph", kind: str, a: Args) -> Node | None:
    """x / y; a power of two is a product."""
    x, y = a
    if _is(y, 1):
        return x
    if _zero(x) and kind == "f" and not y.nan and (y.low > 0 or y.high < 0):
        return x
    if kind == "f" and y.op == "const" and y.value and math.frexp(y.value)[0] in (0.5, -0.5):
        return g.op("mul", x, g.const(1 / y.value, "f"))
    return None


def neg(g: "Graph", kind: str, a: Args) -> Node | None:
    """-x."""
    x = a[0]
    if x.op == "neg":
        return x.args[0]
    if x.op == "sub":
        return g.op("sub", x.args[1], x.args[0])
    return None


def select(g: "Graph", kind: str, a: Args) -> Node | None:
    """The case of a constant condition; nested selections and truth values as logic."""
    c, yes, no = a
    if c.op == "const":
        return yes if c.value else no
    if yes is no:
        return yes
    if c.op == "not":
        return g.op("select", c.args[0], no, yes)
    if kind == "b" and yes.op == "const":
        return g.op("or", c, no) if yes.value else g.op("and", g.op("not", c), no)
    if kind == "b" and no.op == "const":
        return g.op("or", g.op("not", c), yes) if no.value else g.op("and", c, yes)
    if yes.op == "select" and yes.args[2] is no:
        return g.op("select", g.op("and", yes.args[0], c), yes.args[1], no)
    if yes.op == "select" and yes.args[0] is c:
        return g.op("select", c, yes.args[1], no)
    if no.op == "select" and no.args[0] is c:
        return g.op("select", c, yes, no.args[2])
    return None


def both(g: "Graph", kind: str, a: Args) -> Node | None:
    """Conjunction of truth values."""
    if kind != "b":
        return None
    for x, y in (a, a[::-1]):
        if x.op == "const":
            return y if x.value else x
    return a[0] if a[0] is a[1] else None


def either(g: "Graph", kind: str, a: Args) -> Node | None:
    """Disjunction of truth values."""
    if kind == "b":
        for x, y in (a, a[::-1]):
            if x.op == "const":
                return x if x.value else y
        return a[0] if a[0] is a[1] else None
    return None


def negation(g: "Graph", kind: str, a: Args) -> Node | None:
    """Double negation."""
    return a[0].args[0] if a[0].op == "not" else None


def cast(g: "Graph", kind: str, a: Args) -> Node | None:
    """A conversion to the own kind, to a truth value, or there and back without loss."""
    x = a[0]
    if x.kind == kind:
        return x
    if kind == "b":
        return g.op("ne", x, g.const(0, x.kind))
    if x.op == "cast" and x.args[0].kind == kind and kind in "iul" and x.kind in "iul":
        inner = x.args[0]  # there and back, without loss
        if inner.low >= LIMITS[x.kind][0] and inner.high <= LIMITS[x.kind][1]:
            return inner
    return None


def is_finite(g: "Graph", kind: str, a: Args) -> Node | None:
    """What is known to be finite, and what is as finite as its part."""
    x = a[0]
    if x.finite or x.kind != "f":
        return g.const(True, "b")
    if x.op in ("neg", "abs"):
        return g.op("is_finite", x.args[0])
    if x.op == "max":
        for p, q in (x.args, x.args[::-1]):
            if p.finite and q.low > -math.inf:
                return g.op("is_finite", q)
    if x.op == "select":
        yes, no = (g.op("is_finite", y) for y in x.args[1:])
        if _is(no, 1):
            return g.op("or", g.op("not", x.args[0]), yes)
        if _is(yes, 1):
            return g.op("or", x.args[0], no)
    return None


def comparison(name: str) -> Rewrite:
    """The rule of ``lt``, ``le``, ``eq`` or ``ne``: decided where the bounds tell."""

    def rule(g: "Graph", kind: str, a: Args) -> Node | None:
        x, y = a
        if x.nan or y.nan:
            return None
        if name == "eq" and x is y:
            return g.const(True, "b")
        if name == "eq" and kind == "b" and y.op == "const" and _chosen(x):
            return _which(g, x, y.value)
        if name == "lt":
            sure, never = x.high < y.low, x.low >= y.high
        elif name == "le":
            sure, never = x.high <= y.low, x.low > y.high
        elif name == "eq":
            sure, never = False, x.high < y.low or x.low > y.high
        else:
            sure, never = x.high < y.low or x.low > y.high, False
        return g.const(sure, "b") if sure or never else None

    return rule


def _chosen(node: Node) -> bool:
    return node.op == "select" and node.kind != "f" and all(n.op == "const" for n in node.args[1:])


def _which(g: "Graph", node: Node, value: float) -> Node:
    """(c ? p : q) == value, for constants p and q."""
    yes, no = (n.value == value for n in node.args[1:])
    return g.op("select", node.args[0], g.const(yes, "b"), g.const(no, "b"))


def flipped(name: str) -> Rewrite:
    """The rule of ``gt`` and ``ge``: the other comparison with its arguments exchanged."""
    return lambda g, kind, a: g.op(name, a[1], a[0])


def maximum(g: "Graph", kind: str, a: Args) -> Node | None:
    """The larger one, where the bounds tell."""
    for x, y in (a, a[::-1]):
        if x is y or (x.low >= y.high and not y.nan):
            return x
    return None


def minimum(g: "Graph", kind: str, a: Args) -> Node | None:
    """The smaller one, where the bounds tell."""
    for x, y in (a, a[::-1]):
        if x is y or (x.high <= y.low and not y.nan):
            return x
    return None


def rem(g: "Graph", kind: str, a: Args) -> Node | None:
    """The remainder of what is smaller than the divisor."""
    x, y = a
    return x if kind != "f" and x.low >= 0 and x.high < y.low else None
