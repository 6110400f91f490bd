"""The graph of scalar operations: value numbering, constant folding and intervals as it grows.

Equal nodes are one node, constants are folded, and each node knows the bounds of its value. The
operations and what they mean stand in `ops`. Leaves have a value in place of arguments:

* ``const``: the number;
* ``in``: (group, index);
* ``load``: (source, offset) with one argument, the element ``offset + argument`` of an array that
  is kept in memory.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from jaxstage.compiler.ir.constant_folding import fold
from jaxstage.compiler.ir.intervals import value_range
from jaxstage.compiler.ir.node import LIMITS, Node
from jaxstage.compiler.ir.ops import OPS

#: largest finite real, in single and double precision
LARGEST = {True: 3.4028234663852886e38, False: 1.7976931348623157e308}

#: bounds of a value and whether it may be NaN
Facts = tuple[float, float, bool]


class Graph(NamedTuple):
    """Nodes in the order in which they were made: arguments stand before their users.

    Attributes:
        nodes: All nodes; the number of a node is its place here.
        table: Value numbering: what makes nodes equal -> the node.
        largest: Largest finite real; what may exceed it may be infinite.
        rich: Whether it is for a kernel, which may also hold ``all_finite``, ``sum`` and ``loop``.
    """

    nodes: list[Node]
    table: dict[Any, Node]
    largest: float
    rich: bool = False

    def const(self, value: Any, kind: str) -> Node:
        """A constant."""
        number: float = self.rounded(float(value)) if kind == "f" else int(value)
        number = bool(value) if kind == "b" else number
        if math.isnan(number):
            return self._numbered("const", kind, (), number, (*LIMITS["f"], True))
        return self._numbered("const", kind, (), number, (number, number, False))

    def input(
        self,
        group: Any,
        index: int,
        kind: str,
        finite: bool = False,
        bounds: tuple[float, float] | None = None,
    ) -> Node:
        """An input.

        Args:
            group: The array that it belongs to.
            index: Its element there.
            kind: Kind of the number.
            finite: The caller promises that it is finite.
            bounds: Smallest and largest value, if known.
        """
        facts = self._outside(kind, finite)
        if bounds is not None:
            facts = (*bounds, facts[2])
        return self._numbered("in", kind, (), (group, index), facts)

    def load(self, source: Any, offset: int, index: Node, kind: str, finite: bool = False) -> Node:
        """The element ``offset + index`` of an array in memory. index: in range, always."""
        facts = self._outside(kind, finite)
        return self._numbered("load", kind, (index,), (source, offset), facts)

    def rounded(self, value: float) -> float:
        """A real in the precision of the graph."""
        if self.largest == LARGEST[False]:
            return value
        with np.errstate(over="ignore"):
            return float(np.float32(value))

    def _outside(self, kind: str, finite: bool) -> Facts:
        """What is known of a number that comes from outside."""
        if kind == "f" and finite:
            return -self.largest, self.largest, False
        return (*LIMITS[kind], kind == "f")

    def special(self, op: str, args: tuple[Node, ...], value: Any, kind: str) -> Node:
        """A ``loop`` or what comes after it, see `inner_loop`; a ``sum``."""
        return self._numbered(op, kind, args, value, (*LIMITS[kind], kind == "f"))

    def op(self, name: str, *args: Node, kind: str = "") -> Node:
        """An operation, folded and simplified.

        Args:
            name: A key of `OPS`.
            args: Its arguments.
            kind: Kind of the result; left out, that which the operation gives.
        """
        op = OPS[name]
        if op.gives not in ("", "?"):
            kind = op.gives
        kind = kind or args[-1].kind
        if all(a.op == "const" for a in args):
            value = fold(op, kind, [a.value for a in args], [a.kind for a in args])
            if value is not None:
                return self.const(value, kind)
        simple = op.rewrite(self, kind, args) if op.rewrite is not None else None
        if simple is not None:
            return simple
        return self._numbered(name, kind, args, None, value_range(op, kind, args, self.largest))

    def rebuilt(self, node: Node, args: tuple[Node, ...]) -> Node:
        """A node with other arguments."""
        if node.value is None and node.op != "sum":
            return self.op(node.op, *args, kind=node.kind)
        facts = node.low, node.high, node.nan
        return self._numbered(node.op, node.kind, args, node.value, facts)

    def _numbered(
        self, op: str, kind: str, args: tuple[Node, ...], value: Any, facts: Facts
    ) -> Node:
        """The node of these parts: that which is there already, or a new one."""
        told = value.number if op == "loop" else repr(value)
        key = (op, kind, tuple(a.id for a in args), told)
        node = self.table.get(key)
        if node is None:
            low, high, nan = facts
            if kind == "f":
                low, high = self.rounded(float(low)), self.rounded(float(high))
            node = Node(op, kind, args, value, low, high, nan, len(self.nodes))
            self.nodes.append(node)
            self.table[key] = node
        return node


def new_graph(single: bool = False, rich: bool = False) -> Graph:
    """An empty graph. single: reals are float32, else float64."""
    return Graph([], {}, LARGEST[single], rich)
