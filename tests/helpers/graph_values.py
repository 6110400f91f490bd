"""The value of a graph at given inputs, node by node in numpy."""

import numpy as np

DTYPES = {"i": np.int32, "u": np.uint32, "l": np.int64, "b": np.bool_}


def dtype_of(kind, single=False):
    """The type of numpy of a kind."""
    return (np.float32 if single else np.float64) if kind == "f" else DTYPES[kind]


def _minimum(a, b):
    if a.dtype.kind != "f":
        return np.minimum(a, b)
    zero = (a == b) & np.signbit(a)
    return np.where(np.isnan(a) | np.isnan(b), np.nan, np.where((a < b) | zero, a, b))


def _maximum(a, b):
    return np.maximum(a, b) if a.dtype.kind != "f" else -_minimum(-a, -b)


def _sign(a):
    return np.sign(a) if a.dtype.kind != "f" else np.where((a == 0) | np.isnan(a), a, np.sign(a))


def _divided(a, b):
    """Quotient and remainder that truncate; of a division by 0, -1 and the dividend."""
    a, b = a.astype(object), b.astype(object)
    safe = np.where(b == 0, 1, b)
    whole = np.vectorize(
        lambda x, y: abs(x) // abs(y) * (1 if (x < 0) == (y < 0) else -1), [object]
    )
    quotient = whole(a, safe)
    return np.where(b == 0, -1, quotient), np.where(b == 0, a, a - safe * quotient)


def _wrap(value, dtype):
    bits = np.dtype(dtype).itemsize * 8
    return np.asarray(value & ((1 << bits) - 1), object).astype(f"u{bits // 8}").astype(dtype)


def _div(a, b):
    return a / b if a.dtype.kind == "f" else _wrap(_divided(a, b)[0], a.dtype)


def _rem(a, b):
    return np.fmod(a, b) if a.dtype.kind == "f" else _wrap(_divided(a, b)[1], a.dtype)


def _shift(up):
    def of(a, b):
        bits = a.dtype.itemsize * 8
        plain, by = a.astype(f"u{bits // 8}"), np.clip(b, 0, bits - 1).astype(f"u{bits // 8}")
        moved = plain << by if up else plain >> by
        return np.where((b < 0) | (b >= bits), 0, moved).astype(a.dtype)

    return of


def _cast(a, dtype):
    """Reals truncate and saturate, NaN gives 0; integers wrap."""
    if a.dtype.kind != "f" or np.dtype(dtype).kind not in "iu":
        return a.astype(dtype)
    limits = np.iinfo(dtype)
    whole = np.trunc(np.where(np.isnan(a), 0, a)).astype(float)
    exact = [min(max(int(x), limits.min), limits.max) if np.isfinite(x) else
             (limits.max if x > 0 else limits.min) for x in whole.reshape(-1)]  # fmt: skip
    return np.array(exact, object).reshape(a.shape).astype(dtype)


def _power(a, b):
    """numpy has no root of -inf."""
    return np.where(np.isinf(a) & (b == 0.5), np.inf, np.power(a, b))


OPERATIONS = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": _div, "rem": _rem,
    "neg": np.negative, "abs": np.abs, "sign": _sign, "min": _minimum, "max": _maximum,
    "pow": _power, "atan2": np.arctan2, "floor": np.floor, "ceil": np.ceil, "round": np.rint,
    "exp": np.exp, "exp2": np.exp2, "expm1": np.expm1, "log": np.log, "log1p": np.log1p,
    "sqrt": np.sqrt, "rsqrt": lambda a: 1 / np.sqrt(a), "cbrt": np.cbrt, "sin": np.sin,
    "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "asinh": np.arcsinh, "acosh": np.arccosh,
    "atanh": np.arctanh, "logistic": lambda a: 1 / (1 + np.exp(-a)),
    "eq": np.equal, "ne": np.not_equal, "lt": np.less, "le": np.less_equal, "gt": np.greater,
    "ge": np.greater_equal, "and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor,
    "not": np.invert, "shl": _shift(True), "shr": _shift(False), "is_finite": np.isfinite,
    "select": np.where,
}  # fmt: skip


def compute(name, kind, args, single=False):
    """One operation on arrays of the types of their kinds."""
    dtype = dtype_of(kind, single)
    with np.errstate(all="ignore"):
        if name == "cast":
            return _cast(args[0], dtype)
        return np.asarray(OPERATIONS[name](*args)).astype(dtype)


def evaluate(nodes, inputs, single=False):
    """Values of nodes by number. nodes: arguments first; inputs: by the value of `in` nodes."""
    values = {}
    for node in nodes:
        if node.op == "const":
            values[node.id] = np.asarray(node.value, dtype_of(node.kind, single))
        elif node.op == "in":
            values[node.id] = np.asarray(inputs[node.value], dtype_of(node.kind, single))
        else:
            args = [values[a.id] for a in node.args]
            values[node.id] = compute(node.op, node.kind, args, single)
    return values


def same(a, b, zeros=True):
    """Whether values are the same to the bit; zeros: the sign of a zero counts."""
    a, b = np.asarray(a), np.asarray(b)
    if a.dtype.kind != "f":
        return bool(np.all(a == b))
    equal = (a == b) & (np.signbit(a) == np.signbit(b)) if zeros else a == b
    return bool(np.all(equal | (np.isnan(a) & np.isnan(b))))
