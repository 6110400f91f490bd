"""Translation unit of a kernel: the templates that frame its statements, filled in.

A unit is a heading (sizes, state), functions of one control period, and the handler that XLA calls
through its foreign function interface. The frame of each stands in ``templates/``; only what
differs from kernel to kernel is put together here.
"""

import functools
from pathlib import Path
from string import Template
from typing import NamedTuple

from jaxstage.compiler.cxx.emit import copies
from jaxstage.compiler.cxx.hoist import Hoisted, hoist
from jaxstage.compiler.cxx.layout import Layout, cells
from jaxstage.compiler.frontend.lower import Lowered
from jaxstage.compiler.frontend.step_program import Program
from jaxstage.compiler.passes.store_forms import COPY, Store

TEMPLATES = Path(__file__).parent / "templates"
#: arguments of the handler that stand before the tables, see `kernels`
FIXED_ARGUMENTS = 8

#: the arrays of a vector; cotangents stand where tangents do
_ARRAYS = (
    f"vec* __restrict c{COPY} = c[{COPY}]; ints* __restrict ci{COPY} = ci[{COPY}];",
    f"vec* __restrict d{COPY} = d[{COPY}]; vec* __restrict g{COPY} = d[{COPY}];",
    f"vec* __restrict a{COPY} = a[{COPY}];",
    f"const vec* __restrict h{COPY} = h[{COPY}]; const ints* __restrict hi{COPY} = hi[{COPY}];",
    f"real* row{COPY} = row + {COPY} * LANES; int32_t* rowi{COPY} = rowi + {COPY} * LANES;",
)


class Source(NamedTuple):
    """What the pieces of a translation unit have in common.

    Attributes:
        program: The loop.
        lowered: One control period of it as a graph.
        layout: Slots of the kernel's inputs.
        hoisted: Statements that stand before the time loop.
    """

    program: Program
    lowered: Lowered
    layout: Layout
    hoisted: Hoisted

    @property
    def tables(self) -> str:
        """The tables as further arguments of a call."""
        return "".join(f", T{i}" for i in range(len(self.lowered.tables)))

    @property
    def passed(self) -> str:
        """Arguments that one function of a period hands on to another."""
        return f"r, ri, row, rowi, NB{self.tables}"

    @property
    def table_types(self) -> list[str]:
        """C types of the elements of the tables."""
        types: dict[int, str] = {}
        for node in self.lowered.graph.nodes:
            if node.op == "load" and node.value[0][0] == "t":
                types[node.value[0][1]] = "real" if node.kind == "f" else "int32_t"
        return [types.get(i, "real") for i in range(len(self.lowered.tables))]


@functools.cache
def template(name: str) -> Template:
    """The template ``templates/<name>.cc.in``."""
    return Template((TEMPLATES / f"{name}.cc.in").read_text(encoding="utf-8"))


def source_of(program: Program, lowered: Lowered, layout: Layout, stores: list[Store]) -> Source:
    """The common part of a kernel that computes the stores in each control period."""
    return Source(program, lowered, layout, hoist(lowered, stores, cells(layout)))


def function_text(
    source: Source,
    name: str,
    statements: list[str],
    interleave: int,
    parameters: str = "",
    cold: bool = False,
) -> str:
    """A C++ function of one control period.

    Args:
        source: The unit that it stands in.
        name: Its name.
        statements: Its body; the arrays of each vector have their names there.
        interleave: Vectors of runs that go through time together.
        parameters: Further parameters, each after a comma.
        cold: Whether it is called seldom, and so not inlined.

    Returns:
        C++ text.
    """
    tables = "".join(f", const {kind}* T{i}" for i, kind in enumerate(source.table_types))
    kind = "__attribute__((noinline, cold))" if cold else "inline __attribute__((always_inline))"
    lines = [*copies([*_ARRAYS], interleave), *statements]
    return template("function").substitute(
        attributes=kind, name=name, parameters=tables + parameters, statements="\n  ".join(lines)
    )


def holds(condition: str, interleave: int) -> str:
    """C text: whether a condition holds in every lane of all vectors."""
    return " && ".join(copies([f"everywhere({condition})"], interleave))


def heading(source: Source, interleave: int) -> str:
    """Includes, sizes and state; made after all functions, which find out what they read."""
    groups = source.layout.groups
    sizes = {
        "NH": source.hoisted.reals,
        "NHI": source.hoisted.wholes,
        "NC": _carried_cells(source, real=True),
        "NCI": _carried_cells(source, real=False),
        "NR": len(groups["r"].real),
        "NRI": len(groups["r"].whole),
        "ND": _derivative_cells(source, "d"),
        "NA": _derivative_cells(source, "q"),
    }
    lines = "\n".join(f"constexpr int {name} = {value};" for name, value in sizes.items())
    real = "float" if source.lowered.single else "double"
    return template("heading").substitute(real=real, sizes=lines, interleave=interleave)


def _carried_cells(source: Source, real: bool) -> int:
    leaves = source.program.carry
    return sum(leaves[number].size for number, (r, _) in source.layout.carry.items() if r == real)


def _derivative_cells(source: Source, group: str) -> int:
    """Elements that have tangents: ``d`` of the carry, ``q`` of the other leaves."""
    program = source.program
    leaves = program.carry if group == "d" else program.leaves
    return sum(leaves[number].size for name, number in source.layout.moving if name == group)


def handler(source: Source, name: str, **values: int) -> str:
    """The function that XLA calls: its arguments by name, then the time loop of all runs.

    Args:
        source: The unit that it stands in.
        name: The template of the work: ``forward``, ``tangent`` or ``pullback``.
        **values: What that template needs beside ``borders``, ``tables`` and the numbers of the
            arguments that follow the tables, ``first`` and ``second``.

    Returns:
        C++ text.
    """
    tables = "".join(
        f"\n  const {kind}* T{i} = in<{kind}>(frame, {FIXED_ARGUMENTS + i});"
        for i, kind in enumerate(source.table_types)
    )
    borders = template("borders").substitute(hoisted="\n    ".join(source.hoisted.lines))
    first = FIXED_ARGUMENTS + len(source.lowered.tables)
    body = template(name).substitute(
        values, borders=borders.rstrip(), tables=source.tables, first=first, second=first + 1
    )
    return template("handler").substitute(tables=tables, body=body.rstrip())
