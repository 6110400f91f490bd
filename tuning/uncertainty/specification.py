"""Specification: a predicate over the columns of a sweep, ``contour_max_um < 20 and finite``.

The language: columns, numbers, ``+ - * /``, comparisons (chained too), ``and or not``, brackets.
Nothing else is evaluated. A run for which a column that is used has no value does not pass.
"""

import ast
import operator
import sys
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxstage.model.settings import nearest_name

Columns = Mapping[str, np.ndarray]

_COMPARE: dict[type[ast.cmpop], np.ufunc] = {
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
}
_COMBINE: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_LOGIC = {ast.And: np.logical_and.reduce, ast.Or: np.logical_or.reduce}
#: characters at most, and the largest number
LONGEST, LARGEST = 1000, sys.float_info.max


class Specification(NamedTuple):
    """A checked specification.

    Attributes:
        names: The columns it reads.
        limits: Column -> number that it is compared with, for plots; only of comparisons that all
            must hold.
    """

    text: str
    names: tuple[str, ...]
    limits: dict[str, float]
    tree: ast.expr

    def passes(self, columns: Columns) -> np.ndarray:
        """Which rows meet it, (n,) bool."""
        used = [np.asarray(columns[name]) for name in self.names]
        known = [np.isfinite(column) for column in used if column.dtype != bool]
        with np.errstate(all="ignore"):
            met = np.asarray(_value(self.tree, columns), bool)
        return np.logical_and.reduce([met, *known]) if known else met


def parse(text: str, columns: Mapping[str, type], option: str = "--spec") -> Specification:
    """Read and check a specification.

    Args:
        text: As the user wrote it.
        columns: Name -> float or bool, what may be used.
        option: Of the command line, to begin an error with.

    Raises:
        ValueError: In one line: what is wrong, and where.
    """
    shown = text if len(text) <= 200 else text[:200] + "..."
    try:
        if len(text) > LONGEST:
            raise ValueError(f"longer than {LONGEST} characters")
        tree = ast.parse(text.strip(), mode="eval").body
        names: dict[str, None] = {}
        if _kind(tree, columns, names) is not bool:
            raise ValueError("is a number: compare it with one, e.g. contour_max_um < 20")
        if not names:
            raise ValueError("reads no column")
    except SyntaxError as error:
        raise ValueError(f"{option} '{shown}': {error.msg} at character {error.offset}") from None
    except (RecursionError, MemoryError):
        raise ValueError(f"{option} '{shown}': too deeply nested") from None
    except ValueError as error:
        raise ValueError(f"{option} '{shown}': {error}") from None
    return Specification(text.strip(), tuple(names), _limits(tree), tree)


def _kind(node: ast.expr, columns: Mapping[str, type], names: dict[str, None]) -> type:
    """bool or float; raises ValueError for anything outside of the language."""

    def need(inner: ast.expr, expected: type) -> None:
        kind = _kind(inner, columns, names)
        if kind is not expected:
            told = "a condition, not a number" if kind is bool else "a number, not a condition"
            raise ValueError(f"'{ast.unparse(inner)}' is {told}")

    match node:
        case ast.BoolOp(values=values):
            for value in values:
                need(value, bool)
            return bool
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            need(operand, bool)
            return bool
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            need(operand, float)
            return float
        case ast.Compare(left=left, ops=ops, comparators=others):
            for op in ops:
                if type(op) not in _COMPARE:
                    raise ValueError(f"'{ast.unparse(node)}': only < <= > >= == != compare")
            for value in (left, *others):
                need(value, float)
            return bool
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _COMBINE:
            need(left, float)
            need(right, float)
            return float
        case ast.Constant(value=int() | float() as value) if type(value) is not bool:
            if not abs(value) <= LARGEST:
                raise ValueError(f"a number is beyond {LARGEST:g}")
            return float
        case ast.Name(id=name):
            if name not in columns:
                hint = nearest_name(name, columns)
                raise ValueError(f"unknown column '{name}'{hint}")
            names[name] = None
            return columns[name]
    raise ValueError(f"'{ast.unparse(node)}' is not part of the language")


def _value(node: ast.expr, columns: Columns) -> np.ndarray:
    match node:
        case ast.BoolOp(op=op, values=values):
            return _LOGIC[type(op)]([_value(value, columns) for value in values])
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return np.logical_not(_value(operand, columns))
        case ast.Compare(left=left, ops=ops, comparators=others):
            sides = [number(side, columns) for side in (left, *others)]
            pairs = zip(ops, sides, sides[1:], strict=False)
            return np.logical_and.reduce([_COMPARE[type(op)](a, b) for op, a, b in pairs])
        case ast.Name(id=name):
            return np.asarray(columns[name])
    raise AssertionError(ast.dump(node))


def number(node: ast.expr, columns: Mapping[str, Any]) -> Any:
    """The value of a checked arithmetic expression; columns may be traced arrays."""
    match node:
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -number(operand, columns)
        case ast.UnaryOp(operand=operand):
            return number(operand, columns)
        case ast.BinOp(left=left, op=op, right=right):
            return _COMBINE[type(op)](number(left, columns), number(right, columns))
        case ast.Name(id=name):
            return columns[name]
        case ast.Constant(value=value):
            return np.asarray(value, float)
    raise AssertionError(ast.dump(node))


def _limits(tree: ast.expr) -> dict[str, float]:
    """Column -> number, of plain comparisons joined by ``and``."""
    parts = tree.values if isinstance(tree, ast.BoolOp) and isinstance(tree.op, ast.And) else [tree]
    limits = {}
    for part in parts:
        match part:
            case ast.Compare(left=left, comparators=[right]):
                sides = {type(side): side for side in (left, right)}
                name, number = sides.get(ast.Name), sides.get(ast.Constant)
                if isinstance(name, ast.Name) and isinstance(number, ast.Constant):
                    limits[name.id] = float(number.value)  # type: ignore[arg-type]
    return limits
