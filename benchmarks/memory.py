"""``python -m benchmarks.memory [--quick] [--whole]``: peak memory, in processes of their own."""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax

import jaxstage as js

from .cases import work
from .gradients import gradient, segmented
from .jax_runs import batched
from .tables import table

ROOT = Path(__file__).parents[1]


class Peak(NamedTuple):
    """MB above the process with JAX started: inputs, first call (compiling), second call; s."""

    inputs: float
    first: float
    second: float
    seconds: float


def status(name: str) -> float:
    """VmRSS or VmHWM of this process in MB.

    Not getrusage: its maximum goes on from the parent's memory at the fork.
    """
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return int(next(x for x in lines if x.startswith(name)).split()[1]) / 1024


def forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")


def _measure(make: Callable[[], Callable[[], Any]], calls: int) -> Peak:
    jax.block_until_ready(jax.numpy.zeros(1) + 1)
    base = status("VmRSS")
    program = make()
    inputs = status("VmRSS") - base
    peaks = []
    begin = time.perf_counter()
    for _ in range(calls):
        forget_peak()
        begin = time.perf_counter()
        jax.block_until_ready(program())
        peaks.append(status("VmHWM") - base)
    return Peak(inputs, peaks[0], peaks[-1], time.perf_counter() - begin)


def _child(words: str) -> None:
    """Measure one thing in this process and print it as JSON.

    words: ``rollouts,dtype,lanes,ticks,lap_time`` or ``gradient,dtype,lanes,ticks,lap_time``.
    """
    kind, dtype, *numbers = words.split(",")
    lanes, ticks, lap_time = int(numbers[0]), int(numbers[1]), float(numbers[2])

    def make() -> Callable[[], Any]:
        if kind == "gradient":
            return gradient(segmented(dtype, lanes, ticks), jax.grad)
        runs = work("dfcmac", dtype, lanes, ticks, lap_time=lap_time)
        return batched(runs, 128, jax.local_device_count())

    print(json.dumps(_measure(make, 1 if kind == "gradient" else 2)))


def peak(kind: str, dtype: str, lanes: int, ticks: int, lap_time: float) -> Peak | None:
    """Peak memory of a batch or its gradient, None where this system does not tell."""
    if not Path("/proc/self/clear_refs").exists():
        return None
    words = f"{kind},{dtype},{lanes},{ticks},{lap_time}"
    command = [sys.executable, "-m", "benchmarks.memory", "--child", words]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return Peak(*json.loads(answer.stdout.splitlines()[-1]))


def peaks(quick: bool, whole: bool) -> str:
    """The table. whole: runs of all their ticks, where a few of them need the same memory."""
    jobs = [("rollouts", 10_000, 10_000, 1.0, 200)]
    if not quick:
        jobs += [("rollouts", 10_000, 100_000, 10.0, 200), ("gradient", 64, 100_000, 1.0, 100_000)]
    rows, note = [], ""
    for kind, lanes, ticks, lap_time, short in jobs:
        done = ticks if whole else short
        measured = peak(kind, "float32", lanes, done, lap_time)
        if measured is None:
            return "\nPeak memory: not measured, this system has no /proc/self/clear_refs"
        numbers = [f"{x:.0f}" for x in measured[:3]] + [f"{measured.seconds:.1f}"]
        rows.append([f"{kind}, {lanes} runs of {ticks} ticks", *numbers, str(done)])
    if not whole:
        note = "\nWhere fewer ticks were run: a program without rows needs the same for any number."
    head = ("dfcmac float32", "inputs MB", "1st call MB", "2nd call MB", "s", "ticks run")
    text = (
        "Peak above a process that has started JAX, each in its own process; the first call\n"
        "compiles. Runs differ in gains and plant and share the path (a lap of all its ticks)."
    )
    return table("Peak memory", head, rows, text + note)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.memory", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one line: 10 000 runs")
    parser.add_argument("--whole", action="store_true", help="whole runs (minutes)")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    options = parser.parse_args()
    js.configure(cores=2)
    jax.config.update("jax_platforms", "cpu")
    if options.child:
        _child(options.child)
    else:
        print(peaks(options.quick, options.whole))


if __name__ == "__main__":
    main()
