"""A loop over control periods that runs compiled where it can."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxstage.engine.compat import is_key_type
from jaxstage.engine.primitives import rollout_p
from jaxstage.engine.program import Program, row_structure


def program_of(
    step: Callable[..., Any], static: Any, inputs: Any, shared: Any, carry: Any,
    segment: int = 0, finite: bool = False,
) -> tuple[Program, list[Any]]:  # fmt: skip
    """The `Program` of one run and its leaves."""
    leaves, structures, counts = [], [], []
    for tree in (inputs, shared, carry):
        found, structure = jax.tree.flatten(tree)
        leaves += [jnp.asarray(x) for x in found]
        structures.append(structure)
        counts.append(len(found))
    keys = tuple(
        (i, jax.random.key_impl(x)) for i, x in enumerate(leaves) if is_key_type(x.dtype)
    )
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


def rollout(
    step: Callable[..., Any], static: Any, inputs: Any, shared: Any, carry: Any, ticks: int,
    segment: int = 0, finite: bool = False,
) -> tuple[Any, Any]:  # fmt: skip
    """`ticks` times ``carry, row = step(static, inputs, shared, carry)``: last carry, all rows.

    It means ``lax.scan``, under every transformation of JAX. static: hashable. inputs: what may
    differ from run to run. shared: what usually does not, and may be large. segment: ticks per
    checkpointed segment, where it runs as a scan. finite: the caller promises that the floats of
    the carry are finite in every run that still changes.
    """
    program, leaves = program_of(step, static, inputs, shared, carry, segment, finite)
    out = rollout_p.bind(
        *leaves, program=program, batched=(False,) * len(leaves), size=1, ticks=ticks
    )
    out = [x[0] for x in out]
    count = len(program.carry)
    rows = jax.tree.unflatten(row_structure(program)[0], out[count:])
    return jax.tree.unflatten(program.structures[2], out[:count]), rows
