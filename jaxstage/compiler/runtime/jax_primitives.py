"""JAX primitives of a compiled loop: they carry vmap, jvp, transposition and sharding.

rollout: carry and rows after some ticks of a batch of runs. tangent: linear in the tangents that it
is given, of parameters and carry. pullback: its transpose. Every batch axis that JAX adds becomes
part of the one batch axis of the kernel. Each has a form in plain JAX, `step_program.batched_scan`
and its derivatives, which is what it means, what it lowers to where there is no kernel, and what
is differentiated where there is no kernel for that.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.compiler.cxx.kernels import Kernel, kernel
from jaxstage.compiler.frontend.jax_compat import (
    Primitive,
    Zero,
    is_undefined_primal,
    set_jvp,
    set_lowering,
    set_rules,
    set_transpose,
    shaped,
    zero_tangent,
)
from jaxstage.compiler.frontend.step_program import (
    Program,
    batched_scan,
    is_real,
    row_structure,
    scan,
)
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.runtime import launch
from jaxstage.compiler.runtime.fallback import fall_back
from jaxstage.compiler.runtime.packing import RunBatch
from jaxstage.compiler.runtime.toolchain import build

rollout_p = Primitive("jaxstage_rollout")
tangent_p = Primitive("jaxstage_tangent")
pullback_p = Primitive("jaxstage_pullback")

#: why a derivative is that of the scan although its loop is compiled
NO_KERNEL = "no kernel has derivatives of recorded rows, or by what all runs share"
NO_SECOND = "no kernel has second derivatives"
NO_ACCELERATOR = "kernels are for processors alone"


def owned(program: Program, batched: tuple[bool, ...]) -> tuple[bool, ...]:
    """Of each shared leaf and each carried one: do runs have it for themselves?"""
    return tuple(batched[len(program.inputs) : len(program.leaves)])


@functools.cache
def compiled_kernel(
    program: Program, what: str, own: tuple[bool, ...], vectors: int, moving: tuple[int, ...] = ()
) -> Kernel | str:
    """A kernel, built for so many vectors of runs, or the reason why there is none.

    Args:
        program: The loop.
        what: ``forward``, ``tangent`` or ``pullback``.
        own: See `owned`.
        vectors: Vectors of runs in the batch.
        moving: Leaves beside the carry that have derivatives.
    """
    try:
        generated = kernel(program, what, own, moving)
        build(generated.text(vectors))
    except LoweringError as reason:
        return str(reason)
    return generated


def has_derivative(program: Program, batched: tuple[bool, ...], moving: tuple[int, ...]) -> bool:
    """Whether kernels have this derivative; else it is that of the scan.

    They have none of recorded rows, nor with respect to what all runs share.
    """
    alone = all(i < len(program.inputs) or batched[i] for i in moving)
    return alone and not any(is_real(x) for x in row_structure(program)[1])


def _kernel_of(batch: RunBatch, what: str, moving: tuple[int, ...] = ()) -> Kernel | None:
    """The kernel of a batch; None where it runs as a scan, which is said.

    Raises:
        RuntimeError: In place of None, where the program is strict.
    """
    own = owned(batch.program, batch.batched)
    generated = compiled_kernel(batch.program, what, own, batch.vectors, moving)
    if isinstance(generated, str):
        fall_back(generated, batch.program.spec.strict)
        return None
    return generated


# --- the run -------------------------------------------------------------------------------------


def _shapes(*args: Any, batch: RunBatch) -> list[Any]:
    program, _, size, ticks = batch
    carry = [shaped((size, *x.shape), x.dtype, args) for x in program.carry]
    rows = [shaped((size, ticks, *x.shape), x.dtype, args) for x in row_structure(program)[1]]
    return [*carry, *rows]


def _reference(*args: Array, batch: RunBatch) -> list[Array]:
    return batched_scan(batch.program, batch.ticks, batch.batched, batch.runs, args)


def _compiled(*args: Array, batch: RunBatch) -> list[Array]:
    forward = _kernel_of(batch, "forward")
    if forward is None:
        return _reference(*args, batch=batch)
    return launch.forward(batch, forward, args)


# --- forward derivative --------------------------------------------------------------------------


def _positions(program: Program, moving: tuple[int, ...]) -> list[int]:
    """The leaves that have tangents: moving ones, then the real carry."""
    return [*moving, *(program.num_consts + i for i in program.real_carry)]


def _jvp(args: Any, tangents: Any, *, batch: RunBatch) -> Any:
    """Forward derivative of `rollout_p`: itself, and `tangent_p` beside it."""
    program = batch.program
    nonzero = [i for i, t in enumerate(tangents) if type(t) is not Zero]
    moving = tuple(i for i in nonzero if i < program.num_consts)
    if not has_derivative(program, batch.batched, moving):
        return _differentiated(_reference, NO_KERNEL)(args, tangents, batch=batch)
    out = rollout_p.bind(*args, batch=batch)
    at = _positions(program, moving)
    pushed = [jnp.zeros_like(args[i]) if type(tangents[i]) is Zero else tangents[i] for i in at]
    both = batch._replace(batched=(*batch.batched, *(batch.batched[i] for i in at)))
    moved = iter(tangent_p.bind(*args, *pushed, batch=both, moving=moving))
    real = {*program.real_carry}
    return out, [next(moved) if i in real else zero_tangent(x) for i, x in enumerate(out)]


def _differentiated(reference: Callable[..., list[Array]], reason: str) -> Callable[..., Any]:
    """The derivative of a form in plain JAX. reason: why it is not that of a kernel."""

    def rule(args: Any, tangents: Any, **params: Any) -> tuple[list[Array], list[Array]]:
        fall_back(reason, strict=False)
        moving = [i for i, t in enumerate(tangents) if type(t) is not Zero]

        def of(*values: Array) -> list[Array]:
            merged = list(args)
            for i, value in zip(moving, values, strict=True):
                merged[i] = value
            return reference(*merged, **params)

        out, moved = jax.jvp(of, [args[i] for i in moving], [tangents[i] for i in moving])
        return list(out), list(moved)

    return rule


def _moved(program: Program, leaves: Any, at: list[int], ticks: int) -> tuple[Any, list[Array]]:
    """The real carry of one run after the ticks as a function of some leaves, and these."""

    def of(*values: Array) -> list[Array]:
        merged = list(leaves)
        for i, value in zip(at, values, strict=True):
            merged[i] = value
        out = scan(program, ticks, merged)
        return [out[i] for i in program.real_carry]

    return of, [leaves[i] for i in at]


def _every_run(one: Callable[..., list[Array]], batch: RunBatch, args: Any) -> list[Array]:
    """A function of one run over the batch."""
    axes = [0 if b else None for b in batch.batched]
    return jax.vmap(one, axes, axis_size=batch.runs)(*args)


def _tangent_reference(*args: Array, batch: RunBatch, moving: tuple[int, ...]) -> list[Array]:
    program = batch.program
    count, at = len(program.leaves), _positions(program, moving)

    def one(*args: Array) -> list[Array]:
        of, values = _moved(program, args[:count], at, batch.ticks)
        return jax.jvp(of, values, list(args[count:]))[1]

    return _every_run(one, batch, args)


def _tangent_compiled(*args: Array, batch: RunBatch, moving: tuple[int, ...]) -> list[Array]:
    tangent = _kernel_of(batch, "tangent", moving)
    if tangent is None:
        return _tangent_reference(*args, batch=batch, moving=moving)
    return launch.tangent(batch, tangent, moving, args)


def _tangent_shapes(*args: Any, batch: RunBatch, moving: tuple[int, ...]) -> list[Any]:
    leaves = [batch.program.carry[i] for i in batch.program.real_carry]
    return [shaped((batch.runs, *x.shape), x.dtype, args) for x in leaves]


# --- reverse derivative --------------------------------------------------------------------------


def _transpose(cotangents: Any, *args: Any, batch: RunBatch, moving: tuple[int, ...]) -> list[Any]:
    """Transpose of `tangent_p`: `pullback_p`, summed over the runs that share a leaf."""
    program, batched, size, _ = batch
    count = len(program.leaves)
    pulled = [
        jnp.zeros((size, *program.carry[i].shape), program.carry[i].dtype) if type(x) is Zero else x
        for i, x in zip(program.real_carry, cotangents, strict=True)
    ]
    back = batch._replace(batched=(*batched[:count], *(True,) * len(pulled)))
    out = pullback_p.bind(*args[:count], *pulled, batch=back, moving=moving)
    sums = [x if b else x.sum(0) for x, b in zip(out, batched[count:], strict=True)]
    linear = [is_undefined_primal(x) for x in args[count:]]
    return [None] * count + [x if on else None for x, on in zip(sums, linear, strict=True)]


def _pullback_reference(*args: Array, batch: RunBatch, moving: tuple[int, ...]) -> list[Array]:
    program = batch.program
    count, at = len(program.leaves), _positions(program, moving)

    # derivatives of one run, and then of all: the derivative of a condition that differs from run
    # to run cannot be transposed by JAX
    def one(*args: Array) -> list[Array]:
        of, values = _moved(program, args[:count], at, batch.ticks)
        return list(jax.vjp(of, *values)[1](list(args[count:])))

    return _every_run(one, batch, args)


def _pullback_compiled(*args: Array, batch: RunBatch, moving: tuple[int, ...]) -> list[Array]:
    backward = _kernel_of(batch, "pullback", moving)
    onward = _kernel_of(batch, "forward")
    if backward is None or onward is None:
        return _pullback_reference(*args, batch=batch, moving=moving)
    return launch.pullback(batch, backward, onward, moving, args)


def _pullback_shapes(*args: Any, batch: RunBatch, moving: tuple[int, ...]) -> list[Any]:
    leaves = [batch.program.leaves[i] for i in _positions(batch.program, moving)]
    return [shaped((batch.runs, *x.shape), x.dtype, args) for x in leaves]


# --- what JAX is told ----------------------------------------------------------------------------


def folded(
    args: Any, dims: Any, batched: tuple[bool, ...], size: int
) -> tuple[list[Array], tuple[bool, ...], int]:
    """Make a new axis of operands part of the batch axis.

    Args:
        args: Operands; those that are batched have an axis of ``size``.
        dims: Where each has the new axis, or None.
        batched: Which operands have the batch axis.
        size: Runs in the batch.

    Returns:
        The operands, their axis of ``new * size`` leading; which have it; ``new``.
    """
    new = next(x.shape[d] for x, d in zip(args, dims, strict=True) if d is not None)
    out, flags = [], []
    for x, d, b in zip(args, dims, batched, strict=True):
        if d is None and not b:
            out.append(x)
            flags.append(False)
            continue
        x = jnp.moveaxis(x, d, 0) if d is not None else jnp.broadcast_to(x, (new, *x.shape))
        if not b:
            x = jnp.broadcast_to(x[:, None], (new, size, *x.shape[1:]))
        out.append(x.reshape(new * size, *x.shape[2:]))
        flags.append(True)
    return out, tuple(flags), new


def _batching(primitive: Any) -> Callable[..., Any]:
    """Batching rule: the new axis becomes part of the batch that the primitive has."""

    def rule(args: Any, dims: Any, *, batch: RunBatch, **params: Any) -> Any:
        args, flags, new = folded(args, dims, batch.batched, batch.runs)
        larger = batch._replace(batched=flags, runs=new * batch.runs)
        out = primitive.bind(*args, batch=larger, **params)
        return [x.reshape(new, batch.runs, *x.shape[1:]) for x in out], [0] * len(out)

    return rule


def _eager(primitive: Any) -> Callable[..., Any]:
    """The primitive outside of ``jit``, and where that is disabled: a kernel is compiled anyway."""

    def run(*args: Any, **params: Any) -> Any:
        with jax.disable_jit(False):
            return jax.jit(functools.partial(primitive.bind, **params))(*args)

    return run


def _elsewhere(reference: Callable[..., list[Array]]) -> Callable[..., list[Array]]:
    """The form in plain JAX on what is no processor."""

    def run(*args: Array, batch: RunBatch, **params: Any) -> list[Array]:
        fall_back(NO_ACCELERATOR, batch.program.spec.strict)
        return reference(*args, batch=batch, **params)

    return run


for _primitive, _abstract, _plain, _fast in (
    (rollout_p, _shapes, _reference, _compiled),
    (tangent_p, _tangent_shapes, _tangent_reference, _tangent_compiled),
    (pullback_p, _pullback_shapes, _pullback_reference, _pullback_compiled),
):
    set_rules(_primitive, _abstract, _batching(_primitive), _eager(_primitive))
    set_lowering(_primitive, _elsewhere(_plain), _fast)
set_jvp(rollout_p, _jvp)
set_jvp(tangent_p, _differentiated(_tangent_reference, NO_SECOND))
set_jvp(pullback_p, _differentiated(_pullback_reference, NO_SECOND))
set_transpose(tangent_p, _transpose)
