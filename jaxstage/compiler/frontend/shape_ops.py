"""Primitives that only move elements, on arrays of anything."""

from collections.abc import Callable
from typing import Any

import numpy as np


def _broadcast(args: list[Any], params: dict[str, Any]) -> np.ndarray:
    shape, where = params["shape"], params["broadcast_dimensions"]
    ones = [1] * len(shape)
    for size, d in zip(args[0].shape, where, strict=True):
        ones[d] = size
    return np.broadcast_to(args[0].reshape(ones), shape)


def _pad(args: list[Any], params: dict[str, Any]) -> np.ndarray:
    array, value = args[0], args[1].reshape(-1)[0]
    config = params["padding_config"]
    shape = [
        max(low + high + size + max(size - 1, 0) * inner, 0)
        for size, (low, high, inner) in zip(array.shape, config, strict=True)
    ]
    out = np.empty(shape, object)
    for index in np.ndindex(*shape):
        out[index] = value
    for index in np.ndindex(*array.shape):
        to = tuple(low + i * (inner + 1) for i, (low, _, inner) in zip(index, config, strict=True))
        if all(0 <= t < n for t, n in zip(to, shape, strict=True)):
            out[to] = array[index]
    return out


def _slice(args: list[Any], params: dict[str, Any]) -> np.ndarray:
    strides = params["strides"] or [1] * args[0].ndim
    bounds = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return args[0][tuple(slice(*b) for b in bounds)]


def _split(args: list[Any], params: dict[str, Any]) -> list[np.ndarray]:
    return np.split(args[0], np.cumsum(params["sizes"])[:-1], axis=params["axis"])


def _unstack(args: list[Any], params: dict[str, Any]) -> list[np.ndarray]:
    rows = np.moveaxis(args[0], params["axis"], 0)
    return [rows[i : i + 1].reshape(rows.shape[1:]) for i in range(len(rows))]


SHAPE_OPS: dict[str, Callable[[list[Any], dict[str, Any]], Any]] = {
    "broadcast_in_dim": _broadcast,
    "reshape": lambda args, p: args[0].reshape(p["new_sizes"]),
    "transpose": lambda args, p: args[0].transpose(p["permutation"]),
    "squeeze": lambda args, p: np.squeeze(args[0], tuple(p["dimensions"])),
    "expand_dims": lambda args, p: np.expand_dims(args[0], tuple(p["dimensions"])),
    "slice": _slice,
    "rev": lambda args, p: np.flip(args[0], p["dimensions"]),
    "concatenate": lambda args, p: np.concatenate(args, axis=p["dimension"]),
    "pad": _pad,
    "split": _split,
    "stack": lambda args, p: np.stack(args, axis=p["axis"]),
    "unstack": _unstack,
}
