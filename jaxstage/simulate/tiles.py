"""How many lanes run best together: measured once per loop and machine, then remembered."""

import functools
import hashlib
import json
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.core import Tracer

from jaxstage.system.runtime import cache_folder

CANDIDATES = (64, 256, 1024)
TICKS = 200
#: used where nothing can be measured (under a trace) and nothing is remembered
DEFAULT = 256


def remembered_tile(
    run: Callable[[int, list[Array]], Any],
    leaves: list[Array],
    batched: tuple[bool, ...],
    lanes: int,
) -> int:
    """The best tile of a batch, from the notes of an earlier run or by a short measurement.

    run(ticks, leaves): simulates the lanes it is given; the identical function for equal batches,
    so that the loop is traced for its key only once. Batches that fit the smallest candidate
    are not worth a measurement.
    """
    if lanes <= CANDIDATES[0]:
        return lanes
    if any(isinstance(x, Tracer) for x in leaves):
        return DEFAULT
    key = _key(run, tuple(jax.eval_shape(lambda v: _lanes(v, batched, 2), leaves)))
    known = _known()
    if key not in known:
        known.update(_read())
    if key not in known:
        known[key] = _measure(run, leaves, batched, lanes)
        _write(_read() | {key: known[key]})
    return known[key]


@functools.cache
def _known() -> dict[str, int]:
    """The tiles that this process has read or measured."""
    return {}


def _lanes(leaves: list[Array], batched: tuple[bool, ...], count: int) -> list[Array]:
    index = jnp.arange(count)
    return [x[index % x.shape[0]] if b else x for x, b in zip(leaves, batched, strict=True)]


def _measure(
    run: Callable[[int, list[Array]], Any],
    leaves: list[Array],
    batched: tuple[bool, ...],
    lanes: int,
) -> int:
    """The candidate with the least time per lane and tick, best of three."""
    program = jax.jit(run, static_argnums=0)
    costs = {}
    for tile in (c for c in CANDIDATES if c < 2 * lanes):
        values = _lanes(leaves, batched, tile)
        jax.block_until_ready(program(TICKS, values))
        times = []
        for _ in range(3):
            begin = time.perf_counter()
            jax.block_until_ready(program(TICKS, values))
            times.append(time.perf_counter() - begin)
        costs[tile] = min(times) / tile
    return min(costs, key=lambda tile: costs[tile])


@functools.cache
def _key(run: Callable[[int, list[Array]], Any], shapes: tuple[jax.ShapeDtypeStruct, ...]) -> str:
    """Identifies the loop by what it computes, and the machine."""
    text = str(jax.make_jaxpr(lambda v: run(1, v))(list(shapes)))
    parts = (text, jax.__version__, jax.default_backend(), platform.processor(), platform.node())
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


def _file() -> Path | None:
    folder = cache_folder()
    return Path(folder) / "tiles.json" if folder else None


def _read() -> dict[str, int]:
    file = _file()
    try:
        return json.loads(file.read_text()) if file else {}
    except (OSError, ValueError):
        return {}


def _write(known: dict[str, int]) -> None:
    file = _file()
    if file is None:
        return
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        partial = file.with_suffix(f".{os.getpid()}")
        partial.write_text(json.dumps(known))
        os.replace(partial, file)
    except OSError:
        return  # a read-only cache costs a measurement next time, nothing else
