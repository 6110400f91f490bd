"""Where a kernel finds its inputs: slots of parameters, shared values and carried cells."""

from typing import Any, NamedTuple

import numpy as np

from jaxstage.compiler.frontend.lower import Lowered
from jaxstage.compiler.frontend.step_program import Program
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.node import Node, kind_of
from jaxstage.compiler.passes.store_forms import COPY, Cells


class Slots(NamedTuple):
    """The elements of one group that a kernel reads: (array, element) -> its slot.

    Reals and integers stand in arrays of their own.
    """

    real: dict[tuple[int, int], int]
    whole: dict[tuple[int, int], int]

    def slot(self, node: Node) -> int:
        """The slot of an input, made if it is new."""
        (_, number), element = node.value
        table = self.real if node.kind == "f" else self.whole
        return table.setdefault((number, element), len(table))


class Layout(NamedTuple):
    """Where everything stands in a kernel: the slots of each group that it reads.

    carry: slots of all carried cells (reals first in ``c``, integers in ``ci``), by (leaf, cell).
    """

    groups: dict[str, Slots]
    carry: dict[int, tuple[bool, int]]
    moving: dict[tuple[str, int], int]


def layout(program: Program, lowered: Lowered, moving: tuple[int, ...]) -> Layout:
    """Slots of the carry and of derivatives; the others are given as they are read."""
    carry, moved, counts = {}, {}, {True: 0, False: 0}
    for number, leaf in enumerate(program.carry):
        if number in lowered.counter:
            continue
        real = kind_of(leaf.dtype) == "f"
        carry[number] = real, counts[real]
        counts[real] += int(np.prod(leaf.shape))
    at = 0
    for number in program.real_carry:
        moved["d", number] = moved["g", number] = at
        at += int(np.prod(program.carry[number].shape))
    at = 0
    for number in moving:
        moved["q", number] = moved["a", number] = at
        at += int(np.prod(program.leaves[number].shape))
    groups = {name: Slots({}, {}) for name in ("p", "s", "r")}
    return Layout(groups, carry, moved)


def cells(where: Layout) -> Cells:
    """How inputs are read in C++."""

    def slot(node: Node) -> tuple[str, int]:
        (group, number), element = node.value
        whole = node.kind != "f"
        if group == "c":
            name = "ci" if whole else "c"
            return f"{name}{COPY}[{{}}]", where.carry[number][1] + element
        if group in "dg":
            return f"{group}{COPY}[{{}}]", where.moving[group, number] + element
        if group == "q":
            return "load(Q+{}*NB+b)", where.moving[group, number] + element
        return _READ[group, whole], where.groups[group].slot(node)

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
        if group == "c" and where.carry[number][0]:
            return f"c{COPY}", where.carry[number][1]
        if group in "dg":
            return f"{group}{COPY}", where.moving[group, number]
        raise LoweringError("an index into parameters that each run has for itself")

    return Cells(read, array, slot)


_READ = {
    ("p", False): "load(P+{}*NB+b)", ("p", True): "load_ints(PI+{}*NB+b)",
    ("s", False): "all(S[{}])", ("s", True): "same(SI[{}])",
    ("r", False): "all(r[{}])", ("r", True): "same(ri[{}])",
}  # fmt: skip
