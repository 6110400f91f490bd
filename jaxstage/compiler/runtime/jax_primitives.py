"""The primitives of a compiled loop: they carry vmap, jvp, transposition and sharding.

rollout: carry and rows after some ticks of a batch of runs. tangent: linear in the tangents that it
is given, of parameters and carry. pullback: its transpose. Every batch axis that JAX adds becomes
part of the one batch axis of the kernel. Each has a form in plain JAX, `program.batched_scan` and
its derivatives, which is what it means, what it lowers to where there is no kernel, and what is
differentiated where there is no kernel for that.
"""

import functools
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
from jaxstage.compiler.runtime.toolchain import build

rollout_p = Primitive("jaxstage_rollout")
tangent_p = Primitive("jaxstage_tangent")
pullback_p = Primitive("jaxstage_pullback")


def owned(program: Program, batched: tuple[bool, ...]) -> tuple[bool, ...]:
    """Of each shared leaf and each carried one: do runs have it for themselves?"""
    return tuple(batched[len(program.inputs) : len(program.leaves)])


@functools.cache
def ready(
    program: Program, what: str, own: tuple[bool, ...], vectors: int, moving: tuple[int, ...] = ()
) -> Kernel | str:
    """A kernel that is built for that many vectors of runs, or the reason why there is none."""
    try:
        made = kernel(program, what, own, moving)
        build(made.text(vectors))
    except LoweringError as reason:
        return str(reason)
    return made


def _shapes(*args: Any, program: Program, batched: Any, size: int, ticks: int) -> list[Any]:
    carry = [shaped((size, *x.shape), x.dtype, args) for x in program.carry]
    rows = [shaped((size, ticks, *x.shape), x.dtype, args) for x in row_structure(program)[1]]
    return [*carry, *rows]


def _reference(*args: Array, program: Program, batched: Any, size: int, ticks: int) -> Any:
    return batched_scan(program, ticks, batched, size, args)


def _compiled(*args: Array, program: Program, batched: Any, size: int, ticks: int) -> Any:
    made = ready(program, "forward", owned(program, batched), launch.vectors(program, size))
    if isinstance(made, str):
        return _reference(*args, program=program, batched=batched, size=size, ticks=ticks)
    return launch.forward(program, made, batched, size, ticks, args)


def folded(
    args: Any, dims: Any, batched: tuple[bool, ...], size: int
) -> tuple[list[Any], tuple[bool, ...], int]:
    """The operands with a new axis made part of the batch; which are batched; the new axis."""
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


def _batch(primitive: Any) -> Any:
    def rule(args: Any, dims: Any, *, batched: Any, size: int, **params: Any) -> Any:
        args, flags, new = folded(args, dims, batched, size)
        out = primitive.bind(*args, batched=flags, size=new * size, **params)
        return [x.reshape(new, size, *x.shape[1:]) for x in out], [0] * len(out)

    return rule


def _eager(primitive: Any) -> Any:
    def run(*args: Any, **params: Any) -> Any:
        return jax.jit(functools.partial(primitive.bind, **params))(*args)

    return run


def _differentiated(reference: Any, args: Any, tangents: Any, params: Any) -> Any:
    """The derivative of a form in plain JAX."""
    moving = [i for i, t in enumerate(tangents) if type(t) is not Zero]

    def of(*values: Array) -> Any:
        merged = list(args)
        for i, value in zip(moving, values, strict=True):
            merged[i] = value
        return reference(*merged, **params)

    out, moved = jax.jvp(of, [args[i] for i in moving], [tangents[i] for i in moving])
    return list(out), list(moved)


# --- forward derivative --------------------------------------------------------------------------


def _positions(program: Program, moving: tuple[int, ...]) -> list[int]:
    """The leaves that have tangents: moving ones, then the real carry."""
    return [*moving, *(program.num_consts + i for i in program.real_carry)]


def _jvp(args: Any, tangents: Any, *, program: Program, batched: Any, size: int, ticks: int) -> Any:
    params = {"program": program, "batched": batched, "size": size, "ticks": ticks}
    given = [i for i, t in enumerate(tangents) if type(t) is not Zero]
    moving = tuple(i for i in given if i < program.num_consts)
    if not has_derivative(program, batched, moving):
        return _differentiated(_reference, args, tangents, params)
    out = rollout_p.bind(*args, **params)
    at = _positions(program, moving)
    pushed = [jnp.zeros_like(args[i]) if type(tangents[i]) is Zero else tangents[i] for i in at]
    flags = (*batched, *(batched[i] for i in at))
    moved = iter(
        tangent_p.bind(
            *args, *pushed, program=program, batched=flags, size=size, ticks=ticks, moving=moving
        )
    )
    real = {*program.real_carry}
    return out, [next(moved) if i in real else zero_tangent(x) for i, x in enumerate(out)]


def has_derivative(program: Program, batched: tuple[bool, ...], moving: tuple[int, ...]) -> bool:
    """Whether kernels have this derivative; else it is that of the scan.

    They have none of recorded rows, nor with respect to what all runs share.
    """
    alone = all(i < len(program.inputs) or batched[i] for i in moving)
    return alone and not any(is_real(x) for x in row_structure(program)[1])


