"""Operations on constants, with the meaning they have in JAX."""

import math
from typing import Any

#: bits of the integer kinds
_BITS = {"i": 32, "u": 32, "l": 64}


def wrapped(value: int, kind: str) -> int:
    """The integer that a kind holds after overflow."""
    bits = _BITS[kind]
    value &= (1 << bits) - 1
    return value - (1 << bits) if kind != "u" and value >> (bits - 1) else value


def fold(name: str, kind: str, values: list[Any], kinds: list[str]) -> Any:
    """The value of an operation on constants, or None where it is left to the program."""
    if kinds[-1] == "f":
        compute = _REAL.get(name)
    else:
        compute = _WHOLE.get(name)
    if name == "select":
        return values[1] if values[0] else values[2]
    if name == "cast":
        return _cast(values[0], kind)
    if compute is None:
        return None
    try:
        result = compute(*values)
    except (ArithmeticError, ValueError):
        return None
    if isinstance(result, bool) or kind in "fb":
        return result
    return wrapped(result, kind)


def _cast(value: Any, kind: str) -> Any:
    if kind == "f":
        return float(value)
    if kind == "b":
        return bool(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        limit = 1 << (_BITS[kind] - (kind != "u"))
        low = 0 if kind == "u" else -limit
        return min(max(math.trunc(value), low), limit - 1)
    return wrapped(int(value), kind)


def _rounded(value: float) -> float:
    return float(round(value))


def _quotient(a: int, b: int) -> int:
    whole = abs(a) // abs(b)
    return whole if (a < 0) == (b < 0) else -whole


_COMPARE: dict[str, Any] = {
    "eq": lambda a, b: a == b, "ne": lambda a, b: a != b, "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b, "gt": lambda a, b: a > b, "ge": lambda a, b: a >= b,
}  # fmt: skip


def _pick(choose: Any) -> Any:
    return lambda a, b: math.nan if math.isnan(a) or math.isnan(b) else choose(a, b)


_REAL: dict[str, Any] = {
    **_COMPARE,
    "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b, "neg": lambda a: -a, "abs": abs,
    "sign": lambda a: a if math.isnan(a) else float((a > 0) - (a < 0)),
    "min": _pick(min), "max": _pick(max), "rem": math.fmod, "pow": math.pow,
    "atan2": math.atan2, "floor": lambda a: float(math.floor(a)),
    "ceil": lambda a: float(math.ceil(a)), "round": _rounded, "is_finite": math.isfinite,
    **{f: getattr(math, f) for f in ("exp", "expm1", "log", "log1p", "sqrt", "sin", "cos", "tan",
                                     "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh",
                                     "acosh", "atanh", "erf")},
    "rsqrt": lambda a: 1 / math.sqrt(a), "exp2": lambda a: 2.0**a,
    "logistic": lambda a: 1 / (1 + math.exp(-a)),
}  # fmt: skip

_WHOLE: dict[str, Any] = {
    **_COMPARE,
    "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b,
    "div": _quotient, "rem": lambda a, b: a - b * _quotient(a, b), "neg": lambda a: -a, "abs": abs,
    "sign": lambda a: (a > 0) - (a < 0), "min": min, "max": max,
    "and": lambda a, b: a & b, "or": lambda a, b: a | b, "xor": lambda a, b: a ^ b,
    "not": lambda a: not a if isinstance(a, bool) else ~a,
    "shl": lambda a, b: a << b if b < 64 else 0,
    "shr": lambda a, b: a >> b if a >= 0 and b < 64 else None,
}  # fmt: skip
