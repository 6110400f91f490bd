"""Kernels under JAX arrays: packing runs into lanes, numbers of the ticks, long runs in pieces."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxstage.compiler.cxx.kernels import INTERLEAVE, Kernel
from jaxstage.compiler.frontend.binding_time import CONSTANT, FIXED, TICK, run
from jaxstage.compiler.frontend.step_program import Program, row_structure
from jaxstage.compiler.runtime.toolchain import build

#: lanes of the widest vector of any processor, in single and double: batches are padded to them
WIDEST = {True: 16, False: 8}
#: runs from which on all batches of a program have the same kernel
MANY = INTERLEAVE * max(WIDEST.values())
#: the most numbers of ticks that are kept at once
KEPT = 2**18


class RunBatch(NamedTuple):
    """Runs of a program that go through time together.

    Attributes:
        program: The loop.
        batched: Which operands have a leading axis of ``runs``.
        runs: How many.
        ticks: Control periods.
    """

    program: Program
    batched: tuple[bool, ...]
    runs: int
    ticks: int

    @property
    def vectors(self) -> int:
        """Vectors of the widest processor that hold the runs, many as whole groups."""
        return vectors(self.program, self.runs)


def vectors(program: Program, runs: int) -> int:
    """Vectors of the widest processor that hold the runs; many, whole groups of `INTERLEAVE`."""
    count = -(-runs // WIDEST[program.single])
    return count if count < INTERLEAVE else count + -count % INTERLEAVE


class Call(NamedTuple):
    """One call of a kernel.

    Attributes:
        batch: The runs.
        kernel: What computes them.
        args: The leaves of the program.
        fixed: Values that all runs and ticks share, by their number in the staged program.
    """

    batch: RunBatch
    kernel: Kernel
    args: tuple[Any, ...]
    fixed: dict[int, Any]

    @property
    def program(self) -> Program:
        """The loop."""
        return self.batch.program

    @property
    def real(self) -> type[np.floating]:
        """The type of its reals."""
        return np.float32 if self.program.single else np.float64

    @property
    def lanes(self) -> int:
        """Runs, padded to whole vectors; many, to vectors that go through time together."""
        return self.batch.vectors * WIDEST[self.program.single]

    @property
    def piece(self) -> int:
        """Ticks whose numbers are kept at once."""
        slots = self.kernel.layout.groups["r"]
        return max(KEPT // (len(slots.real) + len(slots.whole) + 1), 256)


def prepare(batch: RunBatch, kernel: Kernel, args: Any) -> Call:
    """A call, with what JAX computes once for all runs and ticks."""
    staged = kernel.lowered.staged
    values = dict(staged.program.constants)
    for number, value in enumerate(staged.program.arguments[: len(batch.program.leaves)]):
        if staged.of(value) == FIXED:
            values[value] = args[number]
    run([s for s in staged.shared(CONSTANT) if s.reads or s.writes], values)
    run(staged.shared(FIXED), values)
    return Call(batch, kernel, tuple(args), values)


# --- packing -----------------------------------------------------------------------------------


def in_lanes(call: Call, leaf: Array, batched: bool, dtype: Any) -> Array:
    """A leaf as (elements, lanes); lanes that only fill a vector repeat the last run."""
    runs = call.batch.runs
    if batched:
        flat = leaf.reshape(runs, -1).T
        return jnp.pad(_as(flat, dtype), ((0, 0), (0, call.lanes - runs)), mode="edge")
    return jnp.broadcast_to(_as(leaf, dtype).reshape(-1, 1), (leaf.size, call.lanes))


def _as(array: Array, dtype: Any) -> Array:
    if array.dtype == jnp.uint32:
        return lax.bitcast_convert_type(array, jnp.int32)
    return array.astype(dtype)


def _stacked(rows: list[Array], lanes: int, dtype: Any) -> Array:
    return jnp.concatenate(rows) if rows else jnp.zeros((0, lanes), dtype)


def _chosen(slots: dict[tuple[int, int], int], take: Callable[[int], Array], empty: Array) -> Array:
    """The rows of the slots in order. take(number): the (elements, ...) of an array."""
    used: dict[int, list[int]] = {}
    for number, element in slots:
        used.setdefault(number, []).append(element)
    if not used:
        return empty
    order = {}
    for number, elements in used.items():
        order |= {(number, e): len(order) + i for i, e in enumerate(elements)}
    rows = jnp.concatenate([take(n)[np.array(e)] for n, e in used.items()])
    index = np.array([order[key] for key in sorted(slots, key=lambda k: slots[k])])
    return rows if (index == np.arange(len(index))).all() else rows[index]


def parameters(call: Call) -> tuple[Array, Array]:
    """P and PI."""
    slots = call.kernel.layout.groups["p"]

    def group(table: dict[tuple[int, int], int], dtype: Any) -> Array:
        empty = jnp.zeros((0, call.lanes), dtype)

        def leaf(number: int) -> Array:
            return in_lanes(call, call.args[number], call.batch.batched[number], dtype)

        return _chosen(table, leaf, empty)

    return group(slots.real, call.real), group(slots.whole, np.int32)


def shared(call: Call) -> tuple[Array, Array]:
    """S and SI."""
    slots = call.kernel.layout.groups["s"]

    def group(table: dict[tuple[int, int], int], dtype: Any) -> Array:
        empty = jnp.zeros((0,), dtype)
        return _chosen(table, lambda n: _as(call.fixed[n], dtype).reshape(-1), empty)

    return group(slots.real, call.real), group(slots.whole, np.int32)


def at_tick(call: Call, ahead: Any) -> dict[int, Any]:
    """The values that all runs share at a tick, ``ahead`` of the first."""
    program, low = call.program, call.kernel.lowered
    values = dict(call.fixed)
    for number in low.counter:
        position = program.num_consts + number
        start = call.args[position]
        values[low.staged.program.arguments[position]] = start + jnp.asarray(ahead, start.dtype)
    run(low.staged.shared(TICK), values)
    return values


def of_ticks(call: Call, first: Any, count: int) -> tuple[Array, Array]:
    """R and RI of ``count`` ticks."""
    slots = call.kernel.layout.groups["r"]

    def one(ahead: Array) -> tuple[Array, Array]:
        values = at_tick(call, ahead)

        def group(table: dict[tuple[int, int], int], dtype: Any) -> Array:
            empty = jnp.zeros((0,), dtype)
            return _chosen(table, lambda n: _as(values[n], dtype).reshape(-1), empty)

        return group(slots.real, call.real), group(slots.whole, np.int32)

    return jax.vmap(one)(first + jnp.arange(count, dtype=jnp.int32))


def tables(call: Call) -> list[Array]:
    """Arrays that the kernel reads by index."""
    arrays = [call.fixed[value] for value in call.kernel.lowered.tables]
    real = [jnp.issubdtype(x.dtype, jnp.floating) for x in arrays]
    return [
        x.astype(call.real if r else np.int32).reshape(-1)
        for x, r in zip(arrays, real, strict=True)
    ]


def carry(call: Call) -> tuple[Array, Array]:
    """C and CI."""
    program, out = call.program, {True: [], False: []}
    for number, (real, _) in call.kernel.layout.carry.items():
        position = program.num_consts + number
        dtype = call.real if real else np.int32
        out[real].append(in_lanes(call, call.args[position], call.batch.batched[position], dtype))
    reals = _stacked(out[True], call.lanes, call.real)
    return reals, _stacked(out[False], call.lanes, np.int32)


def unpack(call: Call, rows: Array, shapes: list[Any]) -> list[Array]:
    """(slots, lanes) as arrays with the batch leading."""
    out, at = [], 0
    for leaf in shapes:
        count = math.prod(leaf.shape)
        part = rows[at : at + count, : call.batch.runs].T.reshape(call.batch.runs, *leaf.shape)
        out.append(_back(part, leaf.dtype))
        at += count
    return out


def _back(array: Array, dtype: Any) -> Array:
    if dtype == jnp.uint32:
        return lax.bitcast_convert_type(array, jnp.uint32)
    return array.astype(dtype)


# --- calling -----------------------------------------------------------------------------------


def invoke(
    call: Call, results: list[Any], first: Any, count: int, state: Any, more: tuple[Any, ...] = ()
) -> list[Array]:
    """The kernel over ``count`` ticks. results: shapes and types; more: derivatives."""
    target = build(call.kernel.text(call.batch.vectors)).target
    shapes = [jax.ShapeDtypeStruct(shape, dtype) for shape, dtype in results]
    numbers = of_ticks(call, first, count)
    arguments = (*parameters(call), *shared(call), *numbers, *state, *tables(call), *more)
    return list(jax.ffi.ffi_call(target, shapes)(*arguments))


def pieces(
    piece: Callable[[Any, Any, int], tuple[Any, Any]], state: Any, ticks: int, length: int
) -> tuple[Any, Any]:
    """Run the ticks in pieces of one length, and what is left over."""
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
    """Leaves of the carry and of the rows after the ticks, the batch leading."""
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
    return _stacked(rows, call.lanes, call.real)


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
            out.append(_back(jnp.moveaxis(part, -1, 0).reshape(shape), leaf.dtype))
            continue
        value = staged.program.results[len(program.carry) + number]

        def one(ahead: Array, value: Any = value, leaf: Any = leaf) -> Array:
            return jnp.asarray(at_tick(call, ahead)[value], leaf.dtype)

        every = jax.vmap(one)(jnp.arange(ticks, dtype=jnp.int32))
        out.append(jnp.broadcast_to(every[None], shape))
    return out
