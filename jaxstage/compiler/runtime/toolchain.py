"""C++ toolchain: from a translation unit to a function that XLA can call; built once, cached.

A library in the cache is loaded only when it is whole and nobody else can have written it: it ends
in the SHA-256 of what stands before, and its folder belongs to this user alone.
"""

import ctypes
import functools
import hashlib
import os
import platform
import shlex
import shutil
import signal
import subprocess
import tempfile
import time
import warnings
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import jax
import jaxlib.version

from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.system.files import distrust, keep_name, private_folder
from jaxstage.system.runtime import cache_folder

HEADER = Path(__file__).parents[1] / "cxx" / "simd.h"
#: no fast-math: NaN, infinity and the order of operations keep their meaning. A symbol that is
#: missing is an error here, not when the library is loaded.
FLAGS = tuple(
    "-std=c++17 -O2 -march=native -fno-math-errno -fno-trapping-math -ffp-contract=fast -w -shared "
    "-fPIC".split()
)
LINKED = ("-Wl,-z,defs", "-lm") if platform.system() == "Linux" else ("-lm",)
VECTOR = ("-lmvec",) if platform.machine() == "x86_64" else ()
COMPILERS = ("g++", "clang++", "c++")
#: s that a kernel may take to compile; the environment variable `LIMIT_NAME` changes it
LIMIT, LIMIT_NAME = 600.0, "JAXSTAGE_COMPILE_SECONDS"
#: s that the compiler may take to tell its version
ANSWER = 30.0
#: bytes of the SHA-256 at the end of a library
DIGEST = 32


class Compiler(NamedTuple):
    """A C++ compiler that answers.

    Attributes:
        name: What messages call it, with the environment variable that it stems from.
        command: Program and its own options.
        version: What it says of itself.
    """

    name: str
    command: tuple[str, ...]
    version: str


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
def compiler() -> Compiler | str:
    """The C++ compiler, or why there is none.

    It is that of the environment variable CXX, read as a shell does (``ccache g++``), else the
    first of `COMPILERS` on the PATH.
    """
    chosen = os.environ.get("CXX", "").strip()
    if not chosen:
        program = next((file for name in COMPILERS if (file := shutil.which(name))), None)
        if program is None:
            return "no C++ compiler (g++ or clang++) was found"
        return _answering(program, (program,))
    try:
        first, *options = shlex.split(chosen)
    except ValueError as error:
        return f"CXX = {chosen}: {error}"
    program = shutil.which(first)
    if program is None:
        return f"CXX = {chosen}: there is no program '{first}'"
    return _answering(f"CXX = {chosen}", (program, *options))


def _answering(name: str, command: tuple[str, ...]) -> Compiler | str:
    """The compiler, if it tells its version."""
    try:
        answer = _run([*command, "--version"], ANSWER)
    except OSError as error:
        return f"{name}: {error.strerror}"
    except subprocess.TimeoutExpired:
        return f"{name}: no answer to --version in {ANSWER:g} s"
    if answer.returncode:
        return f"{name}: --version ends with status {answer.returncode}"
    return Compiler(name, command, answer.stdout)


def compiler_name() -> str | None:
    """The command of the C++ compiler, or None."""
    chosen = compiler()
    return None if isinstance(chosen, str) else shlex.join(chosen.command)


