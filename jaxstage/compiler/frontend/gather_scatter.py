"""Gather and scatter: reading and writing at an index that is known only at run time.

The interval of the index says which elements it can reach. Where these are inputs in a row, the
element is loaded from memory; else it is selected among them. A write sets every element that may
be meant to a selection, which `store_forms` makes one store again.
"""

import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from jaxstage.compiler.frontend.constant_table import ConstantTable
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.ir.graph import Graph
from jaxstage.compiler.ir.node import Node

#: up to this many elements a selection is cheaper than a load
SELECTED = 2
#: the most elements that an index may select among
REACH = 512

Index = tuple[int, ...]


class Lookup(NamedTuple):
    """What a gather needs beside its arguments.

    Attributes:
        graph: Gets the nodes.
        shape: Of the result.
    """

    graph: Graph
    shape: tuple[int, ...]


def _number(array: Any, index: Any = ()) -> Node:
    return array[index] if index else array.reshape(-1)[0]


def _clipped(g: Graph, node: Node, top: int) -> Node:
    return g.op("min", g.op("max", node, g.const(0, node.kind)), g.const(top, node.kind))


def _reached(node: Node, size: int) -> range:
    """The elements of ``size`` that an index can mean."""
    low = 0 if math.isinf(node.low) else max(0, int(node.low))
    high = size - 1 if math.isinf(node.high) else min(size - 1, int(node.high))
    return range(low, high + 1)


# --- reading -----------------------------------------------------------------------------------


def slice_at(at: Lookup, args: list[Any], params: dict[str, Any]) -> np.ndarray:
    """``dynamic_slice``: starts are clipped so that the slice fits."""
    g, shape = at
    array, sizes = args[0], params["slice_sizes"]
    rooms = [n - m + 1 for n, m in zip(array.shape, sizes, strict=True)]
    starts = [_clipped(g, _number(s), r - 1) for s, r in zip(args[1:], rooms, strict=True)]
    out = np.empty(shape, object)
    for index in np.ndindex(*shape):
        out[index] = _read(g, array, starts, rooms, index, range(len(shape)))
    return out


def gather(at: Lookup, args: list[Any], params: dict[str, Any]) -> np.ndarray:
    """``gather`` in its general form; an index out of range is clipped, or gives the fill value."""
    g, shape = at
    array, indices = args[0], args[1]
    numbers, mode = params["dimension_numbers"], str(params["mode"])
    gone = {*numbers.collapsed_slice_dims, *numbers.operand_batching_dims}
    offsets = [d for d in range(len(array.shape)) if d not in gone]
    batch = [d for d in range(len(shape)) if d not in numbers.offset_dims]
    sizes = params["slice_sizes"]
    rooms = [array.shape[m] - sizes[m] + 1 for m in numbers.start_index_map]
    out = np.empty(shape, object)
    for index in np.ndindex(*shape):
        row = tuple(index[d] for d in batch)
        base = [0] * len(array.shape)
        for d, o in zip(numbers.offset_dims, offsets, strict=True):
            base[o] = index[d]
        pairs = zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True)
        for o, s in pairs:
            base[o] = row[s]
        raw = [_number(indices, (*row, j)) for j in range(indices.shape[-1])]
        starts = [_clipped(g, s, r - 1) for s, r in zip(raw, rooms, strict=True)]
        value = _read(g, array, starts, rooms, tuple(base), numbers.start_index_map)
        if "FILL" in mode and value.kind in "fiul":
            value = _filled(g, value, raw, rooms, params.get("fill_value"))
        out[index] = value
    return out


def _filled(g: Graph, value: Node, raw: list[Node], rooms: list[int], fill: Any) -> Node:
    if fill is None:
        fill = math.nan if value.kind == "f" else -(2**31) if value.kind == "i" else 0
    for start, room in zip(raw, rooms, strict=True):
        above = g.op("ge", start, g.const(0, start.kind))
        inside = g.op("and", above, g.op("lt", start, g.const(room, start.kind)))
        value = g.op("select", inside, value, g.const(fill, value.kind))
    return value


def _read(
    g: Graph, array: Any, starts: list[Node], rooms: list[int], base: Index, dims: Any
) -> Node:
    """The element at ``base`` moved by the starts along the dimensions."""
    place = _Place(g, array.shape, starts, tuple(dims), base)
    if isinstance(array, ConstantTable):
        offset, index = flat_index(place)
        return g.load(array.source, offset, index, array.kind)
    reach = [_reached(s, r) for s, r in zip(starts, rooms, strict=True)]
    if math.prod(map(len, reach)) > REACH:
        raise LoweringError(f"an index that can mean {math.prod(map(len, reach))} elements")
    every = [(v, array[_moved(base, place.dims, v)]) for v in itertools.product(*reach)]
    element = look(g, [node for _, node in every], place, [v for v, _ in every])
    return element if element is not None else _selected(g, starts, reach, dict(every))


