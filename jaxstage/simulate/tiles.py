"""Tile size of a batch: how many lanes run best together, measured once and remembered.

Autotuning of the portable engine. What is remembered stands in ``tiles.json`` of the cache folder,
by loop and machine.
"""

# what JAX gives is partly untyped
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownLambdaType=false

import functools
import hashlib
import json
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.core import Tracer

from jaxstage.system.files import private_folder, write_text
from jaxstage.system.runtime import cache_folder

CANDIDATES = (64, 256, 1024)
TICKS = 200
#: used where nothing can be measured (under a trace) and nothing is remembered
DEFAULT = 256

#: run(ticks, leaves) simulates the lanes that it is given
TileProgram = Callable[[int, list[Array]], Any]


def remembered_tile(
    run: TileProgram, batched: tuple[bool, ...], leaves: list[Array], lanes: int
) -> int:
    """The best tile of a batch, from an earlier run or by a short measurement.

    Batches that fit the smallest candidate are not worth a measurement.

    Args:
        run: The identical function for equal batches, so that the loop is traced for its key only
            once.
        batched: Which leaves have a leading batch axis.
        leaves: Of (gains, scenario, path).
        lanes: Size of the batch.

    Returns:
        Lanes that run together.
    """
    if lanes <= CANDIDATES[0]:
        return lanes
    if any(isinstance(x, Tracer) for x in leaves):
        return DEFAULT
    key = _key(run, tuple(jax.eval_shape(lambda v: _lanes(v, batched, 2), leaves)))
    tiles = _known_tiles()
    if key not in tiles:
        tiles.update(_read())
    if key not in tiles:
        tiles[key] = _measure(run, batched, leaves, lanes)
        _write(_read() | {key: tiles[key]})
    return tiles[key]


@functools.cache
def _known_tiles() -> dict[str, int]:
    """The tiles that this process has read or measured."""
    return {}


def _lanes(leaves: list[Array], batched: tuple[bool, ...], count: int) -> list[Array]:
    """The leaves of so many lanes, repeated where the batch has fewer."""
    index = jnp.arange(count)
    return [x[index % x.shape[0]] if b else x for x, b in zip(leaves, batched, strict=True)]


def _measure(run: TileProgram, batched: tuple[bool, ...], leaves: list[Array], lanes: int) -> int:
    """The candidate with the least time per lane and tick, best of three."""
    program = jax.jit(run, static_argnums=0)
    costs: dict[int, float] = {}
    for tile in (c for c in CANDIDATES if c < 2 * lanes):
        values = _lanes(leaves, batched, tile)
        jax.block_until_ready(program(TICKS, values))
        times: list[float] = []
        for _ in range(3):
            begin = time.perf_counter()
            jax.block_until_ready(program(TICKS, values))
            times.append(time.perf_counter() - begin)
        costs[tile] = min(times) / tile
    return min(costs, key=lambda tile: costs[tile])


@functools.cache
def _key(run: TileProgram, shapes: tuple[jax.ShapeDtypeStruct, ...]) -> str:
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
        tiles: Any = json.loads(file.read_text(encoding="utf-8")) if file else {}
    except (OSError, ValueError, RecursionError):
        return {}
    items: dict[str, Any] = tiles if isinstance(tiles, dict) else {}
    return {key: tile for key, tile in items.items() if type(tile) is int and tile in CANDIDATES}


def _write(tiles: dict[str, int]) -> None:
    file = _file()
    if file is None:
        return
    try:
        private_folder(file.parent)
        write_text(file, json.dumps(tiles))
    except OSError:
        return  # a read-only cache costs a measurement next time, nothing else
