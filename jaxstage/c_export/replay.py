"""What shows that the C text does what the simulation did: recorded ticks, a program that replays
them, a Makefile, and a note to the reader."""

import textwrap
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxstage.c_export.law_graph import STRUCTS, LawGraph
from jaxstage.c_export.source_files import Identity, call_order, fill, unused, used
from jaxstage.c_export.structs import Member
from jaxstage.compiler.c99.ops import number

#: single precision? -> largest difference in a replay, as a share of the largest demand
BOUND = {False: 1e-12, True: 1e-4}


class RecordedTicks(NamedTuple):
    """Ticks of a closed loop.

    Attributes:
        setpoint: What was commanded, each leaf ``(ticks, ...)``.
        measurement: What the law saw, each leaf ``(ticks, ...)``.
        demand: What it demanded, ``(ticks, axes)``.
        command: What the limits of the drive left of it, ``(ticks, axes)``.
    """

    setpoint: Any
    measurement: Any
    demand: np.ndarray
    command: np.ndarray


def recorded_header(law: LawGraph, what: Identity, rows: RecordedTicks) -> str:
    """The ticks as a C table."""
    columns = {name: _columns(law, name, getattr(rows, name)) for name in STRUCTS[2:]}
    lines = []
    for k in range(len(rows.demand)):
        seen = [
            "{" + ", ".join(_numbers(m, column[k], what) for m, column in columns[name]) + "}"
            for name in columns
        ]
        told = [
            "{" + ", ".join(number(v, "f", what.single) for v in part[k]) + "}"
            for part in (rows.demand, rows.command)
        ]
        lines.append(
            f"    {{{', '.join(part if part != '{}' else '{0}' for part in seen + told)}}},"
        )
    return fill("recorded.h", what, ticks=len(rows.demand), axes=law.axes, rows="\n".join(lines))


def _columns(law: LawGraph, group: str, tree: Any) -> list[tuple[Member, np.ndarray]]:
    """The members of a struct that the law reads, with their values in every tick."""
    kept = {member.names for member in used(law, group)}
    pairs = zip(getattr(law, group), jax.tree.leaves(tree), strict=True)
    return [(member, np.asarray(column)) for member, column in pairs if member.names in kept]


def _numbers(member: Member, values: np.ndarray, what: Identity) -> str:
    texts = [number(v, member.kind, what.single) for v in values.reshape(-1)]
    return "{" + ", ".join(texts) + "}" if member.shape else texts[0]


def replay_source(law: LawGraph, what: Identity) -> str:
    """The program: 0 where every demand is met within the bound, else 1."""
    row, told = "row->command[i]", law.settle is not None
    limited = f"            command[i] = {row} == row->demand[i] ? demand[i] : {row};\n"
    settle = f"        {what.prefix}_settle(gains, &memory, demand, command);\n"
    return fill(
        "replay.c",
        what,
        bound=f"{BOUND[what.single]:g}",
        axes=law.axes,
        command=f", command[{law.axes}]" if told else "",
        limited=limited if told else "",
        settle=settle if told else "",
        unit=what.command_unit,
    )


def makefile(what: Identity) -> str:
    """Targets check, size and clean."""
    promotion = " -Wdouble-promotion" if what.single else ""
    return fill("Makefile", what, arm=ARM, promotion=promotion)


#: a Cortex-M4 with its unit for single precision
ARM = "-mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16"


def readme(law: LawGraph, what: Identity, ticks: int) -> str:
    """What is in the folder, how to call it, how it was checked."""
    left = {group: unused(law, group) for group in ("setpoint", "measurement", "gains")}
    missing = "".join(f"  {group}: {', '.join(names)}\n" for group, names in left.items() if names)
    if missing:
        missing = f"\nWhat this law does not use, and its structs do not hold:\n{missing}"
    rounded = (
        "\nSamples and gains are rounded to single precision, the simulation computes in double."
    )
    return fill(
        "README.txt",
        what,
        title=textwrap.fill(f"{what.title}, control period {what.period:g} s.", 98),
        ticks=ticks,
        calls=call_order(law, what),
        missing=missing,
        bound=f"{BOUND[what.single]:g}",
        rounded=rounded if what.single else "",
    )
