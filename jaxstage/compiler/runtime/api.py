"""A loop over control periods, ``lax.scan`` by meaning, that runs compiled where it can."""

import time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.compiler.cxx.kernels import kernel
from jaxstage.compiler.frontend.step_program import (
    Program,
    StepSpec,
    is_real,
    row_structure,
    scan,
)
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.key_types import is_key_type
from jaxstage.compiler.runtime.fallback import fall_back
from jaxstage.compiler.runtime.jax_primitives import (
    NO_KERNEL,
    compiled_kernel,
    has_derivative,
    owned,
    rollout_p,
)
from jaxstage.compiler.runtime.packing import RunBatch, vectors
from jaxstage.compiler.runtime.toolchain import build, compiler


def program_of(step: StepSpec, inputs: Any, shared: Any, carry: Any) -> tuple[Program, list[Array]]:
    """The `Program` of one run, and its leaves.

    Args:
        step: One control period.
        inputs: Pytree of what may differ from run to run.
        shared: Pytree of what usually does not, and may be large.
        carry: Pytree before the first tick.

    Returns:
        The program and the leaves of the three trees, in that order.
    """
    leaves, structures, counts = [], [], []
    for tree in (inputs, shared, carry):
        values, structure = jax.tree.flatten(tree)
        leaves += [jnp.asarray(x) for x in values]
        structures.append(structure)
        counts.append(len(values))
    keys = tuple((i, jax.random.key_impl(x)) for i, x in enumerate(leaves) if is_key_type(x.dtype))
    for i, _ in keys:
        leaves[i] = jax.random.key_data(leaves[i])
    shapes = tuple(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in leaves)
    a, b = counts[0], counts[0] + counts[1]
    program = Program(
        spec=step,
        structures=tuple(structures),
        inputs=shapes[:a],
        shared=shapes[a:b],
        carry=shapes[b:],
        keys=keys,
    )
    return program, leaves


def rollout(program: Program, leaves: list[Array], ticks: int) -> tuple[Any, Any]:
    """`ticks` times ``carry, row = step(static, inputs, shared, carry)``.

    It means ``lax.scan``, under every transformation of JAX, and is one where there is no kernel.

    Args:
        program: The loop.
        leaves: Its numbers, from `program_of`.
        ticks: Control periods.

    Returns:
        The last carry, and all rows with a leading axis of ``ticks``.

    Raises:
        RuntimeError: Where the program is strict and cannot be compiled, with the reason.
    """
    reason = refusal(program)
    if reason is None:
        batch = RunBatch(program, (False,) * len(leaves), 1, ticks)
        out = [x[0] for x in rollout_p.bind(*leaves, batch=batch)]
    else:
        fall_back(reason, program.spec.strict)
        out = scan(program, ticks, leaves)
    count = len(program.carry)
    rows = jax.tree.unflatten(row_structure(program)[0], out[count:])
    return jax.tree.unflatten(program.structures[2], out[:count]), rows


def refusal(program: Program, batched: tuple[bool, ...] = (), runs: int = 0) -> str | None:
    """Why a loop is not compiled, or None.

    Args:
        program: The loop.
        batched: Which of its leaves differ from run to run; none if left out.
        runs: Runs of a batch whose kernel is then built, too; 0 builds nothing.
    """
    chosen = compiler()
    if isinstance(chosen, str):
        return chosen
    own = owned(program, batched or (False,) * len(program.leaves))
    if runs:
        built = compiled_kernel(program, "forward", own, vectors(program, runs))
        return built if isinstance(built, str) else None
    try:
        kernel(program, "forward", own)
    except LoweringError as reason:
        return str(reason)
    return None


class KernelReport(NamedTuple):
    """What came of one kernel.

    Attributes:
        what: ``forward``, ``tangent`` or ``pullback``.
        reason: Why there is none, or None.
        nodes: Operations of a control period.
        bytes: Size of the library.
        seconds: Time of the compiler in s, 0 where the cache had the library.
        graph_seconds: Time to find the operations in s.
        cached: Whether the cache had the library.
    """

    what: str
    reason: str | None
    nodes: int = 0
    bytes: int = 0
    seconds: float = 0.0
    graph_seconds: float = 0.0
    cached: bool = False


def describe(program: Program, what: str) -> KernelReport:
    """Build a kernel, of a derivative by all inputs, and say how it went."""
    none = (False,) * len(program.leaves)
    inputs = range(len(program.inputs))
    moving = () if what == "forward" else tuple(i for i in inputs if is_real(program.leaves[i]))
    if what != "forward" and not has_derivative(program, none, moving):
        return KernelReport(what, NO_KERNEL)
    begin = time.perf_counter()
    try:
        generated = kernel(program, what, owned(program, none), moving)
        graph_seconds = time.perf_counter() - begin
        library = build(generated.text(1))
    except LoweringError as reason:
        return KernelReport(what, str(reason))
    return KernelReport(
        what,
        None,
        generated.nodes,
        library.bytes,
        library.seconds,
        graph_seconds,
        library.cached,
    )
