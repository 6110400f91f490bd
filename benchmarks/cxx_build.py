"""Builds the C++ kernels and calls them."""

import ctypes
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .cases import DT, LAWS, Work, parameter_rows, path_rows

HERE = Path(__file__).parent
FLAGS = ("-std=c++17", "-O3", "-march=native", "-shared", "-fPIC", "-pthread")


class Variant(NamedTuple):
    """How a kernel is built: bytes of a vector, vectors at a time, rows of empty cells skipped."""

    width: int
    block: int
    skip: int

    def __str__(self) -> str:
        cells = ", rows of unused cells skipped" if self.skip else ""
        return f"{8 * self.width} bit x {self.block}{cells}"


def widths() -> tuple[int, ...]:
    """The vector widths of this processor worth trying, in bytes."""
    try:
        flags = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        flags = ""
    if "avx2" not in flags:
        return (16,)
    return (64, 32) if "avx512f" in flags else (32,)


def compiler() -> str | None:
    """The path of g++, None where there is none."""
    return shutil.which("g++")


@functools.cache
def library(single: bool, variant: Variant) -> ctypes.CDLL:
    """The kernels in one precision; compiled once per source and machine."""
    real = "float" if single else "double"
    defines = [
        f"-DREAL={real}",
        f"-DBYTES={variant.width}",
        f"-DBLOCK={variant.block}",
        f"-DSKIP={variant.skip}",
    ]
    source = "".join((HERE / name).read_text() for name in ("kernels.cc", "simd.h"))
    text = "\n".join((source, *FLAGS, *defines, platform.node(), platform.processor()))
    folder = Path(tempfile.gettempdir()) / f"jaxstage-speed-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    target = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:20]}.so"
    if not target.exists():
        partial = target.with_suffix(f".{os.getpid()}-{id(variant)}")
        command = ["g++", *FLAGS, *defines, str(HERE / "kernels.cc"), "-o", str(partial)]
        subprocess.run(command, check=True, capture_output=True, text=True)
        partial.replace(target)
    kernels = ctypes.CDLL(str(target))
    kernels.block_lanes.restype = ctypes.c_int64
    return kernels


def build_all(variants: tuple[Variant, ...]) -> None:
    """Compile all variants in both precisions, two at a time."""
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda job: library(*job), [(s, v) for s in (True, False) for v in variants]))


class Kernel:
    """A C++ rollout of a batch, ready to run: ``kernel()`` gives the ATE of every run in m."""

    def __init__(self, work: Work, variant: Variant, threads: int = 1) -> None:
        self.kernels = library(work.single, variant)
        dtype = np.float32 if work.single else np.float64
        block = self.kernels.block_lanes()
        self.lanes, self.law, self.threads = work.lanes, LAWS.index(work.law), threads
        self.ticks, filled = work.ticks, -(-work.lanes // block) * block
        index = np.minimum(np.arange(filled), work.lanes - 1)
        self.rows = np.ascontiguousarray(parameter_rows(work)[:, index], dtype)
        self.path = np.ascontiguousarray(path_rows(work), dtype)
        self.ate = np.empty(filled, dtype)

    def __call__(self) -> np.ndarray:
        rows, path, ate = (ctypes.c_void_p(x.ctypes.data) for x in (self.rows, self.path, self.ate))
        self.kernels.run(
            self.law,
            self.threads,
            rows,
            path,
            ctypes.c_int64(self.ticks),
            ctypes.c_int64(self.ate.size),
            ctypes.c_double(DT),
            ate,
        )
        return self.ate[: self.lanes].copy()
