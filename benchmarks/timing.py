"""Timing in turn (A B A B ...), and what machine this is."""

import os
import platform
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jaxlib
import numpy as np

Program = Callable[[], Any]


class Times(NamedTuple):
    """Seconds of one program: first call (with compilation), best, median, and the median of the
    processor time over all threads, which other programs on the machine disturb less. (Some systems
    book the time of a thread late: single values, the best above all, may be far too small.)"""

    first: float
    best: float
    median: float
    cpu: float

    @property
    def compiling(self) -> float:
        return max(self.first - self.median, 0.0)


def first_calls(programs: Mapping[str, Program], workers: int = 1) -> dict[str, tuple[float, Any]]:
    """Seconds and result of the first call of each program."""

    def call(program: Program) -> tuple[float, Any]:
        begin = time.perf_counter()
        result = jax.block_until_ready(program())
        return time.perf_counter() - begin, result

    with ThreadPoolExecutor(workers) as pool:
        return dict(zip(programs, pool.map(call, programs.values()), strict=True))


def in_turn(
    programs: Mapping[str, Program],
    first: Mapping[str, tuple[float, Any]],
    budget: float,
    rounds: int = 3,
) -> dict[str, Times]:
    """Time all programs in turn: at least `rounds` rounds, more while `budget` seconds last.

    What takes less than 20 ms runs up to five times in its turn.
    """
    walls: dict[str, list[float]] = {name: [] for name in programs}
    cpu: dict[str, list[float]] = {name: [] for name in programs}
    begin = time.perf_counter()
    done = 0
    while done < rounds or (time.perf_counter() - begin < budget and done < 50):
        for name, program in programs.items():
            repeats = 5 if walls[name] and walls[name][-1] < 0.02 else 1
            for _ in range(repeats):
                start, used = time.perf_counter(), time.process_time()
                jax.block_until_ready(program())
                walls[name].append(time.perf_counter() - start)
                cpu[name].append(time.process_time() - used)
        done += 1
    return {
        name: Times(first[name][0], min(w), float(np.median(w)), float(np.median(cpu[name])))
        for name, w in walls.items()
    }


def machine() -> dict[str, str]:
    """Processor, cores, compiler and versions, in words."""
    model = platform.processor() or "unknown"
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = cpuinfo.read_text(encoding="utf-8").splitlines()
        model = next((x.split(":")[1].strip() for x in lines if x.startswith("model name")), model)
        flags = next((x for x in lines if x.startswith("flags")), "")
        model += ", " + next(
            (f for f in ("avx512f", "avx2", "sse2") if f in flags), "no SIMD found"
        )
    gxx = "none"
    if shutil.which("g++"):
        answer = subprocess.run(["g++", "--version"], capture_output=True, text=True, check=True)
        gxx = answer.stdout.splitlines()[0]
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    return {
        "processor": model,
        "cores": f"{os.cpu_count()}, load at the start {load:.1f}",
        "compiler": gxx,
        "python": platform.python_version(),
        "jax": f"{jax.__version__} (jaxlib {jaxlib.__version__}), {jax.local_device_count()} "
        f"{jax.default_backend()} devices",
    }