@functools.cache
def _processor() -> str:
    """What -march=native depends on."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() + platform.machine()
    kept = [x for x in lines if x.startswith(("flags", "model name", "Features", "CPU part"))]
    return "\n".join(sorted(set(kept)))


# --- the cache -----------------------------------------------------------------------------------


@functools.cache
def _folder() -> Path:
    """Where libraries are kept: beside compiled programs, else in a folder of this process."""
    kept = cache_folder()
    if kept:
        try:
            folder = private_folder(Path(kept) / "kernels")
            reason = distrust(folder)
            if reason is None and os.access(folder, os.W_OK):
                _remove_leftovers(folder)
                return folder
            if reason is not None:
                warnings.warn(f"no cache of kernels: {folder}: {reason}", stacklevel=2)
        except OSError:
            pass
    return Path(_temporary().name)


@functools.cache
def _temporary() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="jaxstage-")


def _remove_leftovers(folder: Path) -> None:
    """Remove what a compilation left behind that was killed: older than any may become."""
    for leftover in folder.glob("tmp*"):
        with suppress(OSError):
            if time.time() - leftover.stat().st_mtime > 2 * time_limit():
                shutil.rmtree(leftover)


def library_file(text: str, chosen: Compiler) -> Path:
    """Where the library of a kernel is kept.

    The name is a hash of all that the library depends on: its text, header, options, compiler,
    processor and jaxlib. Another machine with the same cache never loads it.
    """
    header = HEADER.read_text(encoding="utf-8")
    options = " ".join((*chosen.command, *FLAGS, *LINKED))
    machine = (_processor(), chosen.version, jaxlib.version.__version__)
    key = "\n".join((text, header, options, *machine))
    return _folder() / f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.so"


def _opened(file: Path) -> ctypes.CDLL | None:
    """Load a library, or give None where it is missing, damaged, or could be somebody else's.

    Loading a file that is cut short or zeroed would end the process: its SHA-256 comes first.
    """
    if not file.exists():
        return None
    reason = distrust(file)
    if reason is not None:
        warnings.warn(f"a kernel of the cache is built anew: {file}: {reason}", stacklevel=2)
        return None
    data = file.read_bytes()
    if hashlib.sha256(data[:-DIGEST]).digest() != data[-DIGEST:]:
        return None
    try:
        library = ctypes.CDLL(str(file))
        return library if hasattr(library, "kernel") else None
    except OSError:
        return None


# --- compiling -----------------------------------------------------------------------------------


@functools.cache
def build(text: str) -> KernelLibrary:
    """Compile a kernel, or take it from the cache, and make it known to XLA.

    Args:
        text: A translation unit that defines ``kernel``.

    Returns:
        The name that XLA knows it by, and how it came about.

    Raises:
        LoweringError: Without a compiler, when it fails or takes too long, and without space for
            the library.
    """
    chosen = compiler()
    if isinstance(chosen, str):
        raise LoweringError(chosen)
    file = library_file(text, chosen)
    begin, cached = time.perf_counter(), True
    try:
        library = _opened(file)
        if library is None:
            cached = False
            _compile(chosen, text, file)
            library = _opened(file)
    except OSError as error:
        raise LoweringError(f"{file.parent} cannot be written: {error}") from error
    if library is None:
        raise LoweringError(f"the kernel {file} cannot be loaded")
    target = f"jaxstage_{file.stem}"
    jax.ffi.register_ffi_target(target, jax.ffi.pycapsule(library.kernel), platform="cpu")
    seconds = 0.0 if cached else time.perf_counter() - begin
    return KernelLibrary(target, seconds, file.stat().st_size - DIGEST, cached)


def _compile(chosen: Compiler, text: str, file: Path) -> None:
    """Compile a unit into a file, under another name first: it is there whole or not at all.

    Raises:
        LoweringError: Where the compiler fails or takes too long, or has done so before.
        OSError: Without space.
    """
    if _overdue():
        raise LoweringError(_overdue()[0])
    with tempfile.TemporaryDirectory(prefix="tmp", dir=file.parent) as folder:
        source, library = Path(folder) / "kernel.cc", Path(folder) / "kernel.so"
        source.write_text(text, encoding="utf-8")
        includes = [f"-I{HEADER.parent}", f"-I{jax.ffi.include_dir()}"]
        command = [*chosen.command, *FLAGS, *includes, str(source), "-o", str(library)]
        done = _limited(chosen, [*command, *VECTOR, *LINKED])
        if done.returncode and VECTOR:  # without the vector functions of glibc
            done = _limited(chosen, [*command, "-DNO_LIBMVEC", *LINKED])
        if done.returncode:
            first = next((x for x in done.stderr.splitlines() if "error" in x), "no message")
            raise LoweringError(f"{chosen.name} failed: {first.strip()[:200]}")
        _finish(library)
        os.replace(library, file)
    keep_name(file.parent)


def _finish(library: Path) -> None:
    """Add the SHA-256 of a library, and put it on the disk, for its owner alone to change."""
    with library.open("r+b") as stream:
        digest = hashlib.sha256(stream.read()).digest()
        stream.write(digest)
        stream.flush()
        os.fsync(stream.fileno())
    library.chmod(0o700)


def time_limit() -> float:
    """Seconds that a kernel may take to compile.

    Raises:
        LoweringError: Where the environment variable holds no positive number.
    """
    text = os.environ.get(LIMIT_NAME, "").strip()
    if not text:
        return LIMIT
    try:
        limit = float(text)
    except ValueError:
        limit = 0.0
    if not 0 < limit < float("inf"):
        raise LoweringError(f"{LIMIT_NAME} = {text}: must be a number of seconds > 0")
    return limit


@functools.cache
def _overdue() -> list[str]:
    """Why this process compiles no more: one kernel took too long."""
    return []


def _limited(chosen: Compiler, command: list[str]) -> subprocess.CompletedProcess[str]:
    limit = time_limit()
    try:
        return _run(command, limit)
    except subprocess.TimeoutExpired:
        reason = f"{chosen.name} took more than {limit:g} s ({LIMIT_NAME} changes that)"
        _overdue().append(reason)
        raise LoweringError(reason) from None


def _run(command: list[str], limit: float) -> subprocess.CompletedProcess[str]:
    """Run a program in a session of its own, and end all of it when it takes too long.

    Raises:
        subprocess.TimeoutExpired: After ``limit`` s.
        OSError: Where it cannot be started.
    """
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=pipe,
        stderr=pipe,
        text=True,
        errors="replace",
        start_new_session=True,
    ) as process:
        try:
            out, err = process.communicate(timeout=limit)
        except BaseException:
            with suppress(OSError):
                os.killpg(process.pid, signal.SIGKILL)
            raise
    return subprocess.CompletedProcess(command, process.returncode, out, err)
