"""Arrays that stay in memory: too large to be written out as scalars, read by index."""

from typing import Any, NamedTuple

import numpy as np

from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.graph import Graph
from jaxstage.compiler.ir.node import Node

#: the largest one whose elements may be named one by one
WRITTEN_OUT = 4096


class ConstantTable(NamedTuple):
    """An array that all runs share and read by index.

    Attributes:
        source: What the nodes `load` call it.
        shape: Its shape.
        kind: Kind of its elements, which stand in C order.
    """

    source: Any
    shape: tuple[int, ...]
    kind: str


def element(graph: Graph, table: ConstantTable, position: int) -> Node:
    """One element at a fixed position."""
    return graph.load(table.source, position, graph.const(0, "i"), table.kind)


def cells_of(graph: Graph, value: Any) -> np.ndarray:
    """The array of nodes; a table is written out.

    Raises:
        LoweringError: The table is too large.
    """
    if not isinstance(value, ConstantTable):
        return value
    out = np.empty(value.shape, object)
    if out.size > WRITTEN_OUT:
        raise LoweringError(f"arithmetic on a whole table of {out.size} numbers")
    for position, index in enumerate(np.ndindex(*value.shape)):
        out[index] = element(graph, value, position)
    return out
