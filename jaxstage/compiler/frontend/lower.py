"""Lowering: a program as a graph, the numbers that its kernel reads, and what it makes of them."""

from typing import Any, NamedTuple

import numpy as np

from jaxstage.compiler.frontend.binding_time import (
    FIXED,
    RUN,
    TICK,
    FlatJaxpr,
    Staged,
    binding_times,
    counters,
    inline_calls,
)
from jaxstage.compiler.frontend.constant_table import WRITTEN_OUT, ConstantTable
from jaxstage.compiler.frontend.scalarize import evaluate, lifted
from jaxstage.compiler.frontend.step_program import Program
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.graph import Graph, new_graph
from jaxstage.compiler.ir.node import Node, kind_of

#: shared arrays of more elements stay in memory
TABLE = 64


class Lowered(NamedTuple):
    """A program as a graph, and what its kernel is called with.

    Attributes:
        graph: Operations of a tick.
        staged: The jaxpr with its levels: JAX computes what is not of a run.
        results: Arrays of nodes, one a result of the jaxpr.
        counter: Which carried integers count the ticks.
        tables: Values of `staged` that are read in memory.
        single: Whether reals are float32.
    """

    graph: Graph
    staged: Staged
    results: list[Any]
    counter: frozenset[int]
    tables: tuple[int, ...]
    single: bool


def lower(program: Program, closed: Any, own: tuple[bool, ...], groups: tuple[str, ...]) -> Lowered:
    """The graph of a jaxpr whose first arguments are the leaves of the program.

    Args:
        program: Tells which leaves are inputs, shared or carried.
        closed: The jaxpr of one tick, or of its derivative.
        own: Of each shared leaf and each carried one, whether runs have it for themselves.
        groups: Names of the inputs of further arguments, one an argument.

    Raises:
        LoweringError: A primitive or type has no compiled form, an array is too large.
    """
    steps = inline_calls(closed)
    carry = range(program.num_consts, program.num_consts + len(program.carry))
    inputs = len(program.inputs)
    counting = frozenset(n for n in counters(steps, carry) if not own[len(program.shared) + n])
    levels = [RUN] * inputs
    levels += [RUN if own[i] else FIXED for i in range(len(program.shared))]
    levels += [TICK if n in counting else RUN for n in range(len(program.carry))]
    levels += [RUN] * len(groups)
    staged = binding_times(steps, levels)
    graph = new_graph(program.single, rich=True)
    values, tables = _inputs(program, graph, staged, groups)
    for step in staged.per_run():
        reads = [_value(graph, values, v) for v in step.reads]
        values.update(zip(step.writes, evaluate(graph, step.equation, reads), strict=True))
    results = [_value(graph, values, v) for v in steps.results]
    return Lowered(graph, staged, results, counting, tables, program.single)


def _value(graph: Graph, values: dict[int, Any], value: Any) -> Any:
    return values[value] if isinstance(value, int) else lifted(graph, value.value)


def _shape_of(steps: FlatJaxpr, leaves: Any) -> dict[int, Any]:
    shapes = dict(zip(steps.arguments, leaves, strict=False))
    for step in steps.steps:
        shapes.update((w, v.aval) for w, v in zip(step.writes, step.equation.outvars, strict=True))
    return shapes


def _inputs(
    program: Program, graph: Graph, staged: Staged, groups: tuple[str, ...]
) -> tuple[dict[int, Any], tuple[int, ...]]:
    steps, leaves = staged.program, program.leaves
    values: dict[int, Any] = {n: lifted(graph, v) for n, v in steps.constants.items()}
    read = {v for step in staged.per_run() for v in step.reads if isinstance(v, int)}
    read |= {v for v in steps.results if isinstance(v, int)}
    for number, leaf in enumerate(leaves):
        value = steps.arguments[number]
        if staged.of(value) == RUN and value in read:
            if leaf.size > WRITTEN_OUT:
                raise LoweringError(
                    f"an array of {leaf.size} numbers that each run has for itself (a stored path)"
                )
            carried = number - program.num_consts
            group = ("c", carried) if carried >= 0 else ("p", number)
            promised = carried >= 0 and program.spec.finite
            values[value] = _array(graph, group, leaf, promised)
    extra = steps.arguments[len(leaves) :]
    for value, group in zip(extra, groups, strict=True):
        name, number = group[0], int(group[1:])
        leaf = leaves[number] if name == "q" else program.carry[number]
        values[value] = _array(graph, (name, number), leaf, False)
    shapes, tables = _shape_of(steps, leaves), []
    for value in staged.crossing():
        shape = shapes[value]
        if staged.of(value) == FIXED and int(np.prod(shape.shape)) > TABLE:
            values[value] = ConstantTable(
                ("t", len(tables)), tuple(shape.shape), kind_of(shape.dtype)
            )
            tables.append(value)
        else:
            group = "s" if staged.of(value) == FIXED else "r"
            values[value] = _array(graph, (group, value), shape, False)
    return values, tuple(tables)


def _array(graph: Graph, group: Any, leaf: Any, finite: bool) -> np.ndarray:
    out = np.empty(leaf.shape, object)
    kind = kind_of(leaf.dtype)
    if kind == "k":
        return out
    if kind == "l" and group[0] in "cp":
        raise LoweringError("64-bit integers that each run has for itself")
    _check_width(leaf.dtype, graph)
    for number, index in enumerate(np.ndindex(*leaf.shape)):
        out[index] = graph.input(group, number, kind, finite)
    return out


def _check_width(dtype: Any, graph: Graph) -> None:
    width = 4 if graph.largest < 1e39 else 8
    if np.issubdtype(dtype, np.floating) and np.dtype(dtype).itemsize != width:
        raise LoweringError(f"{np.dtype(dtype).name} beside reals of {8 * width} bits")


def flat(array: np.ndarray) -> list[Node]:
    """The nodes of an array in C order."""
    return list(array.reshape(-1))
