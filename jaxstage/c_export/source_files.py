"""Header, source and gains of a control law in C99."""

import textwrap
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

from jaxstage.c_export.law_graph import STRUCTS, Function, LawGraph, elements, read
from jaxstage.c_export.structs import Member, declare, initialise
from jaxstage.compiler.c99.emit import statements
from jaxstage.compiler.c99.ops import number
from jaxstage.compiler.ir.node import Node
from jaxstage.compiler.passes.store_forms import Cells, Store

FUNCTIONS = ("init", "step", "settle")

_PURPOSE = {
    "gains": "What is tuned, and what the law assumes about the machine.",
    "memory": "What the law carries from one period to the next.",
    "setpoint": "The commanded motion of this period.",
    "measurement": "What is measured in this period.",
}


#: frames of the files, with ``$name`` for what differs
TEMPLATES = Path(__file__).parent / "templates"


class Identity(NamedTuple):
    """What the files say of themselves.

    Attributes:
        loop: Name of the loop.
        law: Name of the controller.
        prefix: Begins every name in C.
        axes: Names of the axes.
        period: Control period in s.
        command_unit: Unit of a demand.
        single: Whether reals are floats.
        version: Of the program that writes the files.
    """

    loop: str
    law: str
    prefix: str
    axes: tuple[str, ...]
    period: float
    command_unit: str
    single: bool
    version: str

    @property
    def mark(self) -> str:
        """The first line of every file."""
        return f"Written by jaxstage export, version {self.version}. Loop {self.loop}."

    @property
    def title(self) -> str:
        """Law, axes and precision."""
        axes = f"ax{'is' if len(self.axes) == 1 else 'es'} {', '.join(self.axes)}"
        return f"{self.law}, {axes}, {'single' if self.single else 'double'} precision"


def fill(name: str, what: Identity, /, **values: object) -> str:
    """A file: its template with values, and with ``mark`` and ``prefix`` of the identity."""
    text = (TEMPLATES / f"{name}.in").read_text(encoding="utf-8")
    return Template(text).substitute(values, mark=what.mark, prefix=what.prefix)


def used(law: LawGraph, group: str) -> tuple[Member, ...]:
    """The members of a struct that any function of the law reads; of the memory, all."""
    every: tuple[Member, ...] = getattr(law, group)
    if group == "memory":
        return every
    heard = {(e.group, e.leaf) for function in law.functions for e in read(function)}
    return tuple(member for leaf, member in enumerate(every) if (group, leaf) in heard)


def unused(law: LawGraph, group: str) -> tuple[str, ...]:
    """The other members, by name."""
    kept = used(law, group)
    return tuple(m.name for m in getattr(law, group) if m.names not in {k.names for k in kept})


def _arguments(law: LawGraph, what: Identity) -> dict[str, list[str]]:
    """The parameters of the three functions."""
    p, n = what.prefix, law.axes
    begin = [f"const {p}_gains *gains", f"{p}_memory *memory"]
    seen = [f"const {p}_setpoint *setpoint", f"const {p}_measurement *measurement"]
    told = [f"const {p}_real demand[{n}]", f"const {p}_real command[{n}]"]
    return {
        "init": [*begin, *seen],
        "step": [*begin, *seen, f"{p}_real demand[{n}]"],
        "settle": [*begin, *told],
    }


def _prototype(law: LawGraph, what: Identity, name: str) -> str:
    line, lines = f"void {what.prefix}_{name}(", []
    for argument in _arguments(law, what)[name]:
        if len(line) + len(argument) > 97:
            lines.append(line.rstrip())
            line = " " * 8
        line += f"{argument}, "
    return "\n".join([*lines, line.removesuffix(", ")]) + ")"


def header(law: LawGraph, what: Identity) -> str:
    """The header: structs with units, the functions and when to call them."""
    p = what.prefix
    structs = []
    for group in STRUCTS:
        left = unused(law, group)
        note = f" This law does not use: {', '.join(left)}." if left else ""
        purpose = "\n * ".join(_wrapped(_PURPOSE[group] + note, 94))
        structs.append(declare(used(law, group), f"{p}_{group}", purpose, f"{p}_real"))
    calls = (f"/* {text} */\n{_prototype(law, what, name)};" for name, text in _calls(law).items())
    return fill(
        "control.h",
        what,
        usage=_starred(_usage(law, what)),
        guard=f"{p.upper()}_H",
        real="float" if what.single else "double",
        names=", ".join(what.axes),
        name=p.upper(),
        axes=law.axes,
        period=number(what.period, "f", what.single),
        structs="\n\n".join(structs),
        functions="\n\n".join(calls),
    )


