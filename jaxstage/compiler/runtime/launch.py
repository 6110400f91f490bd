"""Calls of kernels under JAX arrays: a run, its derivatives, long runs in pieces."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxstage.compiler.cxx.kernels import Kernel
from jaxstage.compiler.frontend.step_program import row_structure
from jaxstage.compiler.runtime.packing import (
    Call,
    RunBatch,
    at_tick,
    carry,
    in_lanes,
    of_ticks,
    parameters,
    prepare,
    shared,
    stacked,
    tables,
    typed_back,
    unpack,
)
from jaxstage.compiler.runtime.toolchain import build


def invoke(
    call: Call, results: list[Any], first: Any, count: int, state: Any, more: tuple[Any, ...] = ()
) -> list[Array]:
    """Call a kernel through XLA's foreign function interface.

    Args:
        call: The runs and their kernel.
        results: Shape and type of each result.
        first: Tick at which it begins, counted from the start of the call.
        count: Ticks.
        state: Carry, as the kernel takes it.
        more: Tangents or cotangents.

    Returns:
        The results.
    """
    target = build(call.kernel.text(call.batch.vectors)).target
    shapes = [jax.ShapeDtypeStruct(shape, dtype) for shape, dtype in results]
    numbers = of_ticks(call, first, count)
    arguments = (*parameters(call), *shared(call), *numbers, *state, *tables(call), *more)
    return list(jax.ffi.ffi_call(target, shapes)(*arguments))


def pieces(
    piece: Callable[[Any, Any, int], tuple[Any, Any]], state: Any, ticks: int, length: int
) -> tuple[Any, Any]:
    """Run the ticks in pieces of one length, and what is left over.

    The numbers of all ticks of a piece are in memory at once.

    Args:
        piece: ``piece(state, first, count) -> (state, rows)``.
        state: Before the first tick.
        ticks: Of all pieces.
        length: Ticks of a piece.

    Returns:
        The last state, and the rows of all ticks.
    """
    if ticks <= length:
        return piece(state, 0, ticks)
    whole, rest = divmod(ticks, length)
    firsts = jnp.arange(whole, dtype=jnp.int32) * length
    state, rows = lax.scan(lambda s, first: piece(s, first, length), state, firsts)
    rows = jax.tree.map(lambda r: r.reshape(whole * length, *r.shape[2:]), rows)
    if rest:
        state, last = piece(state, whole * length, rest)
        rows = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), rows, last)
    return state, rows


def forward(batch: RunBatch, kernel: Kernel, args: Any) -> list[Array]:
    """Run the ticks.

    Args:
        batch: The runs.
        kernel: The kernel ``forward``.
        args: The leaves of the program.

    Returns:
        Leaves of the carry after the ticks, then of the rows (runs, ticks, ...).
    """
    call = prepare(batch, kernel, args)
    counts = kernel.counts

    def piece(state: Any, first: Any, count: int) -> Any:
        c, ci = state
        shapes = [
            (c.shape, call.real),
            (ci.shape, np.int32),
            ((count, counts["row"], call.lanes), call.real),
            ((count, counts["rowi"], call.lanes), np.int32),
        ]
        c, ci, row, rowi = invoke(call, shapes, first, count, state)
        return (c, ci), (row, rowi)

    state, rows = pieces(piece, carry(call), batch.ticks, call.piece)
    return [*after(call, state), *stored(call, rows)]


def tangent(batch: RunBatch, kernel: Kernel, moving: tuple[int, ...], args: Any) -> list[Array]:
    """Push tangents through the ticks.

    Args:
        batch: The runs.
        kernel: The kernel ``tangent``.
        moving: Leaves beside the carry that have tangents.
        args: The leaves, then the tangents of the moving ones, then of the real carry.

    Returns:
        Tangents of the real carry after the ticks, the batch leading.
    """
    count = len(batch.program.leaves)
    call = prepare(_of_leaves(batch), kernel, args[:count])
    middle = count + len(moving)
    q = _derivatives(call, args[count:middle], batch.batched[count:])
    d = _derivatives(call, args[middle:], batch.batched[middle:])

    def piece(state: Any, first: Any, length: int) -> Any:
        c, ci, d = state
        shapes = [(c.shape, call.real), (ci.shape, np.int32), (d.shape, call.real)]
        return tuple(invoke(call, shapes, first, length, (c, ci), (q, d))), None

    (_, _, d), _ = pieces(piece, (*carry(call), d), batch.ticks, call.piece)
    return unpack(call, d, [batch.program.carry[i] for i in batch.program.real_carry])


def pullback(
    batch: RunBatch, backward: Kernel, onward: Kernel, moving: tuple[int, ...], args: Any
) -> list[Array]:
    """Pull cotangents back through the ticks.

    Long runs go forward first, keeping the carry at the start of every piece, then back piece by
    piece.

    Args:
        batch: The runs.
        backward: The kernel ``pullback``.
        onward: The kernel ``forward``.
        moving: Leaves beside the carry that have cotangents.
        args: The leaves, then the cotangents of the real carry.

    Returns:
        Cotangents of the moving leaves and of the real carry, the batch leading.
    """
    program, ticks, count = batch.program, batch.ticks, len(batch.program.leaves)
    back_call, on_call = (prepare(_of_leaves(batch), k, args[:count]) for k in (backward, onward))
    real = back_call.real
    g = _derivatives(back_call, args[count:], batch.batched[count:])
    leaves = [program.leaves[i] for i in moving]
    a = jnp.zeros((sum(math.prod(x.shape) for x in leaves), back_call.lanes), real)
    shapes = [(a.shape, real), (g.shape, real)]

    def back(sums: Any, first: Any, length: int, state: Any) -> tuple[Array, Array]:
        a, g = sums
        more, g = invoke(back_call, shapes, first, length, state, (g,))
        return a + more, g

    def on(state: Any, first: Any, length: int) -> Any:
        c, ci = state
        none = [((length, 0, on_call.lanes), t) for t in (real, np.int32)]
        moved = invoke(
            on_call, [(c.shape, real), (ci.shape, np.int32), *none], first, length, state
        )
        return (moved[0], moved[1]), state

    state, length = carry(back_call), back_call.piece
    if ticks <= length:
        a, g = back((a, g), 0, ticks, state)
    else:
        whole, rest = divmod(ticks, length)
        firsts = jnp.arange(whole, dtype=jnp.int32) * length
        state, kept = lax.scan(lambda s, first: on(s, first, length), state, firsts)
        if rest:
            a, g = back((a, g), whole * length, rest, state)
        (a, g), _ = lax.scan(
            lambda s, at: (back(s, at[0], length, at[1]), None),
            (a, g),
            (firsts, kept),
            reverse=True,
        )
    carried = [program.carry[i] for i in program.real_carry]
    return [*unpack(back_call, a, leaves), *unpack(back_call, g, carried)]


def _of_leaves(batch: RunBatch) -> RunBatch:
    """The batch of the leaves alone, without that of tangents or cotangents."""
    return batch._replace(batched=batch.batched[: len(batch.program.leaves)])


def _derivatives(call: Call, leaves: Any, batched: Any) -> Array:
    """Tangents or cotangents as (elements, lanes)."""
    pairs = zip(leaves, batched[: len(leaves)], strict=True)
    rows = [in_lanes(call, x, b, call.real) for x, b in pairs]
    return stacked(rows, call.lanes, call.real)


def after(call: Call, state: Any) -> list[Array]:
    """The leaves of the carry."""
    program, kernel = call.program, call.kernel
    ends: dict[int, Array] = {}
    for real, rows in zip((True, False), state, strict=True):
        numbers = [n for n, (r, _) in kernel.layout.carry.items() if r == real]
        leaves = unpack(call, rows, [program.carry[n] for n in numbers])
        ends.update(zip(numbers, leaves, strict=True))
    for number in kernel.lowered.counter:
        start = call.args[program.num_consts + number]
        end = start + jnp.asarray(call.batch.ticks, start.dtype)
        ends[number] = jnp.broadcast_to(end, (call.batch.runs,))
    return [ends[n] for n in range(len(program.carry))]


def stored(call: Call, rows: Any) -> list[Array]:
    """The leaves of the rows: those of the kernel, and those that all runs share."""
    program, staged = call.program, call.kernel.lowered.staged
    _, _, runs, ticks = call.batch
    out = []
    for number, leaf in enumerate(row_structure(program)[1]):
        shape = (runs, ticks, *leaf.shape)
        if number in call.kernel.rows:
            real, first = call.kernel.rows[number]
            part = rows[0 if real else 1][:, first : first + math.prod(leaf.shape), :runs]
            out.append(typed_back(jnp.moveaxis(part, -1, 0).reshape(shape), leaf.dtype))
            continue
        value = staged.program.results[len(program.carry) + number]

        def one(ahead: Array, value: Any = value, leaf: Any = leaf) -> Array:
            return jnp.asarray(at_tick(call, ahead)[value], leaf.dtype)

        every = jax.vmap(one)(jnp.arange(ticks, dtype=jnp.int32))
        out.append(jnp.broadcast_to(every[None], shape))
    return out
