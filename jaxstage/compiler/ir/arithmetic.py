"""The value of each operation on Python numbers, with the meaning that it has in JAX.

Reals are IEEE 754 numbers: minimum and maximum hand on NaN and order -0 below +0, rounding keeps
the sign of a zero. Integers are exact here; `constant_folding` makes them wrap. What Python raises
(a division by zero, a logarithm of a negative number, overflow) is left to the program.
"""

import math


def divide(a: float, b: float) -> float:
    """a / b."""
    return a / b


def negative(a: float) -> float:
    """-a."""
    return -a


def sign(a: float) -> float:
    """-1, 0 or 1; a zero and NaN as they are."""
    return a if math.isnan(a) or a == 0 else math.copysign(1.0, a)


def minimum(a: float, b: float) -> float:
    """The smaller one, NaN if one is."""
    if math.isnan(a) or math.isnan(b):
        return math.nan
    return a if a < b or (a == b and math.copysign(1.0, a) < 0) else b


def maximum(a: float, b: float) -> float:
    """The larger one, NaN if one is."""
    return -minimum(-a, -b)


def floor(a: float) -> float:
    """The largest whole number that is not above."""
    return math.copysign(math.floor(a), a)


def ceil(a: float) -> float:
    """The smallest whole number that is not below."""
    return math.copysign(math.ceil(a), a)


def round_half_even(a: float) -> float:
    """The nearest whole number, the even one of two."""
    return math.copysign(round(a), a)


def rsqrt(a: float) -> float:
    """1 / sqrt(a)."""
    return 1 / math.sqrt(a)


def exp2(a: float) -> float:
    """2^a."""
    return 2.0**a


def logistic(a: float) -> float:
    """1 / (1 + exp(-a))."""
    return 1 / (1 + math.exp(-a))


def quotient(a: int, b: int) -> int:
    """Division that truncates, as in C."""
    whole = abs(a) // abs(b)
    return whole if (a < 0) == (b < 0) else -whole


def remainder(a: int, b: int) -> int:
    """What `quotient` leaves; it has the sign of the dividend."""
    return a - b * quotient(a, b)


def magnitude(a: int) -> int:
    """The absolute value."""
    return abs(a)


def whole_sign(a: int) -> int:
    """-1, 0 or 1."""
    return (a > 0) - (a < 0)


def bit_and(a: int, b: int) -> int:
    """Bits, or truth values, that both have."""
    return a & b


def bit_or(a: int, b: int) -> int:
    """Bits, or truth values, that either has."""
    return a | b


def bit_xor(a: int, b: int) -> int:
    """Bits, or truth values, that one has and the other does not."""
    return a ^ b


def invert(a: int) -> int:
    """Logical not of a truth value, all bits of an integer the other way."""
    return not a if isinstance(a, bool) else ~a


def shift_left(a: int, b: int) -> int:
    """Bits moved up; all are gone after the width of the kind."""
    return a << b if b < 64 else 0


def shift_right(a: int, b: int) -> int:
    """Logical shift of a number that is not negative."""
    if a < 0 or b >= 64:
        raise ValueError("left to the program")
    return a >> b


def choose(condition: int, yes: float, no: float) -> float:
    """The first where the condition holds, else the second."""
    return yes if condition else no
