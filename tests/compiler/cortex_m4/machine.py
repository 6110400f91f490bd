"""A Cortex-M4F, emulated by QEMU's board mps2-an386: builds exported laws and runs them."""

import re
import subprocess
from pathlib import Path
from typing import NamedTuple

from jaxstage.c_export.replay import ARM

HERE = Path(__file__).parent
COMPILER = "arm-none-eabi-gcc"
LAW = "control.c control_gains.c"
_LINK = "--specs=rdimon.specs -Wl,--section-start=.isr_vector=0 -lm"
_MACHINE = (
    "timeout 60 qemu-system-arm -M mps2-an386 -nographic -monitor none -serial none "
    "-semihosting-config enable=on,target=native"
)


def run(words, folder):
    """The output of a program. Raises CalledProcessError where it fails."""
    return subprocess.run(
        words.split(), cwd=folder, check=True, capture_output=True, text=True
    ).stdout


def build(folder, main, flags=""):
    """Link ``main`` with the law in a folder: ``program``."""
    sources = f"{HERE}/startup.c {main} {LAW}"
    run(f"{COMPILER} -std=gnu99 -Os {ARM} {flags} -I. {sources} {_LINK} -o program", folder)


def emulate(folder, options=""):
    """What ``program`` prints."""
    return run(f"{_MACHINE} {options} -kernel program", folder)


class Needs(NamedTuple):
    """What a law needs, in bytes: code, gains in flash, memory, largest stack of a call. And the
    instructions of one period, those of math.h included."""

    code: int
    gains: int
    memory: int
    stack: int
    instructions: int


def needs(folder):
    """Build a law in single precision with -Os and count."""
    run(f"{COMPILER} -std=c99 -Os {ARM} -fstack-usage -c {LAW}", folder)
    code, gains = (
        int(line.split()[0])
        for line in run("arm-none-eabi-size control.o control_gains.o", folder).splitlines()[1:]
    )
    usage = (folder / "control.su").read_text(encoding="utf-8")
    stack = max(int(size) for size in re.findall(r"control_(?:step|settle)\t(\d+)", usage))
    settles = "control_settle" in (folder / "control.h").read_text(encoding="utf-8")
    build(folder, HERE / "count.c", "-DSETTLES" if settles else "")
    memory, instructions = map(int, emulate(folder, "-icount shift=0").split())
    return Needs(code, gains, memory, stack, instructions)
