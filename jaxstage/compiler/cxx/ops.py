"""One operation in C++, see ``simd.h``."""

import math

from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.node import LIMITS, Node

_SAME = {
    "eq": "eq", "ne": "ne", "lt": "lt", "le": "le", "gt": "gt", "ge": "ge", "abs": "magnitude",
    "sign": "sign", "floor": "floored", "ceil": "ceiled", "round": "rounded", "sqrt": "root",
    "rsqrt": "inverse_root", "tanh": "hyperbolic_tangent", "logistic": "logistic",
    "expm1": "exponential_less_one", "is_finite": "finite",
    **{f: f"f_{f}" for f in ("log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "sinh",
                             "cosh", "asinh", "acosh", "atanh", "exp2", "cbrt", "erf", "pow",
                             "atan2")},
}  # fmt: skip
_SIGNS = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
_LOGIC = {"and": "both", "or": "either", "xor": "differ", "not": "none"}


def constant(node: Node) -> str:
    """A constant in all lanes."""
    if node.kind == "b":
        return f"every({'true' if node.value else 'false'})"
    if node.kind != "f":
        return f"same({_whole(node.value)})"
    return f"all({number(node.value)})"


def _whole(value: int) -> str:
    return "INT64_MIN" if value == LIMITS["l"][0] else f"(whole){value}LL"


def number(value: float) -> str:
    """A real."""
    if math.isnan(value):
        return "(real)NAN"
    if math.isinf(value):
        return f"({'-' if value < 0 else ''}(real)INFINITY)"
    return f"(real){value!r}"


def expression(node: Node, args: list[str], single: bool) -> str:
    """The operation on named arguments. Raises LoweringError where there is no such code."""
    if node.kind == "l" and single and not _fits(node):
        raise LoweringError("64-bit integers in single precision")
    if node.op in _LOGIC and node.kind == "b":
        return f"{_LOGIC[node.op]}({', '.join(args)})"
    if node.op == "select":
        name = _chosen_by_size(node)
        if name:
            return f"{name}({', '.join(args[1:])})"
        return f"pick({', '.join(args)}{', 0' if node.kind == 'b' else ''})"
    if node.op == "cast":
        return _cast(node, args[0], single)
    if node.op == "exp":
        name = "exponential_below" if node.args[0].high <= 88 else "exponential"
        return f"{name}({args[0]})"
    if node.op in ("min", "max"):
        return _extreme(node, args)
    if any(a.kind == "b" for a in node.args):
        return _of_truths(node, args)
    if node.op in ("lt", "le", "gt", "ge") and node.args[0].kind == "u" and single:
        a, b = args
        forms = {"lt": f"below({a}, {b})", "gt": f"below({b}, {a})",
                 "le": f"none(below({b}, {a}))", "ge": f"none(below({a}, {b}))"}  # fmt: skip
        return forms[node.op]
    if node.op in _SAME:
        return f"{_SAME[node.op]}({', '.join(args)})"
    if node.op == "neg":
        return _wrapped(node, f"-{args[0]}")
    if node.op == "rem":
        return f"remainder_of({args[0]}, {args[1]})" if node.kind != "u" else _refuse(node)
    if node.op == "div" and node.kind != "f":
        return _quotient(node, args)
    if node.op in _SIGNS:
        return _wrapped(node, f"{args[0]} {_SIGNS[node.op]} {args[1]}")
    return _bits(node, args)


def _refuse(node: Node) -> str:
    raise LoweringError(f"no vector code for '{node.op}'")


def _fits(node: Node) -> bool:
    low, high = LIMITS["i"]
    return low <= node.low and node.high <= high


def _wrapped(node: Node, text: str) -> str:
    """With the overflow of its kind, where there can be one."""
    if node.kind in "iu" and (node.low, node.high) == LIMITS[node.kind]:
        return f"to_{'u' if node.kind == 'u' else ''}int32({text})"
    return text


def _extreme(node: Node, args: list[str]) -> str:
    name = "smaller" if node.op == "min" else "larger"
    first, second = node.args
    if node.kind == "f" and first.nan and second.nan:
        return f"{name}_or_nan({', '.join(args)})"
    if node.kind == "f" and first.nan:
        args = args[::-1]
    return f"{name}({', '.join(args)})"


def _chosen_by_size(node: Node) -> str | None:
    """``x <= low ? low : x`` is the larger of both; of NaN it is x, the second operand, too."""
    which, yes, no = node.args
    if node.kind != "f" or which.op not in ("lt", "le"):
        return None
    names = {(no.id, yes.id): "larger", (yes.id, no.id): "smaller"}
    return names.get((which.args[0].id, which.args[1].id))


def _of_truths(node: Node, args: list[str]) -> str:
    if node.op == "eq":
        return f"none(differ({', '.join(args)}))"
    if node.op == "ne":
        return f"differ({', '.join(args)})"
    return _refuse(node)


def _cast(node: Node, text: str, single: bool) -> str:
    source, kind = node.args[0], node.kind
    if source.kind == "b":
        return f"as_real({text})" if kind == "f" else f"as_ints({text})"
    if kind == "f":
        return f"to_real_unsigned({text})" if source.kind == "u" and single else f"to_real({text})"
    if source.kind != "f":
        return f"to_{'u' if kind == 'u' else ''}int32({text})" if kind in "iu" else text
    low, high = LIMITS[kind]
    if kind == "u" and single:
        return _refuse(node)
    if low <= source.low and source.high <= high:
        return f"truncated(or_zero({text}))"  # a lost run may hold NaN, and this be an index
    top = 2147483520 if single else min(high, 2**63 - 1024)  # the largest real below the limit
    return f"truncated({text}, (real){low}, (real){top})"


def _quotient(node: Node, args: list[str]) -> str:
    divisor = node.args[1]
    if divisor.op == "const" and node.args[0].low >= 0:
        shift = divisor.value.bit_length() - 1
        if divisor.value == 1 << shift:
            return f"shifted_right({args[0]}, same({shift}))"
    return f"quotient{'_unsigned' if node.kind == 'u' else ''}({args[0]}, {args[1]})"


def _bits(node: Node, args: list[str]) -> str:
    signs = {"and": "&", "or": "|", "xor": "^", "shl": "<<"}
    if node.op in signs:
        return _wrapped(node, f"{args[0]} {signs[node.op]} {args[1]}")
    if node.op == "not":
        return _wrapped(node, f"~{args[0]}")
    if node.op == "shr":
        return f"shifted_right({args[0]}, {args[1]})"
    return _refuse(node)
