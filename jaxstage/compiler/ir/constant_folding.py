"""Constant folding: an operation on constants is a constant."""

import math

from jaxstage.compiler.ir.operation import Op

#: bits of the integer kinds
_BITS = {"i": 32, "u": 32, "l": 64}


def wrapped(value: int, kind: str) -> int:
    """The integer that a kind holds after overflow: two's complement."""
    bits = _BITS[kind]
    value &= (1 << bits) - 1
    return value - (1 << bits) if kind != "u" and value >> (bits - 1) else value


def fold(op: Op, kind: str, values: list[float], kinds: list[str]) -> float | None:
    """The value of an operation on constants.

    Args:
        op: The operation.
        kind: Kind of the result.
        values: The constants.
        kinds: Their kinds.

    Returns:
        The number, or None where it is left to the program.
    """
    if op.name == "cast":
        return _cast(values[0], kind)
    compute = op.real if kinds[-1] == "f" else op.whole
    if compute is None:
        return None
    try:
        result = compute(*values)
    except (ArithmeticError, ValueError):
        return None
    if isinstance(result, bool) or kind in "fb":
        return result
    return wrapped(int(result), kind)


def _cast(value: float, kind: str) -> float | None:
    """Conversion: reals truncate and saturate, integers wrap."""
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
