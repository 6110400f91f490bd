"""One operation in C++, see ``simd.h``."""

import math
from collections.abc import Callable

from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.node import LIMITS, Node
from jaxstage.compiler.ir.operation import Cxx
from jaxstage.compiler.ir.ops import OPS


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
    """The operation on named arguments.

    Raises:
        LoweringError: There is no vector code for it.
    """
    if node.kind == "l" and single and not _fits(node):
        raise LoweringError("64-bit integers in single precision")
    special = _SPECIAL.get(node.op)
    if special is not None:
        return special(node, args, single)
    form, kinds = OPS[node.op].cxx or Cxx(), {a.kind for a in node.args}
    if "b" in kinds:
        return form.truth.format(*args) if form.truth else _refuse(node)
    if kinds == {"u"} and single and node.op in _UNSIGNED:
        return _UNSIGNED[node.op].format(*args)
    if node.op in ("div", "rem") and node.kind != "f":
        return _divided(node, args)
    if not form.text:
        return _refuse(node)
    return _wrapped(node, form.text.format(*args))


#: comparisons of unsigned integers where a lane is no wider than they are
_UNSIGNED = {
    "lt": "below({0}, {1})",
    "gt": "below({1}, {0})",
    "le": "none(below({1}, {0}))",
    "ge": "none(below({0}, {1}))",
}


def _refuse(node: Node) -> str:
    raise LoweringError(f"no vector code for '{node.op}'")


def _fits(node: Node) -> bool:
    low, high = LIMITS["i"]
    return low <= node.low and node.high <= high


def _wrapped(node: Node, text: str) -> str:
    """With the overflow of its kind, where there can be one."""
    may_wrap = OPS[node.op].wraps and (node.low, node.high) == LIMITS[node.kind]
    if node.kind in "iu" and may_wrap:
        return f"to_{'u' if node.kind == 'u' else ''}int32({text})"
    return text


def _extreme(node: Node, args: list[str], single: bool) -> str:
    first, second = node.args
    if node.kind == "f" and first.nan and second.nan:
        name = "smaller" if node.op == "min" else "larger"
        return f"{name}_or_nan({', '.join(args)})"
    if node.kind == "f" and first.nan:
        args = args[::-1]
    return (OPS[node.op].cxx or Cxx()).text.format(*args)


def _select(node: Node, args: list[str], single: bool) -> str:
    name = _chosen_by_size(node)
    if name:
        return f"{name}({', '.join(args[1:])})"
    return f"pick({', '.join(args)}{', 0' if node.kind == 'b' else ''})"


def _exp(node: Node, args: list[str], single: bool) -> str:
    name = "exponential_below" if node.args[0].high <= 88 else "exponential"
    return f"{name}({args[0]})"


def _chosen_by_size(node: Node) -> str | None:
    """``x <= low ? low : x`` is the larger of both; of NaN it is x, the second operand, too."""
    which, yes, no = node.args
    if node.kind != "f" or which.op not in ("lt", "le"):
        return None
    names = {(no.id, yes.id): "larger", (yes.id, no.id): "smaller"}
    return names.get((which.args[0].id, which.args[1].id))


def _cast(node: Node, args: list[str], single: bool) -> str:
    source, kind, text = node.args[0], node.kind, args[0]
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
    most = int(high)
    top = 2147483520 if single else min(most, 2**63 - 1024)  # the largest real not above
    edge = f", {_whole(most)}" if top < most else ""
    return f"truncated({text}, (real){low}, (real){top}{edge})"


def _divided(node: Node, args: list[str]) -> str:
    """Quotient or remainder of integers."""
    dividend, divisor = node.args
    name = "quotient" if node.op == "div" else "remainder"
    if name == "remainder" and node.kind == "u":
        return _refuse(node)
    unsigned = "_unsigned" if node.kind == "u" else ""
    if divisor.low <= 0:
        text = f"{name}{unsigned}_by_any({args[0]}, {args[1]})"
        return f"to_int32({text})" if node.kind == "i" else text
    if name == "remainder":
        return f"remainder_of({args[0]}, {args[1]})"
    if divisor.op == "const" and dividend.low >= 0:
        shift = divisor.value.bit_length() - 1
        if divisor.value == 1 << shift:
            return f"shifted_right({args[0]}, same({shift}))"
    return f"quotient{unsigned}({args[0]}, {args[1]})"


def _shift(node: Node, args: list[str], single: bool) -> str:
    """A logical shift; one by more than the width leaves nothing."""
    value, by = node.args
    width = 64 if node.kind == "l" and not single else 32
    if 0 <= by.low <= by.high < width and (node.op == "shl" or value.low >= 0):
        text = (OPS[node.op].cxx or Cxx()).text.format(*args)
    else:
        name = "shifted_left" if node.op == "shl" else "shifted_right"
        text = f"{name}_by_any({args[0]}, {args[1]}, {width})"
    return _wrapped(node, text)


#: operations whose text depends on what is known of their arguments
_SPECIAL: dict[str, Callable[[Node, list[str], bool], str]] = {
    "select": _select,
    "cast": _cast,
    "exp": _exp,
    "min": _extreme,
    "max": _extreme,
    "shl": _shift,
    "shr": _shift,
}