def _moved(program: Program, leaves: Any, at: list[int], ticks: int) -> Any:
    """The real carry of one run after the ticks as a function of some leaves, and these."""

    def of(*values: Array) -> list[Array]:
        merged = list(leaves)
        for i, value in zip(at, values, strict=True):
            merged[i] = value
        out = scan(program, ticks, merged)
        return [out[i] for i in program.real_carry]

    return of, [leaves[i] for i in at]


def _of_runs(one: Any, batched: tuple[bool, ...], size: int, args: Any) -> Any:
    return jax.vmap(one, [0 if b else None for b in batched], axis_size=size)(*args)


def _tangent_reference(
    *args: Array, program: Program, batched: Any, size: int, ticks: int, moving: Any
) -> Any:
    count, at = len(program.leaves), _positions(program, moving)

    def one(*args: Array) -> list[Array]:
        of, values = _moved(program, args[:count], at, ticks)
        return jax.jvp(of, values, list(args[count:]))[1]

    return _of_runs(one, batched, size, args)


def _tangent_compiled(
    *args: Array, program: Program, batched: Any, size: int, ticks: int, moving: Any
) -> Any:
    own, vectors = owned(program, batched), launch.vectors(program, size)
    made = ready(program, "tangent", own, vectors, moving)
    if isinstance(made, str):
        return _tangent_reference(
            *args, program=program, batched=batched, size=size, ticks=ticks, moving=moving
        )
    return launch.tangent(program, made, batched, size, ticks, moving, args)


def _real_shapes(*args: Any, program: Program, size: int, **params: Any) -> list[Any]:
    leaves = [program.carry[i] for i in program.real_carry]
    return [shaped((size, *x.shape), x.dtype, args) for x in leaves]


# --- reverse derivative --------------------------------------------------------------------------


def _transpose(
    cotangents: Any, *args: Any, program: Program, batched: Any, size: int, ticks: int, moving: Any
) -> Any:
    count = len(program.leaves)
    given = [
        jnp.zeros((size, *program.carry[i].shape), program.carry[i].dtype) if type(x) is Zero else x
        for i, x in zip(program.real_carry, cotangents, strict=True)
    ]
    out = pullback_p.bind(
        *args[:count], *given, program=program, batched=(*batched[:count], *(True,) * len(given)),
        size=size, ticks=ticks, moving=moving,
    )  # fmt: skip
    sums = [x if b else x.sum(0) for x, b in zip(out, batched[count:], strict=True)]
    asked = [x if is_undefined_primal(y) else None for x, y in zip(sums, args[count:], strict=True)]
    return [None] * count + asked


def _pullback_reference(
    *args: Array, program: Program, batched: Any, size: int, ticks: int, moving: Any
) -> Any:
    count, at = len(program.leaves), _positions(program, moving)

    # derivatives of one run, and then of all: the derivative of a condition that differs from run
    # to run cannot be transposed by JAX
    def one(*args: Array) -> list[Array]:
        of, values = _moved(program, args[:count], at, ticks)
        return list(jax.vjp(of, *values)[1](list(args[count:])))

    return _of_runs(one, batched, size, args)


def _pullback_compiled(
    *args: Array, program: Program, batched: Any, size: int, ticks: int, moving: Any
) -> Any:
    own, vectors = owned(program, batched), launch.vectors(program, size)
    made = ready(program, "pullback", own, vectors, moving)
    onward = ready(program, "forward", own, vectors)
    if isinstance(made, str) or isinstance(onward, str):
        return _pullback_reference(
            *args, program=program, batched=batched, size=size, ticks=ticks, moving=moving
        )
    return launch.pullback(program, (made, onward), batched, size, ticks, moving, args)


def _pulled_shapes(
    *args: Any, program: Program, size: int, moving: Any, **params: Any
) -> list[Any]:
    leaves = [program.leaves[i] for i in _positions(program, moving)]
    return [shaped((size, *x.shape), x.dtype, args) for x in leaves]


# --- what JAX is told ----------------------------------------------------------------------------


def _second(reference: Any) -> Any:
    """The derivative of a derivative: that of its form in plain JAX."""
    return lambda args, tangents, **params: _differentiated(reference, args, tangents, params)


for _primitive, _made, _plain, _fast in (
    (rollout_p, _shapes, _reference, _compiled),
    (tangent_p, _real_shapes, _tangent_reference, _tangent_compiled),
    (pullback_p, _pulled_shapes, _pullback_reference, _pullback_compiled),
):
    set_rules(_primitive, _made, _batch(_primitive), _eager(_primitive))
    set_lowering(_primitive, _plain, _fast)
set_jvp(rollout_p, _jvp)
set_jvp(tangent_p, _second(_tangent_reference))
set_jvp(pullback_p, _second(_pullback_reference))
set_transpose(tangent_p, _transpose)
