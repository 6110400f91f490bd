"""One scalar operation as a C99 expression, with the meaning it has in JAX.

Maximum and minimum hand on NaN and order -0 below +0; a real that becomes an integer saturates, NaN
gives 0; integers wrap, and one divided by 0 is -1. No expression has undefined behaviour. What C
has no operator for becomes a small function of the file.
"""

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxstage.compiler.ir.graph import LIMITS, Node

#: how tightly an expression binds; one that binds less tightly than its place asks gets brackets
ATOM, UNARY, MUL, ADD, COMPARE, CHOICE = range(6)

#: C type of a kind of number, and the type in which an integer wraps around
TYPES = {"f": "real", "b": "bool", "i": "int32_t", "u": "uint32_t", "l": "int64_t"}
_WRAPPING = {"i": "uint32_t", "u": "uint32_t", "l": "uint64_t"}

_INFIX = {
    "add": ("+", ADD), "sub": ("-", ADD), "mul": ("*", MUL), "div": ("/", MUL), "rem": ("%", MUL),
    "eq": ("==", COMPARE), "ne": ("!=", COMPARE), "lt": ("<", COMPARE), "le": ("<=", COMPARE),
    "gt": (">", COMPARE), "ge": (">=", COMPARE),
}  # fmt: skip

#: logical operators of bool, and those of bits
_LOGIC = {"and": ("&&", "&"), "or": ("||", "|"), "xor": ("!=", "^")}

#: functions of math.h, under their name there
_LIBRARY = {
    **{name: name for name in (
        "floor ceil exp exp2 expm1 log log1p sqrt cbrt sin cos tan asin acos atan sinh cosh tanh "
        "asinh acosh atanh erf atan2 pow").split()},
    "abs": "fabs", "round": "rint", "rem": "fmod",
}  # fmt: skip

#: operation on reals -> head of a small function, and what it returns
_REAL = {
    "max": (
        "real max_real(real a, real b)", "a > b ? a : b > a ? b : a == b && a != 0 ? a : a + b",
    ),
    "min": (
        "real min_real(real a, real b)", "a < b ? a : b < a ? b : a == b && a != 0 ? a : -(-a - b)",
    ),
    "sign": ("real sign_real(real a)", "a > 0 ? (real)1 : a < 0 ? (real)-1 : a"),
    "is_finite": ("bool is_finite(real a)", "a - a == 0"),
    "logistic": ("real logistic(real a)", "1 / (1 + exp(-a))"),
    "rsqrt": ("real reciprocal_root(real a)", "1 / sqrt(a)"),
}  # fmt: skip

#: the same for integers of type T, which wrap in the type U
_WHOLE = {
    "max": ("T max_T(T a, T b)", "a > b ? a : b"),
    "min": ("T min_T(T a, T b)", "a < b ? a : b"),
    "sign": ("T sign_T(T a)", "(a > 0) - (a < 0)"),
    "abs": ("T abs_T(T a)", "a > 0 ? a : (T)((U)0 - (U)a)"),
    "neg": ("T neg_T(T a)", "(T)((U)0 - (U)a)"),
    "add": ("T add_T(T a, T b)", "(T)((U)a + (U)b)"),
    "sub": ("T sub_T(T a, T b)", "(T)((U)a - (U)b)"),
    "mul": ("T mul_T(T a, T b)", "(T)((U)a * (U)b)"),
    "shl": ("T shl_T(T a, T b)", "(U)b < 8 * sizeof a ? (T)((U)a << b) : 0"),
    "shr": ("T shr_T(T a, T b)", "(U)b < 8 * sizeof a ? (T)((U)a >> b) : 0"),
}
_SIGNED = {
    "div": ("T div_T(T a, T b)", "b == 0 ? -1 : b == -1 ? (T)((U)0 - (U)a) : a / b"),
    "rem": ("T rem_T(T a, T b)", "b == 0 ? a : b == -1 ? 0 : a % b"),
}
_UNSIGNED = {
    "div": ("T div_T(T a, T b)", "b == 0 ? (T)-1 : a / b"),
    "rem": ("T rem_T(T a, T b)", "b == 0 ? a : a % b"),
}

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
    """An operation on expressions. helpers: gets the small functions that it calls, by name.

    Raises ValueError for an operation that C99 does not have.
    """
    name, kind = node.op, _working_kind(node)
    reads = frozenset[str]().union(*(arg.reads for arg in args))
    plain = kind in "fb" or _stays_in_range(node)
    if name in _INFIX and plain and not (name == "rem" and kind == "f"):
        sign, level = _INFIX[name]
        left = bracketed(args[0], min(level, ADD))
        return Text(f"{left} {sign} {bracketed(args[1], level - 1)}", level, reads)
    if name in _LOGIC:
        sign = _LOGIC[name][kind != "b"]
        return Text(
            f"{bracketed(args[0], UNARY)} {sign} {bracketed(args[1], UNARY)}", COMPARE, reads
        )
    if name == "select":
        test, yes = (bracketed(arg, COMPARE) for arg in args[:2])
        return Text(f"{test} ? {yes} : {args[2].text}", CHOICE, reads)
    if name == "not" or (name == "neg" and plain):
        sign = "-" if name == "neg" else "!" if kind == "b" else "~"
        return Text(f"{sign}{bracketed(args[0], ATOM)}", UNARY, reads)
    if name == "cast" and kind == kind_of(node):
        return Text(args[0].text, args[0].level, reads)
    if name == "cast" and (kind != "f" or _fits(node)):
        return Text(f"({TYPES[kind_of(node)]}){bracketed(args[0], ATOM)}", UNARY, reads)
    called = _LIBRARY.get(name) if kind == "f" else None
    if called is not None:
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
        own = _REAL if kind == "f" else _WHOLE | (_UNSIGNED if kind == "u" else _SIGNED)
        if node.op not in own or kind == "b":
            raise ValueError(f"the operation '{node.op}' has no C text")
        head, value = own[node.op]
        if kind != "f":
            head, value = _typed(head, kind), _typed(value, kind)
        elif single:
            value = re.sub(r"\b(exp|sqrt)\(", r"\1f(", value)
    name = head.partition("(")[0].split()[1]
    return name, f"static {head}\n{{\n    return {value};\n}}\n"


def _typed(text: str, kind: str) -> str:
    """A text on T and U with their types."""
    text = re.sub(r"\bT\b", TYPES[kind], text.replace("(U)", f"({_WRAPPING[kind]})"))
    return re.sub(r"_T\b", f"_{TYPES[kind]}", text)
