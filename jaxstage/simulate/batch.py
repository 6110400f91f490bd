"""Many runs at once: lanes on the last axis, in tiles that stay in the cache, on every device.

`rollouts` gives what ``jax.vmap(simulate)`` gives. Inside the scan the batch is the LAST axis of
every array; tiles of lanes run one after the other, and the tiles are spread over the XLA devices
(one per core, see `runtime.configure`). Leaves that are not batched are shared, never copied.
"""

import functools
from collections.abc import Callable
from functools import partial
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.sharding import Mesh, PartitionSpec

from jaxstage.compiler.runtime.api import refusal
from jaxstage.model.blocks import Loop
from jaxstage.model.fields import replace
from jaxstage.model.signals import Carry, Run, Scenario
from jaxstage.model.validate import SHARED, check
from jaxstage.simulate.rollout import (
    advance,
    compiled_form,
    fields_named,
    report,
    scan_ticks,
    start,
    whole_run,
)
from jaxstage.simulate.tiles import remembered_tile

#: the tick counter is the same for all lanes, so that the path is looked up once
_LANES = cast(Any, Carry)(
    **dict.fromkeys(
        ("state", "drive", "sensor", "memory", "metric", "left_path_at", "non_finite_at"), -1
    ),
    step=None,
)


def rollouts(
    loop: Loop,
    gains: Any,
    scenario: Scenario,
    path: Any,
    ticks: int,
    in_axes: Any = (0, None, None),
    tile: int | None = None,
    devices: int | None = None,
    memory: float = 2e9,
) -> Run:
    """Simulate many runs; every leaf of the result has the batch as its leading axis.

    in_axes: (gains, scenario, path), each 0, None or a tree of these down to any depth, as for
    ``jax.vmap``: 0 where leaves have a leading batch axis. tile: lanes that run together; None
    measures it once per loop and machine and remembers it. devices: how many XLA devices share
    the tiles; None takes all. memory: budget in bytes for the results, so that recording many
    long runs is refused rather than swapped. The tile does not change a bit of a result; the
    number of devices changes the last ones (XLA compiles the partitioned program on its own;
    1e-11 of the value was seen). A lost run is flagged in its own lane and changes nothing in the
    others.

    Raises ValueError for bad input, naming the value and the run; for batches of different size;
    for tile, devices or ticks < 1; for results beyond the memory budget.
    """
    if ticks < 1:
        raise ValueError(f"ticks must be >= 1, got {ticks}")
    axes = spread_axes(in_axes, (gains, scenario, path))
    gains, scenario, path = check(loop, gains, scenario, path, axes)
    leaves, structure = jax.tree.flatten((gains, scenario, path))
    batched = tuple(a != SHARED for a in jax.tree.leaves(axes))
    lanes = count_lanes(leaves, batched, structure)
    available = jax.local_device_count()
    devices = min(available, lanes) if devices is None else devices
    if not 1 <= devices <= available:
        raise ValueError(f"devices = {devices}: must be 1..{available}")
    with fields_named(loop):
        lowered = _is_compiled(loop, ticks, structure, batched, leaves)
        _check_memory(loop, ticks, structure, batched, leaves, lanes, memory)
    if tile is None and lowered:
        tile = -(-lanes // devices)  # a kernel goes through its lanes by itself
    if tile is None:
        tile = remembered_tile(_tile_program(loop, structure, batched), leaves, batched, lanes)
    if tile < 1:
        raise ValueError(f"tile = {tile}: must be >= 1")
    # a tile of one lane would be compiled to another program, with other last bits
    tile = max(2, min(tile, -(-lanes // devices)))
    return _rollouts(loop, ticks, tile, devices, lowered, structure, batched, leaves)


def _is_compiled(
    loop: Loop, ticks: int, structure: Any, batched: tuple[bool, ...], leaves: list[Array]
) -> bool:
    """Whether the engine of the loop compiles these runs."""
    if ticks < loop.engine.shortest:
        return False
    one = [
        jax.ShapeDtypeStruct(x.shape[1:] if b else x.shape, x.dtype)
        for x, b in zip(leaves, batched, strict=True)
    ]
    return _refusal(loop, structure, batched, tuple(one)) is None


@functools.cache
def _refusal(
    loop: Loop, structure: Any, batched: tuple[bool, ...], one: tuple[jax.ShapeDtypeStruct, ...]
) -> str | None:
    """Why a batch is not compiled, or None. one: shapes of one run."""
    found: list[str | None] = []

    def trace(leaves: list[Array]) -> None:
        gains, scenario, path = jax.tree.unflatten(structure, leaves)
        begin = start(loop, gains, scenario, path)
        program, numbers = compiled_form(loop, gains, scenario, path, begin)
        flags = (*batched, *(False,) * (len(numbers) - len(batched)))
        found.append(refusal(program, flags))

    jax.eval_shape(trace, list(one))
    return found[0]


def spread_axes(in_axes: Any, trees: Any) -> Any:
    """The tree of batch axes, one a leaf: 0 or `SHARED`, from a prefix with 0 or None."""
    prefix = jax.tree.map(
        lambda a: SHARED if a is None else a, in_axes, is_leaf=lambda a: a is None
    )
    axes = jax.tree.broadcast(prefix, trees)
    wrong = {a for a in jax.tree.leaves(axes) if a not in (0, SHARED)}
    if wrong:
        raise ValueError(f"in_axes holds {sorted(wrong)}: must be 0 or None")
    return axes


def count_lanes(leaves: list[Array], batched: tuple[bool, ...], structure: Any) -> int:
    """The size of the batch. Raises ValueError when leaves disagree or none is batched.

    structure: of (gains, scenario, path).
    """
    sizes = {np.shape(x)[:1] for x, b in zip(leaves, batched, strict=True) if b}
    if len(sizes) != 1 or () in sizes:
        told = _sizes(leaves, batched, structure)
        raise ValueError(f"batched leaves need one common leading size: {told}")
    return sizes.pop()[0]


def _sizes(leaves: list[Array], batched: tuple[bool, ...], structure: Any) -> str:
    """The first leaf of each leading size, by name."""
    if not any(batched):
        return "in_axes has no 0"
    first: dict[int, str] = {}
    named = jax.tree_util.tree_leaves_with_path(jax.tree.unflatten(structure, leaves))
    for (place, leaf), flag in zip(named, batched, strict=True):
        root = ("gains", "scenario", "path")[place[0].idx]
        size = np.shape(leaf)[0] if np.shape(leaf) else 0
        if flag:
            first.setdefault(size, f"{root}{jax.tree_util.keystr(place[1:])}")
    return ", ".join(f"{name} has {size or 'none'}" for size, name in first.items())


def run_tile(
    loop: Loop, ticks: int, leaves: list[Array], structure: Any, batched: tuple[bool, ...]
) -> Run:
    """One tile of lanes, batch leading at the border and last inside the scan."""
    inputs = [jnp.moveaxis(x, 0, -1) if b else x for x, b in zip(leaves, batched, strict=True)]
    last = [-1 if b else None for b in batched]

    def begin(values: list[Array]) -> Carry:
        return start(loop, *jax.tree.unflatten(structure, values))

    def step(carry: Carry, values: list[Array]) -> tuple[Carry, Any]:
        gains, scenario, path = jax.tree.unflatten(structure, values)
        return advance(loop, gains, scenario, path, carry)

    every = jax.vmap(step, in_axes=(_LANES, last), out_axes=(_LANES, -1))
    carry = jax.vmap(begin, in_axes=(last,), out_axes=_LANES)(inputs)
    carry, rows = scan_ticks(loop, ticks, lambda c: every(c, inputs), carry)
    finish = jax.vmap(lambda c: report(loop, c), in_axes=(_LANES,), out_axes=0)
    lanes = carry.left_path_at.shape[-1]
    steps = jnp.broadcast_to(carry.step, (lanes,))
    leading = jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), (replace(carry, step=steps), rows))
    return Run(report=finish(carry), rows=leading[1], final=leading[0])


def run_lanes(
    loop: Loop, ticks: int, leaves: list[Array], structure: Any, batched: tuple[bool, ...]
) -> Run:
    """Lanes of a compiled loop."""

    def one(*values: Array) -> Run:
        return whole_run(loop, ticks, *jax.tree.unflatten(structure, values))

    return jax.vmap(one, in_axes=tuple(0 if b else None for b in batched))(*leaves)


@functools.cache
def _tile_program(
    loop: Loop, structure: Any, batched: tuple[bool, ...]
) -> Callable[[int, list[Array]], Run]:
    """`run_tile` of one batch, the identical function for equal batches."""
    return partial(run_tile, loop, structure=structure, batched=batched)


@partial(jax.jit, static_argnums=(0, 1, 2, 3, 4, 5, 6))
def _rollouts(
    loop: Loop,
    ticks: int,
    tile: int,
    devices: int,
    lowered: bool,
    structure: Any,
    batched: tuple[bool, ...],
    leaves: list[Array],
) -> Run:
    lanes = count_lanes(leaves, batched, structure)
    tiles = -(-lanes // (tile * devices)) * devices
    # lanes that only fill the last tile repeat the last run
    index = jnp.minimum(jnp.arange(tiles * tile), lanes - 1)
    moving = [x[index].reshape(tiles, tile, *x.shape[1:]) for x, b in zip(leaves, batched) if b]  # noqa: B905
    shared = [x for x, b in zip(leaves, batched, strict=True) if not b]

    def all_tiles(moving: list[Array], shared: list[Array]) -> Run:
        def one(values: list[Array]) -> Run:
            own, common = iter(values), iter(shared)
            merged = [next(own) if b else next(common) for b in batched]
            return (run_lanes if lowered else run_tile)(loop, ticks, merged, structure, batched)

        return lax.map(one, moving)

    # on one device too: the same program, so the same bits, whatever the number of devices
    mesh = Mesh(np.array(jax.local_devices()[:devices]), ("tiles",))
    along, everywhere = PartitionSpec("tiles"), PartitionSpec()
    spread = jax.shard_map(
        all_tiles, mesh=mesh, in_specs=(along, everywhere), out_specs=along, check_vma=False
    )
    result = spread(moving, shared)
    return jax.tree.map(lambda x: x.reshape(tiles * tile, *x.shape[2:])[:lanes], result)


@functools.cache
def _bytes_of_a_run(
    loop: Loop,
    ticks: int,
    structure: Any,
    batched: tuple[bool, ...],
    shapes: tuple[jax.ShapeDtypeStruct, ...],
) -> int:
    """Bytes that the result of one run takes."""
    result = jax.eval_shape(lambda v: run_tile(loop, ticks, v, structure, batched), list(shapes))
    return sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(result))


def _check_memory(
    loop: Loop,
    ticks: int,
    structure: Any,
    batched: tuple[bool, ...],
    leaves: list[Array],
    lanes: int,
    memory: float,
) -> None:
    one = tuple(
        jax.ShapeDtypeStruct((1, *x.shape[1:]) if b else x.shape, x.dtype)
        for x, b in zip(leaves, batched, strict=True)
    )
    needed = lanes * _bytes_of_a_run(loop, ticks, structure, batched, one)
    if needed > memory:
        raise ValueError(
            f"{lanes} runs of {ticks} ticks would return {needed / 1e9:.3g} GB, more than the "
            f"budget of {memory / 1e9:.3g} GB: record fewer runs, or raise memory"
        )
