"""Data layout of a kernel: slots of parameters, shared values, carried cells and derivatives."""

from typing import Any, NamedTuple

import numpy as np

from jaxstage.compiler.frontend.lower import Lowered
from jaxstage.compiler.frontend.step_program import Program
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.node import Node, kind_of
from jaxstage.compiler.passes.store_forms import COPY, Cells

#: C text of a read, by group and whether the element is an integer
_READ = {
    ("p", False): "load(P+{}*NB+b)",
    ("p", True): "load_ints(PI+{}*NB+b)",
    ("s", False): "all(S[{}])",
    ("s", True): "same(SI[{}])",
    ("r", False): "all(r[{}])",
    ("r", True): "same(ri[{}])",
}


class Slots(NamedTuple):
    """The elements of one group that a kernel reads, in the order of their first use.

    Attributes:
        real: Slot of each real, by (array, element).
        whole: Slot of each integer, by (array, element); they stand in an array of their own.
    """

    real: dict[tuple[int, int], int]
    whole: dict[tuple[int, int], int]

    def slot(self, node: Node) -> int:
        """The slot of an input, a new one at its first use."""
        (_, number), element = node.value
        table = self.real if node.kind == "f" else self.whole
        return table.setdefault((number, element), len(table))


class Layout(NamedTuple):
    """Where everything stands in a kernel.

    Attributes:
        groups: Slots of ``p`` parameters of a run, ``s`` values that all runs share, ``r`` values
            of a tick.
        carry: By number of the leaf: whether it stands among the reals ``c`` or the integers
            ``ci``, and the slot of its element 0.
        moving: Slot of element 0 of each tangent or cotangent, by (group, number of the leaf):
            ``d``, ``g`` of the carry, ``q``, ``a`` of the other leaves.
    """

    groups: dict[str, Slots]
    carry: dict[int, tuple[bool, int]]
    moving: dict[tuple[str, int], int]


def lay_out(program: Program, lowered: Lowered, moving: tuple[int, ...]) -> Layout:
    """Assign slots to the carry and to derivatives; the groups fill as they are read.

    Args:
        program: The loop.
        lowered: One control period of it as a graph.
        moving: Leaves beside the carry that have derivatives.

    Returns:
        The layout, its groups empty.
    """
    carry, counts = {}, {True: 0, False: 0}
    for number, leaf in enumerate(program.carry):
        if number in lowered.counter:
            continue
        real = kind_of(leaf.dtype) == "f"
        carry[number] = real, counts[real]
        counts[real] += int(np.prod(leaf.shape))
    slots: dict[tuple[str, int], int] = {}
    for names, leaves, numbers in (
        ("dg", program.carry, program.real_carry),
        ("qa", program.leaves, moving),
    ):
        first = 0
        for number in numbers:
            slots |= {(name, number): first for name in names}
            first += int(np.prod(leaves[number].shape))
    groups = {name: Slots({}, {}) for name in ("p", "s", "r")}
    return Layout(groups, carry, slots)


def cells(layout: Layout) -> Cells:
    """How the inputs of a graph are read in C++."""

    def slot(node: Node) -> tuple[str, int]:
        (group, number), element = node.value
        whole = node.kind != "f"
        if group == "c":
            name = "ci" if whole else "c"
            return f"{name}{COPY}[{{}}]", layout.carry[number][1] + element
        if group in "dg":
            return f"{group}{COPY}[{{}}]", layout.moving[group, number] + element
        if group == "q":
            return "load(Q+{}*NB+b)", layout.moving[group, number] + element
        return _READ[group, whole], layout.groups[group].slot(node)

    def read(node: Node) -> str:
        form, number = slot(node)
        text = form.format(number)
        if node.kind == "u":
            return f"to_uint32({text})"
        return f"as_mask({text})" if node.kind == "b" else text

    def array(source: Any) -> tuple[str, int]:
        group, number = source
        if group == "t":
            return f"T{number}", 0
        if group == "c" and layout.carry[number][0]:
            return f"c{COPY}", layout.carry[number][1]
        if group in "dg":
            return f"{group}{COPY}", layout.moving[group, number]
        raise LoweringError("an index into parameters that each run has for itself")

    return Cells(read, array, slot)