class _Place(NamedTuple):
    """An element whose index varies: ``base`` moved by ``starts`` along ``dims`` of a shape.

    Attributes:
        graph: Gets the nodes.
        shape: Of the array.
        starts: The part of the index that the run knows.
        dims: The dimensions that they count in.
        base: The fixed part of the index.
    """

    graph: Graph
    shape: tuple[int, ...]
    starts: list[Node]
    dims: tuple[int, ...]
    base: Index


def _moved(base: Index, dims: tuple[int, ...], by: Index) -> Index:
    out = list(base)
    for d, v in zip(dims, by, strict=True):
        out[d] += v
    return tuple(out)


def flat_index(place: _Place) -> tuple[int, Node]:
    """Position in C order: a constant, and a node of what varies."""
    g = place.graph
    strides = [math.prod(place.shape[d + 1 :]) for d in range(len(place.shape))]
    offset = sum(i * s for i, s in zip(place.base, strides, strict=True))
    index = g.const(0, "i")
    for start, d in zip(place.starts, place.dims, strict=True):
        if start.low == start.high:
            offset += int(start.low) * strides[d]
            continue
        whole = g.op("cast", start, kind="i")
        index = g.op("add", index, g.op("mul", whole, g.const(strides[d], "i")))
    return offset, index


def look(g: Graph, nodes: list[Node], place: Any, at: list[Index]) -> Node | None:
    """One node for any of several, chosen by an index.

    Inputs in a row are a load; constants that count are the index; equal operations on such are
    the operation on a load.

    Args:
        g: Gets the nodes.
        nodes: What the index can mean.
        place: The index.
        at: The value of the index for each of the nodes.

    Returns:
        The node, or None where they have nothing in common.
    """
    first = nodes[0]
    if all(n is first for n in nodes):
        return first
    if len(nodes) <= SELECTED or any(n.op != first.op or n.kind != first.kind for n in nodes):
        return None
    if first.op == "in":
        return _loaded(g, nodes, place, at)
    if first.op == "const" and first.kind == "i":
        return _counted(g, nodes, place, at)
    if first.value is not None or any(len(n.args) != len(first.args) for n in nodes):
        return None
    args = []
    for position in range(len(first.args)):
        chosen = look(g, [n.args[position] for n in nodes], place, at)
        if chosen is None:
            return None
        args.append(chosen)
    return g.op(first.op, *args, kind=first.kind)


def _in_memory(group: Any, kind: str) -> bool:
    """Whether a kernel keeps the inputs of a group as an array that it can index."""
    return not isinstance(group, tuple) or (group[0] in "cdg" and kind == "f")


def _counted(g: Graph, nodes: list[Node], place: _Place, at: list[Index]) -> Node | None:
    """Constants that count the elements are the index itself."""
    strides = [math.prod(place.shape[d + 1 :]) for d in place.dims]
    zero = nodes[0].value
    for node, v in zip(nodes, at, strict=True):
        ahead = sum(s * (i - j) for s, i, j in zip(strides, v, at[0], strict=True))
        if node.value != zero + ahead:
            return None
    _, index = flat_index(place)
    fixed = [s.low == s.high for s in place.starts]
    start = sum(0 if f else s * i for f, s, i in zip(fixed, strides, at[0], strict=True))
    return g.op("add", index, g.const(zero - start, "i"))


def _loaded(g: Graph, nodes: list[Node], place: _Place, at: list[Index]) -> Node | None:
    strides = [math.prod(place.shape[d + 1 :]) for d in place.dims]
    group, zero = nodes[0].value
    if not _in_memory(group, nodes[0].kind):
        return None
    for node, v in zip(nodes, at, strict=True):
        ahead = sum(s * (i - j) for s, i, j in zip(strides, v, at[0], strict=True))
        if node.value != (group, zero + ahead):
            return None
    _, index = flat_index(place)
    fixed = [s.low == s.high for s in place.starts]
    start = sum(0 if f else s * i for f, s, i in zip(fixed, strides, at[0], strict=True))
    return g.load(group, zero - start, index, nodes[0].kind, not nodes[0].nan)


