"""How JAX runs: precision, devices, compilation cache. Importing changes nothing.

Call `configure` before the first array exists.
"""

import gc
import os
import platform
import tempfile
import warnings
from contextlib import suppress
from pathlib import Path

import jax

from jaxstage.system.files import distrust, private_folder

#: new objects between two rounds of Python's garbage collector, and rounds between longer ones
COLLECTED = (100_000, 20, 100)


def configure(
    precision: str = "double", cores: int | None = None, cache: str | Path | None = None
) -> None:
    """Set precision, XLA devices and compilation cache for this process.

    Python's garbage collector is told to run seldom, see `collect_seldom`. Where XLA logs that a
    cached program was built for another machine it compares tuning flags; the environment variable
    ``TF_CPP_MIN_LOG_LEVEL=3`` silences it, as the command line does.

    Args:
        precision: ``double`` (64 bit) or ``single``.
        cores: XLA host devices, one per core; None leaves JAX's choice.
        cache: Folder that keeps compiled programs for the next start; ``default`` is
            ``$XDG_CACHE_HOME/jaxstage``, None leaves JAX's setting. A new folder is private; one
            that cannot be written, or that others may write, is warned of and left out.

    Raises:
        ValueError: For a bad value.
        RuntimeError: When JAX has already started with another number of devices.
    """
    if precision not in ("single", "double"):
        raise ValueError(f"precision = '{precision}': must be single or double")
    if cores is not None:
        if cores < 1:
            raise ValueError(f"cores = {cores}: must be >= 1")
        try:
            jax.config.update("jax_num_cpu_devices", cores)
        except RuntimeError:
            raise RuntimeError(
                f"cores = {cores}: JAX has already started with {jax.local_device_count()}; call "
                "configure before the first array exists, in a new process"
            ) from None
    jax.config.update("jax_enable_x64", precision == "double")
    collect_seldom()
    if cache is None:
        return
    folder = _default_cache() if cache == "default" else Path(cache)
    reason = _unusable(folder)
    if reason is not None:
        warnings.warn(f"no cache of compiled programs: {reason}", stacklevel=2)
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def _default_cache() -> Path | None:
    """``$XDG_CACHE_HOME/jaxstage``, or None where no home folder is known."""
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "jaxstage"
    except RuntimeError:
        return None


def _unusable(folder: Path | None) -> str | None:
    """Why a folder, made if it is missing, keeps no compiled programs, or None."""
    if folder is None:
        return "no home folder is known, set HOME or XDG_CACHE_HOME"
    try:
        reason = distrust(private_folder(folder))
        if reason is None:
            with tempfile.TemporaryFile(dir=folder):
                return None
    except OSError as error:
        reason = error.strerror
    return f"{folder}: {reason}"


def collect_seldom() -> None:
    """Have Python's garbage collector run after 100 000 new objects instead of 700.

    Tracing makes objects by the million, hardly any of them in cycles, and each round also calls
    XLA's collector: with Python's default two fifths of the time of tracing went into it.
    """
    gc.set_threshold(*COLLECTED)


def cache_folder() -> str | None:
    """Where compiled programs are kept, or None."""
    return jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]


def cpu_cores() -> int:
    """The cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def processor() -> str:
    """The model of what computes: of the accelerator, or of the processor as Linux names it; its
    architecture where no model is named."""
    kind = jax.local_devices()[0].device_kind
    if kind != "cpu":
        return kind
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            name = line.partition(":")[2].strip()
            if line.startswith("model name") and name:
                return name
    return platform.processor() or platform.machine()
