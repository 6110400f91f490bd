"""Packing of runs into lanes: from JAX arrays to the operands of a kernel, and back."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxstage.compiler.cxx.kernels import INTERLEAVE, Kernel
from jaxstage.compiler.frontend.binding_time import CONSTANT, FIXED, TICK, run
from jaxstage.compiler.frontend.step_program import Program

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


def stacked(rows: list[Array], lanes: int, dtype: Any) -> Array:
    """Rows of (elements, lanes) one below the other, also where there are none."""
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


def _group(
    call: Call, name: str, take: Callable[[int, Any], Array], rest: tuple[int, ...] = ()
) -> tuple[Array, Array]:
    """Reals and integers of the slots of a group.

    take(number, dtype): an array of the group as (elements, *rest).
    """
    slots = call.kernel.layout.groups[name]

    def of(table: dict[tuple[int, int], int], dtype: Any) -> Array:
        return _chosen(table, lambda n: take(n, dtype), jnp.zeros((0, *rest), dtype))

    return of(slots.real, call.real), of(slots.whole, np.int32)


def parameters(call: Call) -> tuple[Array, Array]:
    """P and PI, (slots, lanes)."""

    def leaf(number: int, dtype: Any) -> Array:
        return in_lanes(call, call.args[number], call.batch.batched[number], dtype)

    return _group(call, "p", leaf, (call.lanes,))


def shared(call: Call) -> tuple[Array, Array]:
    """S and SI, (slots,)."""
    return _group(call, "s", lambda n, dtype: _as(call.fixed[n], dtype).reshape(-1))


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
    """R and RI of ``count`` ticks, (ticks, slots)."""

    def one(ahead: Array) -> tuple[Array, Array]:
        values = at_tick(call, ahead)
        return _group(call, "r", lambda n, dtype: _as(values[n], dtype).reshape(-1))

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
    """C and CI, (slots, lanes)."""
    program, out = call.program, {True: [], False: []}
    for number, (real, _) in call.kernel.layout.carry.items():
        position = program.num_consts + number
        dtype = call.real if real else np.int32
        out[real].append(in_lanes(call, call.args[position], call.batch.batched[position], dtype))
    reals = stacked(out[True], call.lanes, call.real)
    return reals, stacked(out[False], call.lanes, np.int32)


def unpack(call: Call, rows: Array, shapes: list[Any]) -> list[Array]:
    """Arrays with the batch leading, from rows of lanes.

    Args:
        call: The runs.
        rows: (slots, lanes).
        shapes: Shape and type of each array of one run, in the order of the slots.
    """
    out, at = [], 0
    for leaf in shapes:
        count = math.prod(leaf.shape)
        part = rows[at : at + count, : call.batch.runs].T.reshape(call.batch.runs, *leaf.shape)
        out.append(typed_back(part, leaf.dtype))
        at += count
    return out


def typed_back(array: Array, dtype: Any) -> Array:
    """What a kernel gives, in the type of its leaf; unsigned integers by their bits."""
    if dtype == jnp.uint32:
        return lax.bitcast_convert_type(array, jnp.uint32)
    return array.astype(dtype)
