"""One scalar operation as a C99 expression, with the meaning it has in JAX.

Maximum and minimum hand on NaN and order -0 below +0; a real that becomes an integer saturates, NaN
gives 0; integers wrap, and one divided by 0 is -1. No expression has undefined behaviour. What C
has no operator for becomes a small function of the file.
"""

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.node import LIMITS, Node
from jaxstage.compiler.ir.operation import C99
from jaxstage.compiler.ir.ops import OPS

#: how tightly an expression binds; one that binds less tightly than its place asks gets brackets
ATOM, UNARY, MUL, ADD, COMPARE, CHOICE = range(6)

#: C type of a kind of number, and the type in which an integer wraps around
TYPES = {"f": "real", "b": "bool", "i": "int32_t", "u": "uint32_t", "l": "int64_t"}
_WRAPPING = {"i": "uint32_t", "u": "uint32_t", "l": "uint64_t"}

#: how tightly each operator binds
_BINDING = {"+": ADD, "-": ADD, "*": MUL, "/": MUL, "%": MUL} | dict.fromkeys(
    ("==", "!=", "<", "<=", ">", ">="), COMPARE
)

#: least and largest integer of a kind as C text, and the power of two above the largest
_EDGES = {
    "i": ("INT32_MIN", "INT32_MAX", "2147483648.0"),
    "l": ("INT64_MIN", "INT64_MAX", "9223372036854775808.0"),
    "u": ("0", "UINT32_MAX", "4294967296.0"),
}


class Text(NamedTuple):
    """An expression: how tightly it binds, and the inputs it reads."""

    text: str
    level: int = ATOM
    reads: frozenset[str] = frozenset()


def number(value: Any, kind: str, single: bool) -> str:
    """A constant as C text, exact in its precision."""
    if kind == "b":
        return "true" if value else "false"
    if kind == "u":
        return f"{int(value)}u"
    if kind in "il":
        least = {-(2**31): "INT32_MIN", -(2**63): "INT64_MIN"}
        plain = str(int(value)) if kind == "i" else f"INT64_C({int(value)})"
        return least.get(value, plain)
    value = np.float32(value) if single else np.float64(value)
    if np.isnan(value):
        return "NAN"
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    text = str(value)
    text = text if "." in text or "e" in text else f"{text}.0"
    return f"{text}f" if single else text


def wrapped(items: Sequence[str], margin: str) -> list[str]:
    """Items, each with a comma, in lines."""
    lines = [margin]
    for item in items:
        if len(lines[-1]) + len(item) > 95 and lines[-1].strip():
            lines.append(margin)
        lines[-1] += f"{item}, "
    return [line.rstrip() for line in lines]


def kind_of(node: Node) -> str:
    """The kind of number that C needs for a node: 32 bits where its range allows it."""
    low, high = LIMITS["i"]
    return "i" if node.kind == "l" and low < node.low and node.high < high else node.kind


def constant(node: Node, single: bool) -> Text:
    """A node `const` as an expression."""
    text = number(node.value, kind_of(node), single)
    return Text(text, UNARY if text.startswith("-") else ATOM)


def bracketed(part: Text, loosest: int) -> str:
    """The expression as part of another one, in brackets where it binds less than ``loosest``."""
    return part.text if part.level <= loosest else f"({part.text})"


def operation(node: Node, args: Sequence[Text], single: bool, helpers: dict[str, str]) -> Text:
    """An operation on expressions.

    Args:
        node: The operation.
        args: Text of its arguments.
        single: Whether reals are floats.
        helpers: Gets the small functions that it calls, by name.

    Raises:
        LoweringError: C99 does not have it.
    """
    form, kind = OPS[node.op].c99 or C99(), _working_kind(node)
    reads = frozenset[str]().union(*(arg.reads for arg in args))
    plain = kind in "fb" or _stays_in_range(node)
    if node.op == "select":
        test, yes = (bracketed(arg, COMPARE) for arg in args[:2])
        return Text(f"{test} ? {yes} : {args[2].text}", CHOICE, reads)
    if node.op == "cast" and kind == kind_of(node):
        return Text(args[0].text, args[0].level, reads)
    if node.op == "cast" and (kind != "f" or _fits(node)):
        return Text(f"({TYPES[kind_of(node)]}){bracketed(args[0], ATOM)}", UNARY, reads)
    if form.infix and plain and not (form.library and kind == "f"):
        level = _BINDING[form.infix]
        left = bracketed(args[0], min(level, ADD))
        return Text(f"{left} {form.infix} {bracketed(args[1], level - 1)}", level, reads)
    sign = form.logic[kind != "b"]
    if sign:
        sides = f" {sign} ".join(bracketed(arg, UNARY) for arg in args)
        return Text(sides, COMPARE, reads)
    sign = form.prefix[kind == "b"]
    if sign and (plain or not form.whole):
        return Text(f"{sign}{bracketed(args[0], ATOM)}", UNARY, reads)
    called = form.library if kind == "f" else ""
    if called:
        called += "f" if single else ""
    else:
        called, text = _helper(node, kind, single)
        helpers[called] = text
    return Text(f"{called}({', '.join(arg.text for arg in args)})", ATOM, reads)


