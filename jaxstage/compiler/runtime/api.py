"""A loop over control periods that runs compiled where it can."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxstage.compiler.cxx.kernels import kernel
from jaxstage.compiler.frontend.step_program import Program, is_real, row_structure, scan
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.key_types import is_key_type
from jaxstage.compiler.runtime.jax_primitives import has_derivative, owned, rollout_p
from jaxstage.compiler.runtime.toolchain import build, compiler


def program_of(
    step: Callable[..., Any], static: Any, inputs: Any, shared: Any, carry: Any,
    segment: int = 0, finite: bool = False,
) -> tuple[Program, list[Any]]:  # fmt: skip
    """The `Program` of one run and its leaves.

    step(static, inputs, shared, carry) -> (carry, row); static: hashable. inputs: what may differ
    from run to run. shared: what usually does not, and may be large. segment: ticks per
    checkpointed segment, where it runs as a scan. finite: the caller promises that the floats of
    the carry are finite in every run that still changes.
    """
    leaves, structures, counts = [], [], []
    for tree in (inputs, shared, carry):
        found, structure = jax.tree.flatten(tree)
        leaves += [jnp.asarray(x) for x in found]
        structures.append(structure)
        counts.append(len(found))
    keys = tuple((i, jax.random.key_impl(x)) for i, x in enumerate(leaves) if is_key_type(x.dtype))
    for i, _ in keys:
        leaves[i] = jax.random.key_data(leaves[i])
    shapes = tuple(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in leaves)
    a, b = counts[0], counts[0] + counts[1]
    program = Program(
        step=step, static=static, structures=tuple(structures),  # type: ignore[arg-type]
        inputs=shapes[:a], shared=shapes[a:b], carry=shapes[b:], keys=keys, segment=segment,
        finite=finite,
    )  # fmt: skip
    return program, leaves


def rollout(program: Program, leaves: list[Any], ticks: int) -> tuple[Any, Any]:
    """`ticks` times ``carry, row = step(static, inputs, shared, carry)``: last carry, all rows.

    It means ``lax.scan``, under every transformation of JAX, and is one where there is no kernel.
    """
    if refusal(program) is None:
        out = rollout_p.bind(
            *leaves, program=program, batched=(False,) * len(leaves), size=1, ticks=ticks
        )
        out = [x[0] for x in out]
    else:
        out = scan(program, ticks, leaves)
    count = len(program.carry)
    rows = jax.tree.unflatten(row_structure(program)[0], out[count:])
    return jax.tree.unflatten(program.structures[2], out[:count]), rows


def refusal(program: Program, batched: tuple[bool, ...] = ()) -> str | None:
    """Why a loop is not compiled, or None. batched: which of its leaves differ from run to run."""
    if compiler() is None:
        return "no C++ compiler (g++ or clang++) was found"
    try:
        kernel(program, "forward", owned(program, batched or (False,) * len(program.leaves)))
    except LoweringError as reason:
        return str(reason)
    return None


class Report(NamedTuple):
    """One kernel. what: ``forward``, ``tangent`` or ``pullback``; reason: why there is none, or
    None; nodes: operations of a tick; bytes: of the library; seconds: of the compiler, 0 where
    the cache had it; graph_seconds: to find the operations."""

    what: str
    reason: str | None
    nodes: int = 0
    bytes: int = 0
    seconds: float = 0.0
    graph_seconds: float = 0.0
    cached: bool = False


def describe(program: Program, what: str) -> Report:
    """Make a kernel, of all derivatives that there are, and say how it went."""
    own = owned(program, (False,) * len(program.leaves))
    inputs = range(len(program.inputs))
    moving = () if what == "forward" else tuple(i for i in inputs if is_real(program.leaves[i]))
    if what != "forward" and not has_derivative(program, (False,) * len(program.leaves), moving):
        return Report(what, "recorded rows: their derivative is that of the scan")
    begin = time.perf_counter()
    try:
        made = kernel(program, what, own, moving)
        found = time.perf_counter() - begin
        built = build(made.text(1))
    except LoweringError as reason:
        return Report(what, str(reason))
    return Report(what, None, made.nodes, built.bytes, built.seconds, found, built.cached)
