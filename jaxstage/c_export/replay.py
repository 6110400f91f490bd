"""What shows that the C text does what the simulation did: recorded ticks, a program that replays
them, a Makefile, and a note to the reader."""

import textwrap
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxstage.c_export.law_graph import STRUCTS, LawGraph
from jaxstage.c_export.source_files import Identity, call_order, unused, used
from jaxstage.c_export.structs import Member
from jaxstage.compiler.c99.ops import number

#: single precision? -> largest difference in a replay, as a share of the largest demand
BOUND = {False: 1e-12, True: 1e-4}


class RecordedTicks(NamedTuple):
    """Ticks of a closed loop, each leaf (ticks, ...): what the law saw, asked for and was left."""

    setpoint: Any
    measurement: Any
    demand: np.ndarray
    command: np.ndarray


def recorded_header(law: LawGraph, what: Identity, rows: RecordedTicks) -> str:
    """The ticks as a C table."""
    p, n = what.prefix, law.axes
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
    return (
        f'/* {what.mark} */\n\n#include "{p}.h"\n\n#define TICKS {len(rows.demand)}\n\n'
        "/* What the simulation saw, what it demanded, and what the limits of the drive left. */\n"
        f"typedef struct {{\n    {p}_setpoint setpoint;\n    {p}_measurement measurement;\n"
        f"    {p}_real demand[{n}];\n    {p}_real command[{n}];\n}} recorded_tick;\n\n"
        "static const recorded_tick recorded[TICKS] = {\n" + "\n".join(lines) + "\n};\n"
    )


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
    p, n = what.prefix, law.axes
    told = law.settle is not None
    command = f", command[{n}]" if told else ""
    row = "row->command[i]"
    limited = (
        f"            command[i] = {row} == row->demand[i] ? demand[i] : {row};\n" if told else ""
    )
    settle = f"        {p}_settle(gains, &memory, demand, command);\n" if told else ""
    return f"""/* {what.mark}
 *
 * Replays the recorded ticks and compares the demands. Exit status 1 where one differs by more than
 * BOUND times the largest demand. */

#include <math.h>
#include <stdio.h>

#include "{p}.h"
#include "recorded.h"

#define BOUND {BOUND[what.single]:g}

int main(void)
{{
    const {p}_gains *gains = &{p}_exported_gains;
    {p}_memory memory;
    double largest = 0.0, worst = 0.0;
    int beyond = 0;

    for (int k = 0; k < TICKS; k++)
        for (int i = 0; i < {n}; i++)
            largest = fmax(largest, fabs((double)recorded[k].demand[i]));

    {p}_init(gains, &memory, &recorded[0].setpoint, &recorded[0].measurement);
    for (int k = 0; k < TICKS; k++) {{
        const recorded_tick *row = &recorded[k];
        {p}_real demand[{n}]{command};
        {p}_step(gains, &memory, &row->setpoint, &row->measurement, demand);
        for (int i = 0; i < {n}; i++) {{
            const double off = fabs((double)demand[i] - (double)row->demand[i]);
            worst = fmax(worst, off);
            beyond += !(off <= BOUND * largest); /* NaN counts */
{limited}        }}
{settle}    }}
    printf("%d ticks, largest difference %.2g {what.command_unit} of %.3g {what.command_unit}: "
           "%.2g, bound %g: %s\\n",
           TICKS, worst, largest, largest > 0.0 ? worst / largest : 0.0, BOUND,
           beyond ? "FAILED" : "passed");
    return beyond ? 1 : 0;
}}
"""


def makefile(what: Identity) -> str:
    """Targets check, size and clean."""
    p = what.prefix
    promotion = " -Wdouble-promotion" if what.single else ""
    return f"""# {what.mark}
#
#   make check                    compile, replay the recorded ticks, compare
#   make clean check CC=clang     the same with another compiler
#   make size CROSS=arm-none-eabi- CC=arm-none-eabi-gcc CFLAGS="-Os -fstack-usage \\
#     {ARM}"

CC = cc
CFLAGS = -O2
WARNINGS = -std=c99 -Wall -Wextra -pedantic{promotion}
LAW = {p}.c {p}_gains.c

check: replay
\t./replay

replay: replay.c recorded.h {p}.h $(LAW)
\t$(CC) $(WARNINGS) $(CFLAGS) -o $@ replay.c $(LAW) -lm

size: {p}.h $(LAW)
\t$(CC) $(WARNINGS) $(CFLAGS) -c $(LAW)
\t$(CROSS)size {p}.o {p}_gains.o

clean:
\trm -f replay *.o *.su

.PHONY: check size clean
"""


#: a Cortex-M4 with its unit for single precision
ARM = "-mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16"


def readme(law: LawGraph, what: Identity, ticks: int) -> str:
    """What is in the folder, how to call it, how it was checked."""
    p = what.prefix
    title = textwrap.fill(f"{what.title}, control period {what.period:g} s.", 98)
    left = {group: unused(law, group) for group in ("setpoint", "measurement", "gains")}
    missing = "".join(f"  {group}: {', '.join(names)}\n" for group, names in left.items() if names)
    if missing:
        missing = f"\nWhat this law does not use, and its structs do not hold:\n{missing}"
    rounded = (
        "Samples and gains are rounded to single precision, the simulation computes in double.\n"
    )
    return f"""{what.mark}

{title}

{p}.h        structs with the unit and meaning of every member, the functions
{p}.c        the law: C99 and math.h, no heap, no recursion, no state outside {p}_memory
{p}_gains.c  the gains of this export, as a constant
recorded.h, replay.c, Makefile    `make check` replays {ticks} ticks of the simulated closed loop
export.json  what was exported, and the checksums of these files

Calls

{call_order(law, what)}
All functions only touch what they are given: several axes or machines need one {p}_memory each.
The control period is part of the law; another one needs another export.
{missing}
Check

`make check` prints the largest difference between the demands of this C text and those of the
simulation at the same samples, and fails beyond {BOUND[what.single]:g} of the largest demand.
{rounded if what.single else ""}"""
