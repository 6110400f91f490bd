"""One control period of a loop as a function of flat arrays, and its derivatives."""

import dataclasses
import functools
import math
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.numerics.segmented_scan import segmented

Leaves = tuple[jax.ShapeDtypeStruct, ...]


class StepSpec(NamedTuple):
    """One control period, and what is known of its loop.

    Attributes:
        function: ``function(static, inputs, shared, carry) -> (carry, row)``.
        static: Hashable argument of it.
        segment: Ticks per checkpointed segment, where it runs as a scan; 0 for a plain scan.
        finite: The caller promises that the floats of the carry are finite in every run that still
            changes.
        strict: Whether to refuse rather than to run as a scan.
    """

    function: Callable[..., Any]
    static: Hashable = None
    segment: int = 0
    finite: bool = False
    strict: bool = False


@dataclasses.dataclass(frozen=True)
class Program:
    """A `StepSpec` with the structure of its arguments: what one run is made of.

    Attributes:
        spec: The control period.
        structures: Of inputs, shared and carry.
        inputs: Shapes of what may differ from run to run.
        shared: Shapes of what usually does not.
        carry: Shapes of what one tick hands to the next.
        keys: (leaf, implementation) of the random keys among all leaves, which travel as integers.
    """

    spec: StepSpec
    structures: tuple[Any, ...]
    inputs: Leaves
    shared: Leaves
    carry: Leaves
    keys: tuple[tuple[int, Any], ...]

    @property
    def leaves(self) -> Leaves:
        """All arguments: inputs, shared, carry."""
        return (*self.inputs, *self.shared, *self.carry)

    @property
    def num_consts(self) -> int:
        """Arguments that stand before the carry."""
        return len(self.inputs) + len(self.shared)

    @property
    def single(self) -> bool:
        """Whether it computes in single precision."""
        reals = [x for x in self.carry if is_real(x)] or [x for x in self.leaves if is_real(x)]
        return bool(reals) and reals[0].dtype == jnp.float32

    @property
    def real_carry(self) -> tuple[int, ...]:
        """The floats among the carry, by their number in it."""
        return tuple(i for i, x in enumerate(self.carry) if is_real(x))


def is_real(leaf: Any) -> bool:
    """Whether a leaf is of a floating type, so that it has a derivative."""
    return jnp.issubdtype(leaf.dtype, jnp.floating)


def size(leaves: Any) -> int:
    """Elements of all leaves."""
    return sum(math.prod(x.shape) for x in leaves)


def tick(program: Program, *leaves: Any) -> list[Any]:
    """One tick: leaves of the carry, then of the row."""
    carry, row = _applied(program, *leaves)
    return [*jax.tree.leaves(carry), *jax.tree.leaves(row)]


def _applied(program: Program, *leaves: Any) -> tuple[Any, Any]:
    values = list(leaves)
    for number, implementation in program.keys:
        values[number] = jax.random.wrap_key_data(values[number], impl=implementation)
    a, b = len(program.inputs), program.num_consts
    parts = values[:a], values[a:b], values[b:]
    trees = (jax.tree.unflatten(s, p) for s, p in zip(program.structures, parts, strict=True))
    return program.spec.function(program.spec.static, *trees)


@functools.cache
def _traced(program: Program) -> tuple[Any, Any]:
    return jax.make_jaxpr(functools.partial(_applied, program), return_shape=True)(*program.leaves)


def row_structure(program: Program) -> tuple[Any, Leaves]:
    """Structure and shapes of what a tick stores."""
    leaves, structure = jax.tree.flatten(_traced(program)[1][1])
    return structure, tuple(leaves)


def forward_jaxpr(program: Program) -> Any:
    """Arguments: the leaves. Results: carry, row."""
    return _traced(program)[0]


def _moved(
    program: Program, moving: tuple[int, ...], leaves: Any, values: Any, carry: Any
) -> tuple[list[Any], list[Any]]:
    """The real carry after a tick, with other values of the moving leaves and the real carry; and
    the whole carry."""
    merged = list(leaves)
    for number, value in zip(moving, values, strict=True):
        merged[number] = value
    for number, value in zip(program.real_carry, carry, strict=True):
        merged[program.num_consts + number] = value
    after = tick(program, *merged)[: len(program.carry)]
    return [after[i] for i in program.real_carry], after


def _split(program: Program, moving: tuple[int, ...], leaves: Any) -> tuple[list[Any], list[Any]]:
    return [leaves[i] for i in moving], [leaves[program.num_consts + i] for i in program.real_carry]


def _derivative(function: Callable[..., Any], *args: Any) -> Any:
    """A derivative as a jaxpr. Raises LoweringError where JAX has none."""
    try:
        return jax.make_jaxpr(function)(*args)
    except (NotImplementedError, ValueError) as reason:
        raise LoweringError(str(reason).partition("\n")[0]) from reason


@functools.cache
def tangent_jaxpr(program: Program, moving: tuple[int, ...]) -> Any:
    """Arguments: leaves, tangents of the moving ones and of the real carry.

    Results: carry, tangents of the real carry.
    """

    def push(leaves: Any, values: Any, carry: Any) -> Any:
        at = _split(program, moving, leaves)
        _, moved, after = jax.jvp(
            lambda v, c: _moved(program, moving, leaves, v, c), at, (values, carry), has_aux=True
        )
        return after, moved

    leaves = list(program.leaves)
    return _derivative(push, leaves, *_split(program, moving, leaves))


@functools.cache
def pullback_jaxpr(program: Program, moving: tuple[int, ...]) -> Any:
    """Arguments: leaves, cotangents of the real carry. Results: carry, then cotangents of the
    moving leaves and of the real carry before the tick."""

    def pull(leaves: Any, cotangents: Any) -> Any:
        at = _split(program, moving, leaves)
        _, back, after = jax.vjp(
            lambda v, c: _moved(program, moving, leaves, v, c), *at, has_aux=True
        )
        return after, back(cotangents)

    leaves = list(program.leaves)
    return _derivative(pull, leaves, _split(program, moving, leaves)[1])


# --- the definition of truth -------------------------------------------------------------------


def scan(program: Program, ticks: int, leaves: Any) -> list[Any]:
    """`ticks` control periods of one run by ``lax.scan``: leaves of the carry, then of the rows."""
    fixed = list(leaves[: program.num_consts])
    count = len(program.carry)

    def step(carry: Any, _: Any) -> Any:
        out = tick(program, *fixed, *carry)
        return out[:count], out[count:]

    carry, rows = segmented(step, list(leaves[program.num_consts :]), ticks, program.spec.segment)
    return [*carry, *rows]


def batched_scan(
    program: Program, ticks: int, batched: tuple[bool, ...], size: int, leaves: Any
) -> list[Any]:
    """`scan` of a batch: every result has the batch as its leading axis."""
    one = functools.partial(scan, program, ticks)
    axes = tuple(0 if b else None for b in batched)
    if size == 1 and not any(batched):
        return [x[None] for x in one(list(leaves))]
    return jax.vmap(lambda *x: one(x), in_axes=axes, axis_size=size)(*leaves)
