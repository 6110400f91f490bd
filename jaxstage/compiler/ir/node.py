"""The node of the graph: one scalar of static single assignment, and the kinds of scalars."""

import dataclasses
import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.key_types import is_key_type

#: kind -> smallest and largest value: truth value, int32, uint32, int64, real
LIMITS: dict[str, tuple[float, float]] = {
    "b": (0, 1),
    "i": (-(2**31), 2**31 - 1),
    "u": (0, 2**32 - 1),
    "l": (-(2**63), 2**63 - 1),
    "f": (-math.inf, math.inf),
}

#: type of arrays -> kind of their elements; small integers are computed as int32
_KINDS = {
    "bool": "b",
    "float32": "f",
    "float64": "f",
    "int32": "i",
    "uint32": "u",
    "int64": "l",
    "int8": "i",
    "int16": "i",
}


@dataclasses.dataclass(frozen=True)
class Node:
    """One scalar value: an operation and its arguments, with what is known of the result.

    Nodes are compared by identity: a graph makes equal ones once.

    Attributes:
        op: Name of the operation, see `ops`.
        kind: Kind of the value, a key of `LIMITS`.
        args: What the operation reads.
        value: What an operation needs beside its arguments: the number of a ``const``, the place
            of an ``in`` or ``load``, the body of a ``loop``.
        low: Lower bound of the value, where it is not NaN.
        high: Upper bound of the value, where it is not NaN.
        nan: Whether the value may be NaN.
        id: Position in the graph.
    """

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
        """Whether the value is certainly neither NaN nor infinite."""
        return not self.nan and self.low > -math.inf and self.high < math.inf


def kind_of(dtype: Any) -> str:
    """The kind of nodes that hold a type of arrays; ``k`` for random keys.

    Raises:
        LoweringError: No kind holds the type.
    """
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
    """Topological order, depth first, so that live ranges are short.

    Args:
        roots: The nodes that are needed.
        reads: What a node needs before it.
        known: Numbers of nodes that are there already, with all that they need.

    Returns:
        Every node that the roots need, arguments before users.
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
