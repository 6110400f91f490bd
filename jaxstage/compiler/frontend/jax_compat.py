"""The compiler's only door to the half-public parts of JAX.

Everything here is known to work from jax 0.10.1 to 0.12.
"""

from typing import Any

import jax
import numpy as np
from jax.core import ShapedArray as ShapedArray
from jax.extend import core as _core
from jax.interpreters import ad as _ad
from jax.interpreters import batching as _batching
from jax.interpreters import mlir as _mlir

Literal = _core.Literal
Primitive = _core.Primitive
Zero = _ad.Zero
is_undefined_primal = _ad.is_undefined_primal

#: primitives that only hold another jaxpr, which may stand in their place
CALLS = frozenset(
    "jit pjit closed_call core_call remat remat2 checkpoint custom_jvp_call custom_vjp_call "
    "custom_vjp_call_jaxpr custom_lin".split()
)

#: primitives whose results are their arguments; those of shardings mean nothing to a single run
SAME = frozenset("stop_gradient optimization_barrier name copy copy_p pvary pcast reshard".split())


def called(params: dict[str, Any]) -> tuple[Any, tuple[Any, ...]]:
    """The jaxpr that a call holds, and its constants."""
    for name in ("jaxpr", "call_jaxpr", "fun_jaxpr"):
        if name in params:
            inner = params[name]
            return (inner.jaxpr, tuple(inner.consts)) if hasattr(inner, "consts") else (inner, ())
    raise KeyError(f"a call without a jaxpr: {sorted(params)}")


def typed(literal: Any) -> np.ndarray:
    """A number that stands in a jaxpr, with the type that it has there."""
    return np.asarray(literal.val, literal.aval.dtype)


def scan_parts(equation: Any) -> tuple[int, int]:
    """Numbers of constants and of carried values of a scan, from the shapes of its body."""
    body = equation.params["jaxpr"].jaxpr
    carried = sum(
        outer.aval.ndim == inner.aval.ndim
        for outer, inner in zip(equation.outvars, body.outvars, strict=True)
    )
    scanned = 0
    for outer, inner in zip(reversed(equation.invars), reversed(body.invars), strict=True):
        if outer.aval.ndim == inner.aval.ndim:
            break
        scanned += 1
    return len(body.invars) - carried - scanned, carried


def set_rules(primitive: Any, abstract: Any, batch: Any, implementation: Any) -> None:
    """Give a primitive with several results its shapes, its batching rule and its eager form."""
    primitive.multiple_results = True
    primitive.def_abstract_eval(abstract)
    primitive.def_impl(implementation)
    _batching.primitive_batchers[primitive] = batch


def set_lowering(primitive: Any, reference: Any, on_cpu: Any) -> None:
    """Lower a primitive to JAX functions: one on a CPU, another anywhere else."""
    _mlir.register_lowering(primitive, _mlir.lower_fun(reference, multiple_results=True))
    _mlir.register_lowering(
        primitive, _mlir.lower_fun(on_cpu, multiple_results=True), platform="cpu"
    )


def set_jvp(primitive: Any, rule: Any) -> None:
    """Give a primitive its forward derivative."""
    _ad.primitive_jvps[primitive] = rule


def set_transpose(primitive: Any, rule: Any) -> None:
    """Give a linear primitive its transpose."""
    _ad.primitive_transposes[primitive] = rule


def shaped(shape: tuple[int, ...], dtype: Any, operands: Any) -> Any:
    """The shape of a result that varies over the mesh axes over which an operand does."""
    axes = [getattr(x, "vma", None) for x in operands]
    varying = frozenset().union(*(a for a in axes if a))
    more: Any = {"vma": varying} if varying else {}
    return ShapedArray(shape, dtype, **more)


def zero_tangent(value: Any) -> Any:
    """The tangent of a value that has none."""
    return Zero(jax.typeof(value).to_tangent_aval())
