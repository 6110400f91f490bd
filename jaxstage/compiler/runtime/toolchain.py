"""C++ toolchain: from a translation unit to a function that XLA can call; built once, cached."""

import ctypes
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import jax
import jaxlib.version

from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.system.runtime import cache_folder

HEADER = Path(__file__).parents[1] / "cxx" / "simd.h"
#: no fast-math: NaN, infinity and the order of operations keep their meaning
FLAGS = tuple(
    "-std=c++17 -O2 -march=native -fno-math-errno -fno-trapping-math -ffp-contract=fast -w -shared "
    "-fPIC".split()
)
COMPILERS = ("g++", "clang++", "c++")


class KernelLibrary(NamedTuple):
    """A kernel that is loaded.

    Attributes:
        target: The name under which XLA knows it.
        seconds: Time of the compiler in s, 0 where the cache had it.
        bytes: Size of the library.
        cached: Whether the cache had it.
    """

    target: str
    seconds: float
    bytes: int
    cached: bool


@functools.cache
def compiler() -> str | None:
    """The C++ compiler: that of the environment variable CXX, else the first of `COMPILERS`."""
    chosen = os.environ.get("CXX")
    names = (chosen,) if chosen else COMPILERS
    return next((file for name in names if (file := shutil.which(name))), None)


@functools.cache
def _machine() -> str:
    """What -march=native depends on, and the library that the kernel is called by."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        kept = [x for x in lines if x.startswith(("flags", "model name", "Features", "CPU part"))]
        processor = "\n".join(sorted(set(kept)))
    except OSError:
        processor = platform.processor() + platform.machine()
    version = subprocess.run(
        [compiler() or "", "--version"], capture_output=True, text=True, check=False
    ).stdout
    return "\n".join((processor, version, jaxlib.version.__version__))


@functools.cache
def _folder() -> Path:
    """Where libraries are kept: beside compiled programs, else in a folder of this process."""
    kept = cache_folder()
    if kept:
        folder = Path(kept) / "kernels"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                return folder
        except OSError:
            pass
    return Path(_temporary().name)


@functools.cache
def _temporary() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="jaxstage-")


def library_file(text: str) -> Path:
    """Where the library of a kernel is kept: by its text and all that it depends on."""
    key = "\n".join((text, HEADER.read_text(encoding="utf-8"), " ".join(FLAGS), _machine()))
    return _folder() / f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.so"


@functools.cache
def build(text: str) -> KernelLibrary:
    """Compile a kernel, or take it from the cache, and make it known to XLA.

    Args:
        text: A translation unit that defines ``kernel``.

    Returns:
        The name that XLA knows it by, and how it came about.

    Raises:
        LoweringError: Without a compiler, when it fails, and without space for the library.
    """
    program = compiler()
    if program is None:
        raise LoweringError("no C++ compiler (g++ or clang++) was found")
    file = library_file(text)
    begin, cached = time.perf_counter(), True
    library = _opened(file)
    if library is None:
        cached = False
        try:
            _compile(program, text, file)
        except OSError as error:
            raise LoweringError(f"{file.parent} cannot be written: {error}") from error
        library = _opened(file)
    if library is None:
        raise LoweringError(f"the kernel {file} cannot be loaded")
    target = f"jaxstage_{file.stem}"
    jax.ffi.register_ffi_target(target, jax.ffi.pycapsule(library.kernel), platform="cpu")
    seconds = 0.0 if cached else time.perf_counter() - begin
    return KernelLibrary(target, seconds, file.stat().st_size, cached)


def _opened(file: Path) -> ctypes.CDLL | None:
    """The library, or None where it is missing or damaged."""
    if not file.exists():
        return None
    try:
        library = ctypes.CDLL(str(file))
        return library if hasattr(library, "kernel") else None
    except OSError:
        return None


def _compile(program: str, text: str, file: Path) -> None:
    """Under another name first: a library is there whole or not at all."""
    with tempfile.TemporaryDirectory(dir=file.parent) as folder:
        source, library = Path(folder) / "kernel.cc", Path(folder) / "kernel.so"
        source.write_text(text, encoding="utf-8")
        includes = [f"-I{HEADER.parent}", f"-I{jax.ffi.include_dir()}"]
        libraries = ["-lmvec", "-lm"] if platform.machine() == "x86_64" else ["-lm"]
        command = [program, *FLAGS, *includes, str(source), "-o", str(library)]
        done = _run([*command, *libraries])
        if done.returncode and "-lmvec" in libraries:
            done = _run([*command, "-lm"])
        if done.returncode:
            first = next((x for x in done.stderr.splitlines() if "error" in x), "no message")
            raise LoweringError(f"{Path(program).name} failed: {first.strip()[:200]}")
        os.replace(library, file)


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False)