def _selected(
    g: Graph, starts: list[Node], reach: list[range], every: dict[Index, Node], prefix: Index = ()
) -> Node:
    position = len(prefix)
    if position == len(starts):
        return every[prefix]
    start, numbers = starts[position], list(reach[position])
    values = [_selected(g, starts, reach, every, (*prefix, v)) for v in numbers]
    out = values[-1]
    for number, value in list(zip(numbers, values, strict=True))[-2::-1]:
        here = g.op("eq", start, g.const(number, start.kind))
        out = g.op("select", here, value, out)
    return out


# --- writing -----------------------------------------------------------------------------------


def update_at(g: Graph, equation: Any, args: list[Any]) -> list[Any]:
    """``dynamic_update_slice``."""
    array, update = args[0].copy(), args[1]
    rooms = [n - m + 1 for n, m in zip(array.shape, update.shape, strict=True)]
    starts = [_clipped(g, _number(s), r - 1) for s, r in zip(args[2:], rooms, strict=True)]
    for index in np.ndindex(*update.shape):
        place = _Place(g, array.shape, starts, tuple(range(array.ndim)), index)
        _write(array, place, rooms, update[index] if index else _number(update), "set")
    return [array]


def scatter(g: Graph, equation: Any, args: list[Any]) -> list[Any]:
    """``scatter``, ``scatter-add`` and ``scatter-mul``; an index out of range writes nothing."""
    array, indices, updates = args[0].copy(), args[1], args[2]
    numbers, mode = equation.params["dimension_numbers"], str(equation.params["mode"])
    gone = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
    windows = [d for d in range(array.ndim) if d not in gone]
    batch = [d for d in range(updates.ndim) if d not in numbers.update_window_dims]
    dims = tuple(numbers.scatter_dims_to_operand_dims)
    name = equation.primitive.name
    how = "add" if "add" in name else "mul" if "mul" in name else "set"
    width = [1] * array.ndim
    for d, o in zip(numbers.update_window_dims, windows, strict=True):
        width[o] = updates.shape[d]
    rooms = [array.shape[d] - width[d] + 1 for d in dims]
    for index in np.ndindex(*updates.shape):
        row = tuple(index[d] for d in batch)
        base = [0] * array.ndim
        for d, o in zip(numbers.update_window_dims, windows, strict=True):
            base[o] = index[d]
        pairs = zip(
            numbers.operand_batching_dims, numbers.scatter_indices_batching_dims, strict=True
        )
        for o, s in pairs:
            base[o] = row[s]
        starts = [_number(indices, (*row, j)) for j in range(indices.shape[-1])]
        if "CLIP" in mode:
            starts = [_clipped(g, s, r - 1) for s, r in zip(starts, rooms, strict=True)]
        place = _Place(g, array.shape, starts, dims, tuple(base))
        _write(array, place, rooms, _number(updates, index), how)
    return [array]


def _write(array: np.ndarray, place: _Place, rooms: list[int], value: Node, how: str) -> None:
    """Every element that can be meant: the value where it is, else what it was."""
    g = place.graph
    for v, here in _targets(place, rooms):
        to = _moved(place.base, place.dims, v)
        old = array[to]
        if how == "set":
            array[to] = g.op("select", here, value, old)
        else:
            neutral = g.const(0 if how == "add" else 1, value.kind)
            array[to] = g.op(how, old, g.op("select", here, value, neutral))


def _targets(place: _Place, rooms: list[int]) -> Iterator[tuple[Index, Node]]:
    """Every move that the starts can make, and whether it is the one."""
    g = place.graph
    reach = [_reached(s, r) for s, r in zip(place.starts, rooms, strict=True)]
    if math.prod(map(len, reach)) > REACH:
        raise LoweringError(f"an index that can mean {math.prod(map(len, reach))} elements")
    inside = all(s.low >= 0 and s.high < r for s, r in zip(place.starts, rooms, strict=True))
    _, flat = flat_index(place)
    strides = [math.prod(place.shape[d + 1 :]) for d in place.dims]
    fixed = [s.low == s.high for s in place.starts]
    for v in itertools.product(*reach):
        if inside:  # one comparison with the flat index: then an update is a store
            moved = sum(0 if f else s * i for f, s, i in zip(fixed, strides, v, strict=True))
            yield v, g.op("eq", flat, g.const(moved, "i"))
            continue
        here = g.const(True, "b")
        for start, number in zip(place.starts, v, strict=True):
            here = g.op("and", here, g.op("eq", start, g.const(number, start.kind)))
        yield v, here