def _calls(law: LawGraph) -> dict[str, str]:
    calls = {
        "init": "Once, with the first sample, before the first step.",
        "step": "Once a period: the demand of each axis from the sample of this period.",
    }
    if law.settle is not None:
        calls["settle"] = (
            "Once a period, after step. demand: all that was demanded of the drive; command: what\n"
            "   its limits left of it. Both are the same while nothing is limited."
        )
    return calls


def call_order(law: LawGraph, what: Identity) -> str:
    """When to call the functions, as lines of C and words."""
    p = what.prefix
    last = f"  {p}_settle(&gains, &memory, demand, command);\n" if law.settle is not None else ""
    return (
        f"  {p}_init(&gains, &memory, &setpoint, &measurement);      before the first period\n\n"
        f"  {p}_step(&gains, &memory, &setpoint, &measurement, demand);      in every period\n"
        f"  command = demand within the limits of the drive\n{last}"
    )


def _usage(law: LawGraph, what: Identity) -> str:
    index = "" if law.axes == 1 else " The first index of what belongs to an axis is the axis."
    return (
        f"{what.title}, one call every {what.period:g} s.\n\n{call_order(law, what)}\n"
        f"Units are SI; a demand has the unit {what.command_unit}.{index} No heap, no state but "
        "the memory, no recursion, no input or output."
    )


def _starred(text: str) -> str:
    lines = [part for line in text.splitlines() for part in (_wrapped(line, 94) or [""])]
    return "".join(f" * {line}".rstrip() + "\n" for line in lines)


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width, replace_whitespace=False, drop_whitespace=True)


def source(law: LawGraph, what: Identity) -> str:
    """The functions.

    Raises:
        LoweringError: C99 does not have an operation.
    """
    helpers: dict[str, str] = {}
    bodies = []
    for name, function in zip(FUNCTIONS, law.functions, strict=False):
        lines = _body(law, name, function, what, helpers)
        bodies.append(f"{_prototype(law, what, name)}\n{{\n{lines}\n}}\n")
    functions = (text.strip() for text in (*helpers.values(), *bodies))
    return fill("control.c", what, functions="\n\n".join(functions))


def _cells(law: LawGraph, function: Function) -> Cells:
    """Where the inputs of a function stand in C."""
    members = {
        (group, number): member
        for group in STRUCTS
        for number, member in enumerate(getattr(law, group))
    }

    def place(leaf: int) -> tuple[str, bool]:
        group, _ = function.leaves[leaf]
        member = members.get(function.leaves[leaf])
        return (group, True) if member is None else (f"{group}->{member.name}", bool(member.shape))

    def slot(node: Node) -> tuple[str, int]:
        leaf, index = node.value
        text, is_array = place(leaf)
        return (f"{text}[{{}}]" if is_array else text), index

    def read(node: Node) -> str:
        text, index = slot(node)
        return text.format(index)

    scalars = frozenset(f"memory->{member.name}" for member in law.memory if not member.shape)
    return Cells(read, lambda leaf: (place(leaf)[0], 0), slot, scalars)


def _body(
    law: LawGraph, name: str, function: Function, what: Identity, helpers: dict[str, str]
) -> str:
    stores = [Store("demand", i, node) for i, node in enumerate(function.demand)]
    stores += [
        Store(f"memory->{member.name}", index, node)
        for (_, member, index), node in zip(elements(law.memory), function.memory, strict=True)
    ]
    written = statements(stores, _cells(law, function), what.single)
    helpers.update(written.helpers)
    text = "\n".join(written.lines)
    seen = ("demand", "command") if name == "settle" else ("setpoint", "measurement")
    groups = ("gains", "memory", *seen)
    ignored = [f"    (void){g};" for g in groups if f"{g}->" not in text and f"{g}[" not in text]
    return "\n".join([*ignored, *written.lines])


def gains_source(law: LawGraph, what: Identity) -> str:
    """The gains as an initialised constant."""
    every = used(law, "gains")

    def text(value: Any, kind: str) -> str:
        return number(value, kind, what.single)

    values = initialise(every, text)
    include = "#include <math.h>\n\n" if "INFINITY" in values else ""
    return fill("gains.c", what, include=include, values=values)
