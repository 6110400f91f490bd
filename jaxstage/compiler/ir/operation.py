"""What an operation is: its meaning, what follows for its result, and how each target writes it."""

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from jaxstage.compiler.ir.node import Node

if TYPE_CHECKING:
    from jaxstage.compiler.ir.graph import Graph

#: bounds of the result, from the kind of the result and the arguments
IntervalRule = Callable[[str, tuple[Node, ...]], tuple[float, float]]
#: whether the result may be NaN when no real argument is
NanRule = Callable[[tuple[Node, ...]], bool]
#: an equal and simpler node, from the graph, the kind of the result and the arguments, or None
Rewrite = Callable[["Graph", str, tuple[Node, ...]], Node | None]


class C99(NamedTuple):
    """How C99 writes an operation. Missing forms are empty; without any, it has none.

    Attributes:
        infix: Operator between reals, and between integers where nothing can wrap.
        logic: Operators between truth values and between the bits of integers.
        prefix: Operator before a number and before a truth value.
        library: Function of ``math.h`` on doubles.
        real: Signature and result of a small function on reals.
        whole: Result of a small function on integers of type T, which wrap in the type U.
        unsigned: The same for unsigned integers, where it differs.
    """

    infix: str = ""
    logic: tuple[str, str] = ("", "")
    prefix: tuple[str, str] = ("", "")
    library: str = ""
    real: tuple[str, str] = ("", "")
    whole: str = ""
    unsigned: str = ""


class Cxx(NamedTuple):
    """How C++ writes an operation on vectors of runs, with a place ``{}`` for each argument.

    Attributes:
        text: On numbers.
        truth: On truth values.
    """

    text: str = ""
    truth: str = ""


def unbounded(kind: str, args: tuple[Node, ...]) -> tuple[float, float]:
    """All that the kind can hold: what may leave it wraps or is infinite."""
    return float("nan"), float("nan")


def always(args: tuple[Node, ...]) -> bool:
    """A result that may be NaN without a NaN among the arguments."""
    return True


@dataclasses.dataclass(frozen=True, kw_only=True)
class Op:
    """One operation of the graph, and all that any part of the compiler knows of it.

    Attributes:
        name: What nodes call it.
        arity: Number of arguments; None for any number.
        takes: Kinds that its arguments may have, a condition apart.
        gives: Kind of the result: empty for that of the last argument, ``?`` where the node says.
        primitive: Whether JAX has an elementwise primitive of this name and meaning.
        wraps: Whether an integer result may leave its kind and wraps around.
        real: Value on reals, for constant folding.
        whole: Value on integers and truth values, before it wraps.
        interval: Bounds of the result.
        nan: Whether the result may be NaN.
        rewrite: Algebraic simplification.
        c99: Text for controllers.
        cxx: Text for kernels of this processor.
    """

    name: str
    arity: int | None
    takes: str = "f"
    gives: str = ""
    primitive: bool = True
    wraps: bool = False
    real: Callable[..., float] | None = None
    whole: Callable[..., float] | None = None
    interval: IntervalRule = unbounded
    nan: NanRule = always
    rewrite: Rewrite | None = None
    c99: C99 | None = None
    cxx: Cxx | None = None
