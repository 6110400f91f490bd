"""A C program around an exported law: samples in, demands and memory out, sanitizers watching."""

import subprocess

import jax
import numpy as np

from jaxstage.c_export.law_graph import trace
from jaxstage.c_export.source_files import Identity, gains_source, header, source, used

STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror")
SANE = ("-fsanitize=undefined,address", "-fno-sanitize-recover=all")

PROGRAM = """
#include <stdio.h>
#include "control.h"

int main(void)
{
    const control_gains *gains = &control_exported_gains;
    control_setpoint setpoint;
    control_measurement measurement;
    control_memory memory;
    control_real demand[CONTROL_AXES], command[CONTROL_AXES];
    int begun = 0;
    while (fread(&setpoint, sizeof setpoint, 1, stdin) == 1
            && fread(&measurement, sizeof measurement, 1, stdin) == 1
            && fread(command, sizeof command, 1, stdin) == 1) {
        if (!begun++)
            control_init(gains, &memory, &setpoint, &measurement);
        control_step(gains, &memory, &setpoint, &measurement, demand);
        fwrite(demand, sizeof demand, 1, stdout);
        SHOW
        SETTLE
    }
    return 0;
}
"""


def run(*words, cwd, given=None, status=0):
    """The output of a program that has to end with ``status``."""
    done = subprocess.run(
        list(map(str, words)), cwd=cwd, input=given, capture_output=True, check=False
    )
    assert done.returncode == status, (done.stdout[-2000:], done.stderr[-4000:])
    return done.stdout


def written(files, folder):
    """The files in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def identity(controller, axes, single=False, prefix="control"):
    """What the files of a law say of themselves."""
    return Identity(
        loop="a loop", law=controller.name, prefix=prefix,
        axes=tuple(f"a{i}" for i in range(axes)), period=1e-3, command_unit="A", single=single,
        version="0",
    )  # fmt: skip


def law_files(law, what):
    """Header, source and gains."""
    p = what.prefix
    return {
        f"{p}.h": header(law, what),
        f"{p}.c": source(law, what),
        f"{p}_gains.c": gains_source(law, what),
    }


def drive(controller, gains, setpoint, measurement, command, dt, folder, single=False):
    """Demands (ticks, axes) and memory (ticks, numbers) of the C text of a law.

    setpoint, measurement: leaves (ticks, ...) in the precision of the text. command: (ticks, axes).
    """
    first = jax.tree.map(lambda x: np.asarray(x)[0], (setpoint, measurement))
    with jax.enable_x64(not single):
        law = trace(controller, gains, *first, dt, "A")
    what = identity(controller, law.axes, single)
    settle = "control_settle(gains, &memory, demand, command);" if law.settle else ""
    show = "fwrite(&memory, sizeof memory, 1, stdout);" if law.memory else ""
    program = PROGRAM.replace("SETTLE", settle).replace("SHOW", show)
    written({**law_files(law, what), "driver.c": program}, folder)
    sources = ("driver.c", "control.c", "control_gains.c")
    run("gcc", *STRICT, "-O0", *SANE, *sources, "-o", "driver", "-lm", cwd=folder)
    real = np.float32 if single else np.float64
    columns = []
    for group, tree in (("setpoint", setpoint), ("measurement", measurement)):
        kept = {m.names for m in used(law, group)}
        for member, leaf in zip(getattr(law, group), jax.tree.leaves(tree), strict=True):
            if member.names in kept:
                columns.append(np.asarray(leaf, real).reshape(len(command), -1))
        assert kept, f"the law has to read the {group}"
    columns.append(np.asarray(command, real))
    given = np.ascontiguousarray(np.concatenate(columns, axis=1)).tobytes()
    out = np.frombuffer(run("./driver", cwd=folder, given=given), real)
    rows = out.reshape(len(command), -1)
    return rows[:, : law.axes], rows[:, law.axes :]
