"""Pytrees as C structs: the same names, nested alike, with unit and meaning beside each member."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxstage.compiler.c99.ops import TYPES, wrapped
from jaxstage.compiler.frontend.scalarize import kind_of
from jaxstage.model.fields import Quantity, in_units_of, is_pytree_data, quantities

#: words that C or C++ keep for themselves and a field may bear
_RESERVED = frozenset(
    """alignas alignof and asm auto bool break case catch char class const constexpr continue
    default delete do double else enum explicit export extern false float for friend goto if
    inline int long mutable namespace new not operator or private protected public real register
    restrict return short signed sizeof static struct switch template this throw true try typedef
    typename union unsigned using virtual void volatile while xor""".split()
)


class Member(NamedTuple):
    """One array of a pytree as a member of a struct.

    Attributes:
        names: From the outermost struct in.
        shape: Of the array.
        kind: As of a node of the graph.
        quantity: Unit, symbol and meaning; None where the field says nothing about itself.
        value: The array, or its shape and type.
    """

    names: tuple[str, ...]
    shape: tuple[int, ...]
    kind: str
    quantity: Quantity | None
    value: Any

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)

    @property
    def name(self) -> str:
        """The member as it is reached from its struct, e.g. ``nominal.mass``."""
        return ".".join(self.names)

    def element(self, index: int) -> str:
        """One element of it, e.g. ``nominal.mass[1]``."""
        return f"{self.name}[{index}]" if self.shape else self.name


def members(tree: Any, command_unit: str, one_axis: bool = False) -> tuple[Member, ...]:
    """The arrays of a pytree, in JAX's order.

    Args:
        tree: Arrays, or shapes and types.
        command_unit: What the unit ``command`` means for this machine.
        one_axis: Whether a leading 1 is left out of the shapes.
    """
    every = []
    for path, value in jax.tree_util.tree_leaves_with_path(tree):
        shape = tuple(np.shape(value))
        shape = shape[1:] if one_axis and shape[:1] == (1,) else shape
        quantity = _quantity(tree, path)
        every.append(
            Member(
                names=tuple(_name(key) for key in path) or ("value",),
                shape=shape,
                kind=kind_of(value.dtype),
                quantity=None if quantity is None else in_units_of(quantity, command_unit),
                value=value,
            )
        )
    return tuple(every)


def _name(key: Any) -> str:
    name = getattr(key, "name", getattr(key, "key", getattr(key, "idx", None)))
    text = f"part{name}" if isinstance(name, int) else str(name)
    return text + "_" if text in _RESERVED else text


def _quantity(tree: Any, path: Sequence[Any]) -> Quantity | None:
    for key in path[:-1]:
        tree = getattr(tree, key.name) if hasattr(key, "name") else tree[_index(key)]
    if path and is_pytree_data(tree):
        return quantities(tree).get(path[-1].name)
    return None


def _index(key: Any) -> Any:
    return key.idx if hasattr(key, "idx") else key.key


def declare(every: Sequence[Member], name: str, purpose: str, real: str) -> str:
    """The typedef of a struct, its members with unit, meaning and allowed range.

    Args:
        every: The members.
        name: Of the struct.
        purpose: Stands above it.
        real: C type of reals.
    """
    lines = [f"/* {purpose} */", "typedef struct {"]
    lines += _declared(every, 1, TYPES | {"f": real})
    if not every:
        lines.append("    char nothing; /* C99 has no empty struct */")
    return "\n".join([*lines, f"}} {name};"])


def _declared(every: Sequence[Member], depth: int, types: dict[str, str]) -> Iterator[str]:
    margin = "    " * depth
    for name, inside in _grouped(every, depth):
        if inside is None:
            member = name
            shape = f"[{member.size}]" if member.shape else ""
            yield from _commented(
                f"{margin}{types[member.kind]} {member.names[-1]}{shape};", meaning(member)
            )
        else:
            yield f"{margin}struct {{"
            yield from _declared(inside, depth + 1, types)
            yield f"{margin}}} {name};"


def _grouped(every: Sequence[Member], depth: int) -> Iterator[tuple[Any, Any]]:
    """Members at a depth, and (name, members) of the structs there, in order."""
    seen = set()
    for member in every:
        if len(member.names) == depth:
            yield member, None
        elif member.names[depth - 1] not in seen:
            name = member.names[depth - 1]
            seen.add(name)
            yield name, [m for m in every if len(m.names) > depth and m.names[depth - 1] == name]


def meaning(member: Member) -> str:
    """Unit, symbol, meaning and allowed range of a member."""
    quantity = member.quantity
    if quantity is None:
        return ""
    unit = "no unit" if quantity.unit == "1" else quantity.unit
    symbol = f" {quantity.symbol}" if quantity.symbol else ""
    order = f"; {member.shape} in C order" if len(member.shape) > 1 else ""
    allowed = quantity.range_text().replace(f" {quantity.unit}", "")
    allowed = f"; {allowed}" if quantity.role in ("gain", "known") else ""
    return f"[{unit}]{symbol}: {quantity.doc}{allowed}{order}".replace("*/", "* /")


def _commented(code: str, comment: str) -> Iterator[str]:
    """One line with its comment, or the comment on a line above where that is too long."""
    if not comment:
        yield code
    elif len(code) + len(comment) + 7 <= 100:
        yield f"{code} /* {comment} */"
    else:
        yield f"{code[: len(code) - len(code.lstrip())]}/* {comment} */"
        yield code


def initialise(every: Sequence[Member], text: Callable[[Any, str], str], depth: int = 1) -> str:
    """The initialiser of a struct with designated members.

    Args:
        every: The members.
        text: A number of a kind as C.
        depth: Of the struct among structs.
    """
    margin = "    " * depth
    lines = []
    for name, inside in _grouped(every, depth):
        if inside is not None:
            lines.append(f"{margin}.{name} = {initialise(inside, text, depth + 1)},")
            continue
        member = name
        unit = "" if member.quantity is None else f" /* {member.quantity.unit} */"
        head = f"{margin}.{member.names[-1]} = "
        lines += [
            f"{head}{line}" if i == 0 else line
            for i, line in enumerate(_values(member, text, margin))
        ]
        lines[-1] += f",{unit}"
    if not every:
        lines.append(f"{margin}0")
    return "\n".join(["{", *lines, "    " * (depth - 1) + "}"])


def _values(member: Member, text: Callable[[Any, str], str], margin: str) -> list[str]:
    """The numbers of a member, in braces and in lines where there are many."""
    numbers = [text(v, member.kind) for v in np.asarray(member.value).reshape(-1)]
    if not member.shape:
        return numbers
    plain = "{" + ", ".join(numbers) + "}"
    if len(plain) <= 72:
        return [plain]
    inner, row = margin + "    ", member.shape[-1]
    rows = [numbers[i : i + row] for i in range(0, len(numbers), row)]
    lines = [line for items in rows for line in wrapped(items, inner)]
    return ["{", *lines, margin + "}"]
