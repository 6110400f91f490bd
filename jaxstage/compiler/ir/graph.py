"""A graph of scalar operations: equal nodes are one, constants are folded, ranges are known.

A node's kind is its type: ``f`` real, ``i`` int32, ``u`` uint32, ``l`` int64, ``b`` bool. Its
operation is one of:

* leaves: ``const`` (value), ``in`` (value = (group, index)), ``load`` (value = (source, offset),
  one argument: the element ``offset + argument`` of an array that is kept in memory);
* arithmetic: add sub mul div neg abs sign min max rem pow atan2, the functions of `FUNCTIONS`;
  min, max and sign pass NaN on as jnp does; integers divide and leave remainders as C does;
* comparison and logic: eq ne lt le gt ge, and or not (bits for integers), xor, shl, shr (logical
  shifts), is_finite;
* ``select`` (condition, where true, where false), ``cast`` to the node's kind (truncating),
  ``bits`` and ``real_of_bits`` (the representation of a real, as the integer of its size).
"""

import math
from typing import Any, NamedTuple

from jaxstage.compiler.ir.constant_folding import fold
from jaxstage.compiler.ir.intervals import value_range
from jaxstage.compiler.ir.node import COMPARISONS, LIMITS, Node
from jaxstage.compiler.ir.simplify import simpler


class Graph(NamedTuple):
    """Nodes in the order in which they were made: arguments stand before their users.

    largest: of the real type; what may exceed it may be infinite. rich: for a kernel, which may
    also hold ``all_finite`` and ``sum`` of any number of arguments, and ``loop`` (see `inner`).
    """

    nodes: list[Node]
    table: dict[Any, Node]
    largest: float
    rich: bool = False

    def const(self, value: Any, kind: str) -> Node:
        """A constant."""
        if kind == "f":
            number: Any = float(value)
        else:
            number = bool(value) if kind == "b" else int(value)
        nan = kind == "f" and math.isnan(number)
        bound = math.nan if nan else number
        bounds = (-math.inf, math.inf) if nan else (bound, bound)
        return self._found("const", kind, (), number, bounds, nan)

    def input(
        self, group: Any, index: int, kind: str, finite: bool = False, bounds: Any = None
    ) -> Node:
        """An input. finite: the caller promises that it is; bounds: its range, if known."""
        low, high = bounds or LIMITS[kind]
        if kind == "f" and finite and not bounds:
            low, high = -self.largest, self.largest
        return self._found("in", kind, (), (group, index), (low, high), kind == "f" and not finite)

    def load(self, source: Any, offset: int, index: Node, kind: str, finite: bool = False) -> Node:
        """The element ``offset + index`` of an array in memory. index: in range, always."""
        low, high = LIMITS[kind]
        if kind == "f" and finite:
            low, high = -self.largest, self.largest
        value = (source, offset)
        return self._found("load", kind, (index,), value, (low, high), kind == "f" and not finite)

    def special(self, op: str, args: tuple[Node, ...], value: Any, kind: str) -> Node:
        """A ``loop`` or what comes after it, see `inner`; a ``sum``."""
        return self._found(op, kind, args, value, LIMITS[kind], kind == "f")

    def op(self, name: str, *args: Node, kind: str = "") -> Node:
        """An operation; kind: of the result, that of the last argument if left out."""
        if name in COMPARISONS or name in ("is_finite", "all_finite"):
            kind = "b"
        kind = kind or args[-1].kind
        if all(a.op == "const" for a in args):
            value = fold(name, kind, [a.value for a in args], [a.kind for a in args])
            if value is not None:
                return self.const(value, kind)
        simple = simpler(self, name, kind, args)
        if simple is not None:
            return simple
        low, high, nan = value_range(name, kind, args, self.largest)
        return self._found(name, kind, args, None, (low, high), nan)

    def rebuilt(self, node: Node, args: tuple[Node, ...]) -> Node:
        """A node with other arguments."""
        if node.value is None and node.op != "sum":
            return self.op(node.op, *args, kind=node.kind)
        bounds = node.low, node.high
        return self._found(node.op, node.kind, args, node.value, bounds, node.nan)

    def _found(
        self, op: str, kind: str, args: tuple[Node, ...], value: Any, bounds: Any, nan: bool
    ) -> Node:
        told = value.number if op == "loop" else repr(value)
        key = (op, kind, tuple(a.id for a in args), told)
        node = self.table.get(key)
        if node is None:
            low, high = (float(b) if kind == "f" else b for b in bounds)
            node = Node(
                op=op, kind=kind, args=args, value=value, low=low, high=high, nan=nan,
                id=len(self.nodes),
            )  # fmt: skip
            self.nodes.append(node)
            self.table[key] = node
        return node


def new_graph(single: bool = False, rich: bool = False) -> Graph:
    """An empty graph. single: reals are float32, else float64."""
    return Graph([], {}, 3.4028234663852886e38 if single else 1.7976931348623157e308, rich)
