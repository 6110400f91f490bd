"""A JAX function of one run as a graph of scalar operations: shapes and indexing disappear.

For any function of pytrees::

    traced = scalar_graph(function, *examples)     # examples: arrays or ShapeDtypeStructs
    traced.inputs      # the argument trees, every leaf an object array of nodes `in`,
                       # whose value is (number of the leaf, number of the element)
    traced.outputs     # the result tree, every leaf an object array of nodes
    for node in node.ordered(cells(traced.outputs)):    # arguments before users
        ...            # node.op, node.kind, node.args, node.value: see `graph`

Loops of fixed length are unrolled, branches become selections, an index that is known only at run
time selects among the elements it can reach (its range is tracked: clip before casting). What
cannot be put so raises LoweringError with the reason.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxstage.compiler.frontend.constant_table import ConstantTable, cells_of
from jaxstage.compiler.frontend.gather_scatter import Lookup, gather, scatter, slice_at, update_at
from jaxstage.compiler.frontend.inner_loop import (
    Inner,
    bounds_of,
    inputs,
    loop_node,
    results,
    source_of,
)
from jaxstage.compiler.frontend.jax_compat import CALLS, SAME, Literal, called, scan_parts, typed
from jaxstage.compiler.frontend.reductions import REDUCTIONS, dot, elementwise
from jaxstage.compiler.frontend.shape_ops import SHAPE_OPS
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.graph import Graph, new_graph
from jaxstage.compiler.ir.node import Node, kind_of
from jaxstage.compiler.ir.ops import OPS

#: longest inner loop that is written out, and the most equations that this may make of it
UNROLL, EQUATIONS = 256, 20_000
#: where loops may stay loops: the most equations that are written out instead
WRITTEN_OUT = 1500


class Traced(NamedTuple):
    """A function as a graph.

    Attributes:
        graph: All nodes.
        inputs: The argument trees, every leaf an object array of nodes `in`.
        outputs: The result tree, every leaf an object array of nodes.
    """

    graph: Graph
    inputs: tuple[Any, ...]
    outputs: Any


def scalar_graph(function: Callable[..., Any], *examples: Any, single: bool = False) -> Traced:
    """Trace ``function(*examples)`` into scalar operations.

    Args:
        function: Of pytrees.
        examples: Arrays, or their shapes and types.
        single: Whether its reals are float32.

    Raises:
        LoweringError: The function cannot be written so.
    """
    leaves, structure = jax.tree.flatten(examples)
    leaves = [x if hasattr(x, "dtype") else jnp.asarray(x) for x in leaves]
    graph = new_graph(single)
    inputs = [
        input_array(graph, number, x.shape, kind_of(x.dtype)) for number, x in enumerate(leaves)
    ]
    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in leaves]
    closed, out = jax.make_jaxpr(
        lambda *flat: function(*jax.tree.unflatten(structure, flat)), return_shape=True
    )(*shapes)
    results = scalarise(graph, closed.jaxpr, closed.consts, inputs)
    outputs = jax.tree.unflatten(jax.tree.structure(out), results)
    return Traced(graph, jax.tree.unflatten(structure, inputs), outputs)


def input_array(graph: Graph, group: Any, shape: tuple[int, ...], kind: str) -> np.ndarray:
    """An array of inputs (group, 0), (group, 1), ... in C order. Random keys have no nodes."""
    out = np.empty(shape, object)
    if kind == "k":
        return out
    for number, index in enumerate(np.ndindex(*shape)):
        out[index] = graph.input(group, number, kind)
    return out


def cells(tree: Any) -> list[Node]:
    """All nodes of a tree of object arrays, leaf by leaf, in C order."""
    return [node for leaf in jax.tree.leaves(tree) for node in leaf.reshape(-1)]


def scalarise(graph: Graph, jaxpr: Any, consts: Any, args: list[Any]) -> list[Any]:
    """Abstract interpretation of a jaxpr.

    Args:
        graph: Gets the nodes.
        jaxpr: The equations.
        consts: Values that it closes over.
        args: Object arrays of nodes, or tables.

    Returns:
        Object arrays of nodes, one a result.
    """
    env: dict[Any, Any] = {}

    def read(var: Any) -> Any:
        if isinstance(var, Literal):
            return lifted(graph, typed(var))
        return env[var]

    for var, value in zip(jaxpr.constvars, consts, strict=True):
        env[var] = lifted(graph, value)
    env.update(zip(jaxpr.invars, args, strict=True))
    for equation in jaxpr.eqns:
        results = evaluate(graph, equation, [read(v) for v in equation.invars])
        env.update(zip(equation.outvars, results, strict=True))
    return [cells_of(graph, read(v)) for v in jaxpr.outvars]


def lifted(graph: Graph, value: Any) -> Any:
    """A concrete array as constants."""
    if isinstance(value, ConstantTable) or (
        isinstance(value, np.ndarray) and value.dtype == object
    ):
        return value
    value = np.asarray(value)
    kind = kind_of(value.dtype)
    out = np.empty(value.shape, object)
    for index in np.ndindex(*value.shape):
        out[index] = graph.const(value[index], kind)
    return out


def evaluate(graph: Graph, equation: Any, args: list[Any]) -> list[Any]:
    """One equation.

    Args:
        graph: Gets the nodes.
        equation: Of a jaxpr.
        args: Object arrays of nodes, or tables.

    Raises:
        LoweringError: Names the primitive that has no such form.
    """
    name, params = equation.primitive.name, equation.params
    if name in CALLS:
        if _is_floor_division(params.get("name", ""), args):
            return [elementwise(lambda x, y: _floor_quotient(graph, x, y), *args)]
        inner, consts = called(params)
        return scalarise(graph, inner, consts, args)
    if name in ("gather", "dynamic_slice"):
        at = Lookup(graph, equation.outvars[0].aval.shape)
        return [(gather if name == "gather" else slice_at)(at, args, params)]
    if name in _CONTROL:
        return _CONTROL[name](graph, equation, args)
    args = [cells_of(graph, a) for a in args]
    if name in _STRUCTURED:
        return _STRUCTURED[name](graph, equation, args)
    if name in SHAPE_OPS:
        result = SHAPE_OPS[name](args, params)
        return result if isinstance(result, list) else [result]
    kinds = [kind_of(v.aval.dtype) for v in equation.outvars]
    if "k" in kinds:
        raise LoweringError(f"random numbers (primitive '{name}')")
    if name in SAME:
        return args
    if name in _ELEMENTWISE:
        make = _ELEMENTWISE[name]
        return [elementwise(lambda *x: make(graph, kinds[0], params, *x), *args)]
    raise LoweringError(f"primitive '{name}'")


# --- elementwise -----------------------------------------------------------------------------


def _plain(name: str) -> Callable[..., Node]:
    return lambda g, kind, params, *x: g.op(name, *x)


def power(g: Graph, x: Node, n: int) -> Node:
    """x^n by repeated squaring, as XLA does it."""
    if n < 0:
        return g.op("div", g.const(1, x.kind), power(g, x, -n))
    if n == 0:
        return g.const(1, x.kind)
    if n == 1:
        return x
    half = power(g, x, n // 2)
    square = g.op("mul", half, half)
    return g.op("mul", square, x) if n % 2 else square


def _one_minus_square(g: Graph, kind: str, params: Any, x: Node) -> Node:
    """(1 + x) (1 - x), as jax 0.12 has it in the slope of tanh."""
    one = g.const(1, x.kind)
    return g.op("mul", g.op("add", one, x), g.op("sub", one, x))


def _pick(g: Graph, kind: str, params: Any, which: Node, *cases: Node) -> Node:
    if which.kind == "b":
        return g.op("select", which, cases[1], cases[0])
    out = cases[-1]
    for number in range(len(cases) - 2, -1, -1):
        here = g.op("le" if number == 0 else "eq", which, g.const(number, which.kind))
        out = g.op("select", here, cases[number], out)
    return out


def _shift_right(g: Graph, kind: str, params: Any, x: Node, by: Node) -> Node:
    """Arithmetic shift: a negative number is one below the opposite of what is left of the rest."""
    if x.kind == "u" or x.low >= 0:
        return g.op("shr", x, by, kind=x.kind)
    negative = g.op("lt", x, g.const(0, x.kind))
    moved = g.op("shr", g.op("select", negative, g.op("not", x), x), by, kind=x.kind)
    return g.op("select", negative, g.op("not", moved), moved)


def _round(g: Graph, kind: str, params: Any, x: Node) -> Node:
    """The nearest whole number; of two, the even one or that away from zero."""
    if params["rounding_method"] == lax.RoundingMethod.TO_NEAREST_EVEN:
        return g.op("round", x)
    size = g.op("abs", x)
    down = g.op("floor", size)
    up = g.op("ge", g.op("sub", size, down), g.const(0.5, "f"))
    whole = g.op("select", up, g.op("add", down, g.const(1, "f")), down)
    return g.op("mul", g.op("sign", x), whole)


_RENAMED = {"add_any": "add", "lt_to": "lt", "le_to": "le", "eq_to": "eq"}
_ELEMENTWISE: dict[str, Callable[..., Node]] = {
    **{op.name: _plain(op.name) for op in OPS.values() if op.primitive},
    **{name: _plain(other) for name, other in _RENAMED.items()},
    "round": _round,
    "square": lambda g, kind, params, x: g.op("mul", x, x),
    "one_minus_square": _one_minus_square,
    "integer_pow": lambda g, kind, params, x: power(g, x, params["y"]),
    "clamp": lambda g, kind, params, low, x, high: g.op("min", g.op("max", low, x), high),
    "select_n": _pick,
    "convert_element_type": lambda g, kind, params, x: g.op("cast", x, kind=kind),
    "shift_left": lambda g, kind, params, x, by: g.op("shl", x, by, kind=x.kind),
    "shift_right_logical": lambda g, kind, params, x, by: g.op("shr", x, by, kind=x.kind),
    "shift_right_arithmetic": _shift_right,
}


# --- control flow ----------------------------------------------------------------------------


def _scan(g: Graph, equation: Any, args: list[Any]) -> list[Any]:
    """Written out; a long one stays a loop where there may be one."""
    params = equation.params
    length, body = params["length"], params["jaxpr"]
    if not g.rich and (length > UNROLL or length * len(body.jaxpr.eqns) > EQUATIONS):
        raise LoweringError(f"an inner loop of {length} rounds")
    constants, carried = scan_parts(equation)
    fixed = args[:constants]
    carry, xs = (
        [cells_of(g, a) for a in part]
        for part in (args[constants : constants + carried], args[constants + carried :])
    )
    if g.rich and length >= 4 and length * _equations(body.jaxpr) > WRITTEN_OUT:
        return _looped(g, equation, fixed, carry, xs)
    rows: list[list[Any]] = [[] for _ in range(length)]
    order = range(length)
    for t in reversed(order) if params["reverse"] else order:
        own = [_row(x, t) for x in xs]
        out = scalarise(g, body.jaxpr, body.consts, [*fixed, *carry, *own])
        carry, rows[t] = out[:carried], out[carried:]
    stacked = [np.stack(same) for same in zip(*rows, strict=True)]
    if not length:
        stacked = [np.empty(v.aval.shape, object) for v in equation.outvars[carried:]]
    return [*carry, *stacked]


def _equations(jaxpr: Any) -> int:
    """Equations of a jaxpr and of the calls in it."""
    return sum(
        _equations(called(e.params)[0]) if e.primitive.name in CALLS else 1 for e in jaxpr.eqns
    )


def _looped(
    g: Graph, equation: Any, fixed: list[Any], carry: list[Any], xs: list[Any]
) -> list[Any]:
    """As a node `loop`."""
    length, body = equation.params["length"], equation.params["jaxpr"]
    number = since = len(g.nodes)
    scanned = [
        source_of([x[(t, *index)] for t in range(length)])
        for x in xs
        for index in np.ndindex(*x.shape[1:])
    ]
    own = inputs(g, number, "L", carry, lambda _: None)
    row = inputs(g, number, "X", [_row(x, 0) for x in xs], lambda i: bounds_of(scanned[i], length))
    out = scalarise(g, body.jaxpr, body.consts, [*fixed, *own, *row])
    inside, rows = out[: len(carry)], out[len(carry) :]
    inner = Inner(
        number,
        length,
        equation.params["reverse"],
        tuple(cells(carry)),
        tuple(cells(inside)),
        tuple(cells(rows)),
        tuple(scanned),
    )
    loop = loop_node(g, inner, since)
    return results(g, loop, inside, rows)


def _row(array: np.ndarray, t: int) -> np.ndarray:
    return array[t : t + 1].reshape(array.shape[1:])


def _cond(g: Graph, equation: Any, args: list[Any]) -> list[Any]:
    which = args[0].reshape(-1)[0]
    branches = equation.params["branches"]
    results = [scalarise(g, b.jaxpr, b.consts, list(args[1:])) for b in branches]
    return [
        elementwise(lambda *x: _pick(g, "", None, which, *x), *same)
        for same in zip(*results, strict=True)
    ]


def _floor_quotient(g: Graph, x: Node, y: Node) -> Node:
    """The largest whole number <= x / y, for a constant y > 0."""
    y = g.op("cast", y, kind=x.kind)
    whole = g.op("div", x, y)
    below = g.op("lt", g.op("rem", x, y), g.const(0, x.kind))
    return g.op("sub", whole, g.op("cast", below, kind=x.kind))


def _is_floor_division(name: str, args: list[Any]) -> bool:
    if name != "floor_divide" or any(isinstance(a, ConstantTable) or not a.size for a in args):
        return False
    divisors = args[1].reshape(-1)
    return all(y.op == "const" and y.kind in "iul" and y.value > 0 for y in divisors)


def _iota(g: Graph, equation: Any, args: list[Any]) -> list[Any]:
    shape, along = equation.params["shape"], equation.params["dimension"]
    dtype = equation.params["dtype"]
    return [lifted(g, np.indices(shape)[along].astype(dtype))]


_CONTROL: dict[str, Callable[..., list[Any]]] = {"scan": _scan, "cond": _cond}
_STRUCTURED: dict[str, Callable[..., list[Any]]] = {
    **REDUCTIONS,
    "dot_general": dot,
    "iota": _iota,
    "scatter": scatter,
    "scatter-add": scatter,
    "scatter_add": scatter,
    "scatter-mul": scatter,
    "scatter_mul": scatter,
    "dynamic_update_slice": update_at,
}
