"""The two kinds of object of this library, and what a field knows about itself.

* ``@pytree``: data. Frozen keyword-only dataclass, registered with JAX; every field is traced.
* ``@definition``: what is fixed. Frozen keyword-only dataclass of functions and Python numbers;
  hashable, never traced, so equal definitions share one compilation.

A field of a pytree is made by `gain` (tuned), `param` (uncertain), `known` (what a controller
assumes about its plant) or `signal` (computed); each carries its unit, symbol, range and meaning.
From these come the range checks, ``--set``, the tables of the documentation and the plot labels.
This is the only file that touches :mod:`dataclasses`.
"""

import dataclasses
import difflib
import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar, cast, dataclass_transform

import jax

T = TypeVar("T")

#: display unit -> (SI unit, number of display units in one SI unit)
DISPLAY = {
    "um": ("m", 1e6),
    "um2": ("m2", 1e12),
    "mm": ("m", 1e3),
    "mm/s": ("m/s", 1e3),
    "mm/min": ("m/s", 6e4),
    "%": ("1", 1e2),
    "mWh": ("J", 1 / 3.6),
}


@dataclasses.dataclass(frozen=True)
class Quantity:
    """What is always true of a field: role, unit, symbol, allowed range, shape, meaning.

    Attributes:
        role: ``gain``, ``param``, ``known`` or ``signal``.
        unit: SI unit; ``command`` stands for the command unit of the plant.
        symbol: of the source's equations.
        doc: meaning, in a few words.
        shape: ``()``, ``(axes,)``, ...; a word that is not ``axes`` is a size that the array sets.
        low: inclusive lower bound.
        above: exclusive lower bound.
        high: inclusive upper bound.
        at_least: name of a sibling field that this one may not fall below.
        infinite: inf is a valid value.
        shown: display unit.
    """

    role: str
    unit: str
    symbol: str
    doc: str
    shape: str
    low: float
    above: float
    high: float
    at_least: str
    infinite: bool
    shown: str

    @property
    def factor(self) -> float:
        """Number of display units in one SI unit."""
        return DISPLAY[self.shown][1] if self.shown != self.unit else 1.0

    @property
    def sizes(self) -> tuple[str, ...]:
        """The sizes of the described shape, as words: ``("axes",)``, ``("3",)``, ``()``."""
        words = (word.strip() for word in self.shape.strip("()").split(","))
        return tuple(word for word in words if word)

    def range_text(self) -> str:
        """The allowed range in words, e.g. ``> 0 kg``."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        parts = [f"> {self.above:g}{unit}"] if self.above > -math.inf else []
        parts += [f">= {self.low:g}{unit}"] if self.low > -math.inf else []
        parts += [f"<= {self.high:g}{unit}"] if self.high < math.inf else []
        return " and ".join(parts) or "finite"


def _quantity(role: str) -> Callable[..., Any]:
    def field(
        unit: str,
        symbol: str = "",
        doc: str = "",
        *,
        shape: str = "()",
        low: float = -math.inf,
        above: float = -math.inf,
        high: float = math.inf,
        at_least: str = "",
        infinite: bool = False,
        shown: str = "",
    ) -> Any:
        shown = shown or unit
        if shown != unit and DISPLAY[shown][0] != unit:
            raise ValueError(f"cannot show {unit} as {shown}")
        quantity = Quantity(
            role, unit, symbol, doc, shape, low, above, high, at_least, infinite, shown
        )
        return dataclasses.field(metadata={"quantity": quantity})

    return field


#: a field of a pytree that is tuned; arguments as the attributes of `Quantity`
gain = _quantity("gain")

#: a field of a pytree that is uncertain
param = _quantity("param")

#: a field of a pytree that a controller assumes about its plant
known = _quantity("known")

#: a field of a pytree that is computed
signal = _quantity("signal")


def part(doc: str = "") -> Any:
    """A field that holds another pytree (or an empty tuple)."""
    return dataclasses.field(metadata={"part": doc})


@dataclass_transform(
    kw_only_default=True, frozen_default=True, field_specifiers=(gain, param, known, signal, part)
)
def pytree(cls: type[T]) -> type[T]:
    """Mark a class as data: frozen keyword-only dataclass, all fields traced."""
    return jax.tree_util.register_dataclass(dataclasses.dataclass(frozen=True, kw_only=True)(cls))


@dataclass_transform(kw_only_default=True, frozen_default=True)
def definition(cls: type[T]) -> type[T]:
    """Mark a class as a definition: frozen, hashable, compared by value, never traced."""
    return dataclasses.dataclass(frozen=True, kw_only=True)(cls)


def replace(obj: T, **changes: Any) -> T:
    """A copy of a pytree, definition or `Case` with some fields changed.

    Raises:
        ValueError: it does not have such a field; with the nearest one.
    """
    names = getattr(obj, "_fields", None) or [f.name for f in dataclasses.fields(obj)]  # type: ignore[arg-type]
    for name in changes.keys() - set(names):
        close = difflib.get_close_matches(name, names, n=1, cutoff=0.4)
        hint = f"; did you mean '{close[0]}'?" if close else f" (it has {', '.join(names)})"
        raise ValueError(f"{type(obj).__name__} has no field '{name}'{hint}")
    if isinstance(obj, tuple):
        return obj._replace(**changes)  # type: ignore[attr-defined]
    return dataclasses.replace(obj, **changes)  # type: ignore[type-var]


def in_units_of(quantity: Quantity, command_unit: str) -> Quantity:
    """The quantity with the plant's command unit in place of the word ``command``.

    ``N/command`` is ``N/A`` or ``N/(N m)``.
    """

    def power(word: re.Match[str]) -> str:
        text = " ".join(factor + word[2] for factor in command_unit.split())
        return f"/({text})" if word[1] and " " in text else word[1] + text

    both = (quantity.unit, quantity.shown)
    unit, shown = (re.sub(r"(/?)command(\d*)", power, text) for text in both)
    return dataclasses.replace(quantity, unit=unit, shown=shown)


def quantities(cls: Any) -> dict[str, Quantity]:
    """The fields of a pytree class (or instance) that carry a unit."""
    return {
        f.name: f.metadata["quantity"] for f in dataclasses.fields(cls) if "quantity" in f.metadata
    }


def parts(cls: Any) -> tuple[str, ...]:
    """The names of the fields of a pytree class that hold other pytrees."""
    return tuple(f.name for f in dataclasses.fields(cls) if "quantity" not in f.metadata)


def is_pytree_data(obj: Any) -> bool:
    """True for an instance of a `@pytree` class."""
    return dataclasses.is_dataclass(obj) and not isinstance(obj, type)


def map_leaves(function: Callable[[Quantity, Any], Any], tree: Any) -> Any:
    """The tree with ``function(quantity, value)`` in place of every field with a unit."""
    if is_pytree_data(tree):
        units = quantities(tree)
        changed = {
            f.name: function(units[f.name], value)
            if f.name in units
            else map_leaves(function, value)
            for f in dataclasses.fields(tree)
            for value in (getattr(tree, f.name),)
        }
        return type(tree)(**changed)
    if isinstance(tree, tuple):
        return tuple(map_leaves(function, value) for value in cast(tuple[Any, ...], tree))
    return tree


def leaves(tree: Any, prefix: str = "") -> Iterator[tuple[str, Quantity, Any]]:
    """Every field with a unit below ``tree``, in order.

    Args:
        tree: pytree data, dicts, tuples and lists of them.
        prefix: begins the names.

    Yields:
        Dotted name such as ``plant.friction.static``, quantity and value.
    """
    if is_pytree_data(tree):
        units = quantities(tree)
        for f in dataclasses.fields(tree):
            path = f"{prefix}.{f.name}" if prefix else f.name
            value = getattr(tree, f.name)
            if f.name in units:
                yield path, units[f.name], value
            else:
                yield from leaves(value, path)
    elif isinstance(tree, dict):
        for name, value in cast(dict[Any, Any], tree).items():
            yield from leaves(value, f"{prefix}.{name}" if prefix else str(name))
    elif isinstance(tree, tuple | list):
        for index, value in enumerate(cast(Sequence[Any], tree)):
            yield from leaves(value, f"{prefix}.{index}" if prefix else str(index))
