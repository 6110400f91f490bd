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

from jaxstage.engine import calls
from jaxstage.engine.build import build
from jaxstage.engine.compat import (
    Primitive,
    set_jvp,
    set_lowering,
    set_rules,
    shaped,
)
from jaxstage.engine.kernels import Kernel, kernel
from jaxstage.engine.program import Program, batched_scan, row_structure

rollout_p = Primitive("jaxstage_rollout")


def owned(program: Program, batched: tuple[bool, ...]) -> tuple[bool, ...]:
    """Of each shared leaf and each carried one: do runs have it for themselves?"""
    return batched[len(program.inputs) : len(program.leaves)]


@functools.cache
def ready(
    program: Program, what: str, own: tuple[bool, ...], moving: tuple[int, ...] = ()
) -> Kernel | str:
    """A kernel that is built, or the reason why there is none."""
    try:
        made = kernel(program, what, own, moving)
        build(made.text)
    except NotImplementedError as reason:
        return str(reason)
    return made


def _shapes(*args: Any, program: Program, batched: Any, size: int, ticks: int) -> list[Any]:
    carry = [shaped((size, *x.shape), x.dtype, args) for x in program.carry]
    rows = [shaped((size, ticks, *x.shape), x.dtype, args) for x in row_structure(program)[1]]
    return [*carry, *rows]


def _reference(*args: Array, program: Program, batched: Any, size: int, ticks: int) -> Any:
    return batched_scan(program, ticks, batched, size, args)


def _compiled(*args: Array, program: Program, batched: Any, size: int, ticks: int) -> Any:
    made = ready(program, "forward", owned(program, batched))
    if isinstance(made, str):
        return _reference(*args, program=program, batched=batched, size=size, ticks=ticks)
    return calls.forward(program, made, batched, size, ticks, args)


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


def _jvp(args: Any, tangents: Any, **params: Any) -> Any:
    return jax.jvp(functools.partial(_reference, **params), args, tangents)


set_rules(rollout_p, _shapes, _batch(rollout_p), _eager(rollout_p))
set_lowering(rollout_p, _reference, _compiled)
