"""Peak memory, measured in processes of their own."""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax

from .cases import work
from .gradients import gradient, segmented
from .jax_side import batched

ROOT = Path(__file__).parents[1]


class Peak(NamedTuple):
    """MB above the process with JAX started: inputs, first call (compiling), second call; s."""

    inputs: float
    first: float
    second: float
    seconds: float


def _status(name: str) -> float:
    """VmRSS or VmHWM of this process in MB.

    Not getrusage: its maximum goes on from the parent's memory at the fork.
    """
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return int(next(x for x in lines if x.startswith(name)).split()[1]) / 1024


def _forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")


def _measure(make: Callable[[], Callable[[], Any]], calls: int) -> Peak:
    jax.block_until_ready(jax.numpy.zeros(1) + 1)
    base = _status("VmRSS")
    program = make()
    inputs = _status("VmRSS") - base
    peaks = []
    begin = time.perf_counter()
    for _ in range(calls):
        _forget_peak()
        begin = time.perf_counter()
        jax.block_until_ready(program())
        peaks.append(_status("VmHWM") - base)
    return Peak(inputs, peaks[0], peaks[-1], time.perf_counter() - begin)


def child(words: str) -> None:
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
    command = [sys.executable, "-m", "benchmarks", "--child", words]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return Peak(*json.loads(answer.stdout.splitlines()[-1]))
