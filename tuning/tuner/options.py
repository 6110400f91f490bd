"""The little languages of the command line: gains to tune, objective.

--gains "c1=0.1..10, eta:tied, weights:fixed"     names with range and how they are searched
--gains tuned.toml                                a file: the values to start from
--objective "contour_rms_um + 0.1*energy_J/2"     weight * metric / scale, summed
"""

import ast
import math
import re
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jaxstage.model.settings import nearest_name
from tuning.tuner.problem.objective import Term
from tuning.tuner.problem.search_space import Search
from tuning.tuner.problem.transforms import TRANSFORMS

_FLAGS = ("tied", "fixed", *TRANSFORMS)
_FORM = re.compile(
    r"(?P<name>[^=:]+?)(?:=(?P<low>[^:]*?)\.\.(?P<high>[^:]*?))?(?P<flags>(?::\w+)*)"
)
#: weights of energy and of the changes of the command beside the error
BESIDE = 0.1
#: characters of an objective at most, and of one that a message shows; largest weight or scale
LONGEST, SHOWN, LARGEST = 2000, 200, 1e100


class GainWords(NamedTuple):
    """What ``--gains`` says.

    Attributes:
        file: of the values to start from.
        searches: what is tuned, as plain data (`Search` by field, the transform by name).
    """

    file: Path | None
    searches: tuple[dict[str, Any], ...]


def parse_gains(words: Sequence[str]) -> GainWords:
    """Parse ``--gains`` words.

    Args:
        words: one that ends in .toml is a file, any other names what is tuned.

    Raises:
        ValueError: in one line.
    """
    files = [Path(word) for word in words if word.endswith(".toml")]
    if len(files) > 1:
        raise ValueError(f"--gains {files[0]} and {files[1]}: give one file to start from")
    names = [
        part.strip() for word in words if not word.endswith(".toml") for part in word.split(",")
    ]
    return GainWords(files[0] if files else None, tuple(map(_search, names)))


def _search(word: str) -> dict[str, Any]:
    match = _FORM.fullmatch(word)
    if not match:
        raise ValueError(f"--gains {word}: must be NAME or NAME=LOW..HIGH, then :tied, :log, ...")
    table: dict[str, Any] = {"name": match["name"].strip()}
    for end in ("low", "high"):
        if match[end] is not None:
            table[end] = _number(word, match[end])
    for flag in match["flags"].split(":")[1:]:
        if flag not in _FLAGS:
            hint = nearest_name(flag, _FLAGS)
            raise ValueError(f"--gains {word}: ':{flag}'{hint}: one of {', '.join(_FLAGS)}")
        table |= {flag: True} if flag in ("tied", "fixed") else {"transform": flag}
    return table


def _number(word: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        raise ValueError(f"--gains {word}: '{text}' is not a number") from None
    if not math.isfinite(number):
        raise ValueError(f"--gains {word}: '{text}' is not a finite number")
    return number


def search_of(table: dict[str, Any]) -> Search:
    """A `Search` of its plain data."""
    name = table.get("transform")
    return Search(**{**table, "transform": TRANSFORMS[name] if name else None})


# --- objective ---------------------------------------------------------------------------------


def default_objective(columns: Collection[str], unit: str) -> str:
    """The contour error, of one axis its following error, and a little of energy and of the changes
    of the command.

    Args:
        columns: that the loop has.
        unit: of the command, as columns write it.
    """
    error = next(n for n in ("contour_rms_um", "following_rms_um") if n in columns)
    beside = (f"command_change_rms_{unit}", "energy_J")
    return " + ".join([error, *(f"{BESIDE:g}*{name}" for name in beside if name in columns)])


def parse_objective(text: str, columns: Collection[str]) -> tuple[Term, ...]:
    """The terms of ``contour_rms_um + 0.1*energy_J/2``: weight * metric / scale, summed.

    Args:
        text: the sum.
        columns: that the loop has.

    Raises:
        ValueError: in one line, for anything else, an unknown metric, one named twice, and for a
            weight or scale that is not > 0.
    """
    shown = text if len(text) <= SHOWN else f"{text[:SHOWN]}..."
    try:
        if len(text) > LONGEST:
            raise ValueError(f"longer than {LONGEST} characters")
        tree = ast.parse(text.strip(), mode="eval").body
        terms = [_term(part, columns) for part in _summands(tree)]
        names = [term.column for term in terms]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ValueError(f"{twice[0]} stands twice")
    except SyntaxError as error:
        where = f"{error.msg.partition(';')[0]} at character {error.offset}"
        raise ValueError(f"--objective '{shown}': {where}") from None
    except (RecursionError, MemoryError):
        raise ValueError(f"--objective '{shown}': too deeply nested") from None
    except ValueError as error:
        raise ValueError(f"--objective '{shown}': {error}") from None
    return tuple(terms)


def _summands(tree: ast.expr) -> list[ast.expr]:
    if isinstance(tree, ast.BinOp) and isinstance(tree.op, ast.Add):
        return [*_summands(tree.left), *_summands(tree.right)]
    return [tree]


def _term(tree: ast.expr, columns: Collection[str]) -> Term:
    """weight * metric / scale, in any order that means that."""
    match tree:
        case ast.Name(id=name):
            if name not in columns:
                raise ValueError(f"unknown metric '{name}'{nearest_name(name, columns)}")
            return Term(name)
        case (
            ast.BinOp(left=ast.Constant(value=value), op=ast.Mult(), right=inner)
            | ast.BinOp(left=inner, op=ast.Mult(), right=ast.Constant(value=value))
        ):
            term = _term(inner, columns)
            return term._replace(weight=term.weight * _positive(value))
        case ast.BinOp(left=inner, op=ast.Div(), right=ast.Constant(value=value)):
            term = _term(inner, columns)
            return term._replace(scale=(term.scale or 1.0) * _positive(value))
    raise ValueError(f"'{ast.unparse(tree)}': must be weight * metric / scale")


def _positive(value: Any) -> float:
    if type(value) not in (int, float) or not 0 < value <= LARGEST:
        shown = "a number" if type(value) is int and value > LARGEST else value
        raise ValueError(f"{shown}: weights and scales must be > 0 and at most {LARGEST:g}")
    return float(value)
