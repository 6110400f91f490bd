"""Interval analysis: bounds of a result, and whether it may be NaN, from those of the arguments.

A rule takes the kind of the result and the arguments. Bounds that leave the kind, or that are NaN,
mean that nothing is known.
"""

import math
from collections.abc import Callable

from jaxstage.compiler.ir.node import LIMITS, Node
from jaxstage.compiler.ir.operation import IntervalRule, Op

Interval = tuple[float, float]
Args = tuple[Node, ...]


def value_range(op: Op, kind: str, args: Args, largest: float) -> tuple[float, float, bool]:
    """Smallest and largest value of an operation, and whether it may be NaN.

    Args:
        op: The operation.
        kind: Kind of the result.
        args: Its arguments.
        largest: The largest finite real; what may exceed it may be infinite.
    """
    low, high = op.interval(kind, args)
    least, most = LIMITS[kind]
    if math.isnan(low) or math.isnan(high):
        low, high = least, most
    if kind == "f":
        nan = any(a.nan for a in args if a.kind == "f") or op.nan(args)
        return (-math.inf if low < -largest else low), (math.inf if high > largest else high), nan
    if low < least or high > most:  # it may wrap around
        low, high = least, most
    return low, high, False


# --- rules ---------------------------------------------------------------------------------------


def between(low: float, high: float) -> IntervalRule:
    """The rule of a function with fixed bounds."""
    return lambda kind, args: (low, high)


def add(kind: str, args: Args) -> Interval:
    """Bounds of x + y."""
    x, y = args
    return x.low + y.low, x.high + y.high


def sub(kind: str, args: Args) -> Interval:
    """Bounds of x - y."""
    x, y = args
    return x.low - y.high, x.high - y.low


def neg(kind: str, args: Args) -> Interval:
    """Bounds of -x."""
    return -args[0].high, -args[0].low


def mul(kind: str, args: Args) -> Interval:
    """Bounds of x y; a square is not negative."""
    x, y = args
    ends = [(p, q) for p in (x.low, x.high) for q in (y.low, y.high)]
    products = [0 if 0 in pair else pair[0] * pair[1] for pair in ends]
    if x is y:
        return 0, max(0, *products)
    return min(products), max(products)


def magnitude(kind: str, args: Args) -> Interval:
    """Bounds of |x|."""
    low, high = args[0].low, args[0].high
    return (0 if low <= 0 <= high else min(abs(low), abs(high))), max(-low, high)


def extreme(pick: Callable[[float, float], float]) -> IntervalRule:
    """The rule of a minimum or maximum."""
    return lambda kind, args: (pick(args[0].low, args[1].low), pick(args[0].high, args[1].high))


def select(kind: str, args: Args) -> Interval:
    """Bounds of either case."""
    return min(args[1].low, args[2].low), max(args[1].high, args[2].high)


def rounded(kind: str, args: Args) -> Interval:
    """Bounds of a whole number beside x."""
    low, high = args[0].low, args[0].high
    below = low if math.isinf(low) else math.floor(low)
    return below, (high if math.isinf(high) else math.ceil(high))


def rem(kind: str, args: Args) -> Interval:
    """Bounds of the remainder by a positive number; it has the sign of the dividend."""
    x, y = args
    if not 0 < y.low <= y.high < math.inf:
        return LIMITS[kind]
    top = y.high if kind == "f" else y.high - 1
    return (0 if x.low >= 0 else -top), (0 if x.high <= 0 else min(top, max(x.high, 0)))


def div(kind: str, args: Args) -> Interval:
    """Bounds of the quotient of integers that are not negative."""
    x, y = args
    if kind == "f" or y.low <= 0 or x.low < 0:
        return LIMITS[kind]
    return x.low // y.high, x.high // y.low


def bits_of(kind: str, args: Args) -> Interval:
    """Bounds of x & mask, for a constant mask that is not negative."""
    mask = args[1]
    known = kind in "iul" and mask.op == "const" and mask.value >= 0
    return (0, mask.value) if known else LIMITS[kind]


def cast(kind: str, args: Args) -> Interval:
    """Bounds of a conversion: reals truncate and saturate, NaN becomes 0."""
    x, (low, high) = args[0], LIMITS[kind]
    if kind == "f" or x.kind != "f":
        return x.low, x.high
    first = low if math.isinf(x.low) else math.trunc(x.low)
    last = high if math.isinf(x.high) else math.trunc(x.high)
    if x.nan:
        first, last = min(first, 0), max(last, 0)
    return min(max(first, low), high), min(max(last, low), high)


# --- NaN -----------------------------------------------------------------------------------------


def never(args: Args) -> bool:
    """A function that makes no NaN."""
    return False


def unless_finite(args: Args) -> bool:
    """What infinite arguments may make NaN."""
    return not all(a.finite for a in args)


def of_negative(args: Args) -> bool:
    """A function that has no value below zero."""
    return args[0].low < 0


def unless_divisible(args: Args) -> bool:
    """A quotient of finite numbers is one unless the divisor may be zero."""
    return unless_finite(args) or args[1].low <= 0 <= args[1].high
