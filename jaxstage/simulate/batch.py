"""Batched rollout: many runs at once, lanes on the last axis, in tiles that stay in the cache.

`rollouts` gives what ``jax.vmap(simulate)`` gives. Inside the scan the batch is the LAST axis of
every array; tiles of lanes run one after the other, and the tiles are spread over the XLA devices
(one per core, see `runtime.configure`). Leaves that are not batched are shared, never copied.
"""

# what JAX gives is partly untyped
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownLambdaType=false

import functools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.sharding import Mesh, PartitionSpec

from jaxstage.compiler.runtime.api import refusal
from jaxstage.compiler.runtime.fallback import fall_back
from jaxstage.compiler.runtime.packing import MANY
from jaxstage.model.blocks import Loop
from jaxstage.model.fields import replace
from jaxstage.model.signals import Carry, Run, Scenario
from jaxstage.model.validate import SHARED, check
from jaxstage.simulate.rollout import (
    advance,
    check_ticks,
    compiled_form,
    fields_named,
    report,
    scan_ticks,
    start,
    whole_run,
)
from jaxstage.simulate.tiles import remembered_tile

#: a ``PyTreeDef``
Structure = Any
#: shapes of some leaves
Shapes = tuple[jax.ShapeDtypeStruct, ...]

#: the tick counter is the same for all lanes, so that the path is looked up once
_LANES = cast(Any, Carry)(
    **dict.fromkeys(
        ("state", "drive", "sensor", "memory", "metric", "left_path_at", "non_finite_at"), -1
    ),
    step=None,
)


class BatchSpec(NamedTuple):
    """What is static about a batch.

    Attributes:
        loop: What is fixed about a run.
        ticks: Control periods.
        structure: Tree structure of (gains, scenario, path).
        batched: Which leaves of it have a leading batch axis.
    """

    loop: Loop
    ticks: int
    structure: Structure
    batched: tuple[bool, ...]

    def shapes(self, leaves: Sequence[Array], lanes: tuple[int, ...] = ()) -> Shapes:
        """Shapes of the leaves, with ``lanes`` in place of the batch axis."""
        return tuple(
            jax.ShapeDtypeStruct((*lanes, *x.shape[1:]) if b else x.shape, x.dtype)
            for x, b in zip(leaves, self.batched, strict=True)
        )