#: min(high, max(low, a)), most often a
_CLAMP = (
    "static real clamp_real(real low, real a, real high)\n{\n"
    "    return low < a && a < high ? a : min_real(high, max_real(low, a));\n}\n"
)


def clamped(node: Node, args: Sequence[Text], single: bool, helpers: dict[str, str]) -> Text:
    """min(high, max(low, a)), of which the node is the minimum. args: low, a, high."""
    for part in (next(arg for arg in node.args if arg.op == "max"), node):
        name, text = _helper(part, "f", single)
        helpers[name] = text
    helpers["clamp_real"] = helpers.pop("clamp_real", _CLAMP)
    reads = frozenset[str]().union(*(arg.reads for arg in args))
    return Text(f"clamp_real({', '.join(arg.text for arg in args)})", ATOM, reads)


def _working_kind(node: Node) -> str:
    """The kind in which an operation is done: the widest of what goes in and comes out."""
    args = node.args[1:] if node.op == "select" else node.args
    kinds = {kind_of(arg) for arg in args}
    if node.op in ("cast", "is_finite") or "f" in kinds or "l" not in kinds | {kind_of(node)}:
        return kind_of(node.args[-1])
    return "l"


def _stays_in_range(node: Node) -> bool:
    """Whether an operation on integers can be the plain one: it neither wraps nor divides by 0."""
    if _working_kind(node) == "l":  # its arguments may be narrower
        return node.kind == "b"
    if node.op in ("div", "rem"):
        return node.args[1].low > 0
    return node.kind == "b" or (node.low, node.high) != LIMITS[node.kind]


def _fits(node: Node) -> bool:
    """Whether a real can be cast as it is."""
    inner, (low, high) = node.args[0], LIMITS[kind_of(node)]
    return node.kind == "f" or (not inner.nan and low < inner.low and inner.high < high)


def _helper(node: Node, kind: str, single: bool) -> tuple[str, str]:
    """Name and text of the small function for an operation."""
    if node.op == "cast":
        least, most, above = _EDGES[kind_of(node)]
        whole = TYPES[kind_of(node)]
        head = f"{whole} to_{whole}(real a)"
        value = (
            f"a >= {above}{'f' if single else ''} ? {most} : a > {least} ? ({whole})a : "
            f"a < 0 ? {least} : 0"
        )
    else:
        head, value = _function(node, kind)
        if kind == "f" and single:
            value = re.sub(r"\b(exp|sqrt)\(", r"\1f(", value)
    name = head.partition("(")[0].split()[1]
    return name, f"static {head}\n{{\n    return {value};\n}}\n"


def _function(node: Node, kind: str) -> tuple[str, str]:
    """Signature and result of the small function for an operation on numbers of a kind."""
    form = OPS[node.op].c99 or C99()
    if kind == "f" and form.real[0]:
        return form.real
    value = form.unsigned if kind == "u" and form.unsigned else form.whole
    if kind in "fb" or not value:
        raise LoweringError(f"the operation '{node.op}' has no C text")
    arguments = "T a" if len(node.args) == 1 else "T a, T b"
    return _typed(f"T {node.op}_T({arguments})", kind), _typed(value, kind)


def _typed(text: str, kind: str) -> str:
    """A text on T and U with their types."""
    text = re.sub(r"\bT\b", TYPES[kind], text.replace("(U)", f"({_WRAPPING[kind]})"))
    return re.sub(r"_T\b", f"_{TYPES[kind]}", text)
