"""One scalar of a graph, and the kinds of scalars."""

import dataclasses
import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.key_types import is_key_type

FUNCTIONS = frozenset(
    "floor ceil round exp exp2 expm1 log log1p sqrt rsqrt cbrt sin cos tan asin acos atan sinh "
    "cosh tanh asinh acosh atanh logistic erf erf_inv".split()
)
COMPARISONS = frozenset("eq ne lt le gt ge".split())
#: smallest and largest value of each kind
LIMITS: dict[str, tuple[float, float]] = {
    "b": (0, 1),
    "i": (-(2**31), 2**31 - 1),
    "u": (0, 2**32 - 1),
    "l": (-(2**63), 2**63 - 1),
    "f": (-math.inf, math.inf),
}


@dataclasses.dataclass(frozen=True)
class Node:
    """One scalar. low, high: range of its value where it is not NaN; nan: may it be NaN."""

    op: str
    kind: str
    args: "tuple[Node, ...]"
    value: Any
    low: float
    high: float
    nan: bool
    id: int

    def __repr__(self) -> str:
        inside = ", ".join(str(a.id) for a in self.args)
        return f"%{self.id} = {self.op}({inside}){'' if self.value is None else self.value}"

    def __eq__(self, other: object) -> bool:
        return self is other

    def __hash__(self) -> int:
        return self.id

    @property
    def finite(self) -> bool:
        """Whether it is certainly neither NaN nor infinite."""
        return not self.nan and self.low > -math.inf and self.high < math.inf


_KINDS = {
    "bool": "b", "float32": "f", "float64": "f", "int32": "i", "uint32": "u", "int64": "l",
    "int8": "i", "int16": "i",
}  # fmt: skip


def kind_of(dtype: Any) -> str:
    """The kind of nodes that hold a type. Raises LoweringError for one that has none."""
    if is_key_type(dtype):
        return "k"
    name = np.dtype(dtype).name
    if name not in _KINDS:
        raise LoweringError(f"values of type {name}")
    return _KINDS[name]


def arguments(node: Node) -> Iterable[Node]:
    """What a node reads."""
    return node.args


def ordered(
    roots: Iterable[Node],
    reads: Callable[[Node], Iterable[Node]] = arguments,
    known: Iterable[int] = (),
) -> list[Node]:
    """Every node that the roots need, arguments before users, depth first: short live ranges.

    reads: what a node needs. known: numbers of nodes that are there already, with what they need.
    """
    seen = set(known)
    out: list[Node] = []
    for root in roots:
        stack = [(root, False)]
        while stack:
            node, done = stack.pop()
            if done:
                out.append(node)
            elif node.id not in seen:
                seen.add(node.id)
                stack.append((node, True))
                stack.extend((need, False) for need in reversed([*reads(node)]))
    return out