class _Spreading(NamedTuple):
    """Lanes of a tile, devices that share the tiles, and whether a kernel computes them."""

    tile: int
    devices: int
    compiled: bool


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
    """Simulate many runs.

    The tile does not change a bit of a result. The number of devices changes the last bits: XLA
    compiles the partitioned program on its own (1e-11 of the value was seen). A lost run is flagged
    in its own lane and changes nothing in the others.

    Args:
        loop: What is fixed.
        gains: What is tuned.
        scenario: What is uncertain.
        path: What is commanded, the parameters of ``loop.reference``.
        ticks: Control periods.
        in_axes: (gains, scenario, path), each 0, None or a tree of these down to any depth, as for
            ``jax.vmap``: 0 where leaves have a leading batch axis.
        tile: Lanes that run together. None measures it once per loop and machine and remembers it.
        devices: How many XLA devices share the tiles. None takes all.
        memory: Budget in bytes for the results, so that recording many long runs is refused rather
            than swapped.

    Returns:
        The runs; every leaf has the batch as its leading axis.

    Raises:
        ValueError: For bad input, naming the value and the run; for batches of different size; for
            tile, devices or ticks < 1; for results beyond the memory budget.
        RuntimeError: Where ``loop.engine`` is `compiled` and these runs cannot be.
    """
    check_ticks(ticks)
    axes = spread_axes(in_axes, (gains, scenario, path))
    gains, scenario, path = check(loop, gains, scenario, path, axes)
    leaves, structure = jax.tree.flatten((gains, scenario, path))
    batch = BatchSpec(loop, ticks, structure, tuple(a != SHARED for a in jax.tree.leaves(axes)))
    lanes = count_lanes(leaves, batch.batched, structure)
    available = jax.local_device_count()
    devices = min(available, lanes) if devices is None else devices
    if not 1 <= devices <= available:
        raise ValueError(f"devices = {devices}: must be 1..{available}")
    if tile is not None and tile < 1:
        raise ValueError(f"tile = {tile}: must be >= 1")
    share = -(-lanes // devices)  # a kernel goes through its lanes by itself
    with fields_named(loop):
        compiled = _is_compiled(batch, leaves, _bounded_tile(tile or share, share))
        _check_memory(batch, leaves, lanes, memory)
    if tile is None:
        run = _tile_program(batch._replace(ticks=0))
        tile = share if compiled else remembered_tile(run, batch.batched, leaves, lanes)
    spreading = _Spreading(_bounded_tile(tile, share), devices, compiled)
    return _rollouts(batch, spreading, leaves)


def _bounded_tile(tile: int, share: int) -> int:
    """At most the lanes of a device; one lane would be another program, with other last bits."""
    return max(2, min(tile, share))


def _is_compiled(batch: BatchSpec, leaves: list[Array], tile: int) -> bool:
    """Whether a kernel computes these runs; where it should and cannot, this is said."""
    engine = batch.loop.engine
    if batch.ticks < engine.shortest:
        return False
    reason = _refusal(batch._replace(ticks=0), batch.shapes(leaves), min(tile, MANY))
    if reason is not None:
        fall_back(reason, engine.strict)
    return reason is None


@functools.cache
def _refusal(batch: BatchSpec, shapes: Shapes, tile: int) -> str | None:
    """Why a batch is not compiled, or None. shapes: of one run; tile: lanes of a kernel's call."""
    reason: str | None = None

    def trace(leaves: list[Array]) -> None:
        nonlocal reason
        gains, scenario, path = jax.tree.unflatten(batch.structure, leaves)
        begin = start(batch.loop, gains, scenario, path)
        program, numbers = compiled_form(batch.loop, gains, scenario, path, begin)
        flags = (*batch.batched, *(False,) * (len(numbers) - len(batch.batched)))
        reason = refusal(program, flags, tile)

    jax.eval_shape(trace, list(shapes))
    return reason


def spread_axes(in_axes: Any, trees: Any) -> Any:
    """Batch axes leaf by leaf, from a prefix.

    Args:
        in_axes: Tree prefix of 0 and None.
        trees: What it is a prefix of.

    Returns:
        A tree like ``trees`` of 0 and `SHARED`.

    Raises:
        ValueError: For another axis.
    """
    prefix = jax.tree.map(
        lambda a: SHARED if a is None else a, in_axes, is_leaf=lambda a: a is None
    )
    axes = jax.tree.broadcast(prefix, trees)
    wrong = {repr(a) for a in jax.tree.leaves(axes) if type(a) is not int or a not in (0, SHARED)}
    if wrong:
        raise ValueError(f"in_axes holds {', '.join(sorted(wrong))}: must be 0 or None")
    return axes


def count_lanes(leaves: Sequence[Array], batched: tuple[bool, ...], structure: Structure) -> int:
    """The size of a batch.

    Args:
        leaves: Of (gains, scenario, path).
        batched: Which of them have a leading batch axis.
        structure: Of (gains, scenario, path).

    Raises:
        ValueError: When leaves disagree or none is batched.
    """
    sizes = {np.shape(x)[:1] for x, b in zip(leaves, batched, strict=True) if b}
    if len(sizes) != 1 or () in sizes:
        told = _sizes(leaves, batched, structure)
        raise ValueError(f"batched leaves need one common leading size: {told}")
    return sizes.pop()[0]


def _sizes(leaves: Sequence[Array], batched: tuple[bool, ...], structure: Structure) -> str:
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


def run_tile(batch: BatchSpec, leaves: list[Array]) -> Run:
    """One tile of lanes as a scan, the batch leading at the border and last inside."""
    loop, ticks, structure, batched = batch
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


def _run_kernel(batch: BatchSpec, leaves: list[Array]) -> Run:
    """Lanes of a compiled loop."""

    def one(*values: Array) -> Run:
        return whole_run(batch.loop, batch.ticks, *jax.tree.unflatten(batch.structure, values))

    return jax.vmap(one, in_axes=tuple(0 if b else None for b in batch.batched))(*leaves)


@functools.cache
def _tile_program(batch: BatchSpec) -> Callable[[int, list[Array]], Run]:
    """`run_tile` of one batch, the identical function for equal batches."""
    return lambda ticks, leaves: run_tile(batch._replace(ticks=ticks), leaves)


@partial(jax.jit, static_argnums=(0, 1))
def _rollouts(batch: BatchSpec, spreading: _Spreading, leaves: list[Array]) -> Run:
    tile, devices, compiled = spreading
    batched = batch.batched
    lanes = count_lanes(leaves, batched, batch.structure)
    tiles = -(-lanes // (tile * devices)) * devices
    # lanes that only fill the last tile repeat the last run
    index = jnp.minimum(jnp.arange(tiles * tile), lanes - 1)
    own = [x for x, b in zip(leaves, batched, strict=True) if b]
    own = [x[index].reshape(tiles, tile, *x.shape[1:]) for x in own]
    shared = [x for x, b in zip(leaves, batched, strict=True) if not b]

    def all_tiles(own: list[Array], shared: list[Array]) -> Run:
        def one(values: list[Array]) -> Run:
            first, second = iter(values), iter(shared)
            merged = [next(first) if b else next(second) for b in batched]
            return (_run_kernel if compiled else run_tile)(batch, merged)

        return lax.map(one, own)

    # on one device too: the same program, so the same bits, whatever the number of devices
    mesh = Mesh(np.array(jax.local_devices()[:devices]), ("tiles",))
    along, everywhere = PartitionSpec("tiles"), PartitionSpec()
    spread = jax.shard_map(
        all_tiles, mesh=mesh, in_specs=(along, everywhere), out_specs=along, check_vma=False
    )
    result = spread(own, shared)
    return jax.tree.map(lambda x: x.reshape(tiles * tile, *x.shape[2:])[:lanes], result)


@functools.cache
def _bytes_of_a_run(batch: BatchSpec, shapes: Shapes) -> int:
    """Bytes that the result of one run takes. shapes: of a batch of one."""
    result = jax.eval_shape(lambda v: run_tile(batch, v), list(shapes))
    return sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(result))


def _check_memory(batch: BatchSpec, leaves: list[Array], lanes: int, memory: float) -> None:
    needed = lanes * _bytes_of_a_run(batch, batch.shapes(leaves, (1,)))
    if needed > memory:
        raise ValueError(
            f"{lanes} runs of {batch.ticks} ticks would return {needed / 1e9:.3g} GB, more than "
            f"the budget of {memory / 1e9:.3g} GB: record fewer runs, or raise memory"
        )
