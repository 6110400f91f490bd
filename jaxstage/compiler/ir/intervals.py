"""The range of a result, from the ranges of its arguments."""

import math

from jaxstage.compiler.ir.node import LIMITS, Node


def value_range(
    name: str, kind: str, a: tuple[Node, ...], largest: float
) -> tuple[float, float, bool]:
    """Smallest and largest value of an operation, and whether it may be NaN."""
    low, high = _bounds(name, kind, a)
    nan = kind == "f" and _may_be_nan(name, a)
    limits = LIMITS[kind]
    if kind == "f":
        if math.isnan(low) or math.isnan(high):
            low, high = limits
        return (-math.inf if low < -largest else low), (math.inf if high > largest else high), nan
    if math.isnan(low) or math.isnan(high) or low < limits[0] or high > limits[1]:
        low, high = limits  # it may wrap around
    return low, high, False


def _products(x: Node, y: Node) -> list[float]:
    return [0 if 0 in (p, q) else p * q for p in (x.low, x.high) for q in (y.low, y.high)]


def _bounds(name: str, kind: str, a: tuple[Node, ...]) -> tuple[float, float]:
    x, y = a[0], a[-1]
    if name == "add":
        return x.low + y.low, x.high + y.high
    if name == "sub":
        return x.low - y.high, x.high - y.low
    if name == "neg":
        return -x.high, -x.low
    if name == "mul":
        every = [0.0, *_products(x, x)] if x is y else _products(x, y)
        return (0 if x is y else min(every)), max(every)
    if name == "abs":
        return (0 if x.low <= 0 <= x.high else min(abs(x.low), abs(x.high))), max(-x.low, x.high)
    if name in ("min", "max"):
        pick = min if name == "min" else max
        return pick(x.low, y.low), pick(x.high, y.high)
    if name == "select":
        return min(a[1].low, y.low), max(a[1].high, y.high)
    if name == "cast":
        return _cast_bounds(x, kind)
    if name in ("floor", "ceil", "round"):
        low = x.low if math.isinf(x.low) else math.floor(x.low)
        return low, (x.high if math.isinf(x.high) else math.ceil(x.high))
    if name == "rem" and y.low > 0 and y.high < math.inf:
        top = y.high if kind == "f" else y.high - 1
        return (0 if x.low >= 0 else -top), (0 if x.high <= 0 else min(top, max(x.high, 0)))
    if name == "div" and kind != "f" and y.low > 0 and x.low >= 0:
        return x.low // y.high, x.high // y.low
    if name == "sign" or name == "tanh" or name in ("sin", "cos", "erf"):
        return -1, 1
    if name in ("exp", "exp2", "sqrt"):
        return 0, math.inf
    if name == "logistic":
        return 0, 1
    if name == "and" and kind in "iul" and y.op == "const" and y.value >= 0:
        return 0, y.value
    return LIMITS[kind]


def _cast_bounds(x: Node, kind: str) -> tuple[float, float]:
    low, high = LIMITS[kind]
    if kind == "f" or x.kind != "f":
        return x.low, x.high
    whole = [edge if math.isinf(v) else math.trunc(v) for v, edge in ((x.low, low), (x.high, high))]
    if x.nan:  # NaN becomes 0
        whole = [min(whole[0], 0), max(whole[1], 0)]
    return min(max(whole[0], low), high), min(max(whole[1], low), high)


#: functions of a finite number that are never NaN
_SAFE = frozenset("neg abs sign floor ceil round exp exp2 expm1 sqrt tanh sinh cosh atan logistic "
                  "erf cbrt asinh select cast min max atan2 mul".split())  # fmt: skip


def _may_be_nan(name: str, a: tuple[Node, ...]) -> bool:
    reals = [x for x in a if x.kind == "f"]
    if any(x.nan for x in reals):
        return True
    if name in ("add", "sub", "mul", "sin", "cos"):
        return not all(x.finite for x in reals)
    if name in ("sqrt",):
        return a[0].low < 0
    if name == "div":
        return not (all(x.finite for x in reals) and (a[1].low > 0 or a[1].high < 0))
    return name not in _SAFE
