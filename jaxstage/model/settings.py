"""Settings by name: names, symbols and suffixes to leaves; TOML to settings and back.

A setting is a leaf of gains, scenario or motion. Its full name is dotted, ``plant.mass``; any
unique end of it will do, and the symbol in place of the field, ``plant.M``.
"""

import difflib
import re
import reprlib
import textwrap
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import jax.numpy as jnp
import numpy as np
import tomli_w

from jaxstage.model.fields import Quantity, is_pytree_data, leaves, replace
from jaxstage.model.signals import Scenario
from jaxstage.system.files import read_input

#: parts of a scenario that settings reach
SCENARIO_PARTS = ("plant", "load", "sensor", "drive", "start")
#: what the settings of a motion begin with
MOTION = "reference"


def known_leaves(
    gains: Any, scenario: Scenario, motion: Any = ()
) -> dict[str, tuple[Quantity, Any]]:
    """Every setting of a loop: full name -> (quantity, value).

    Args:
        gains: of the controller.
        scenario: of the run.
        motion: parameters of the reference. Where it is computed in the loop, its sizes are
            settings, ``reference.``; its times follow from the timing of the case.
    """
    known = {name: (q, v) for name, q, v in leaves(gains, "gains")}
    for part in SCENARIO_PARTS:
        known |= {name: (q, v) for name, q, v in leaves(getattr(scenario, part), part)}
    return known | {
        name: (q, v)
        for name, q, v in leaves(motion, MOTION)
        if q.role != "signal" and q.unit == "m"
    }


def resolve(
    name: str, known: Mapping[str, tuple[Quantity, Any]], other_names: tuple[str, ...] = ()
) -> str:
    """The full name of a setting, from its name, a unique end of it, or its symbol.

    Args:
        name: as the user wrote it.
        known: of `known_leaves`.
        other_names: what else the user may have meant, for the hint.

    Raises:
        ValueError: the name is unknown, with the nearest known one, or ambiguous, with all it may
            mean.
    """
    if name in known:
        return name
    matches: list[str] = []
    for full, (quantity, _) in known.items():
        stem = full.rpartition(".")[0]
        spellings = (full, f"{stem}.{quantity.symbol}")
        if any(s == name or s.endswith("." + name) for s in spellings):
            matches.append(full)
    if len(matches) == 1:
        return matches[0]
    if matches:
        raise ValueError(f"'{name}' may mean {', '.join(matches)}: write it in full")
    raise ValueError(f"unknown setting '{name}'{_hint(name, known, other_names)}")


def _hint(
    name: str, known: Mapping[str, tuple[Quantity, Any]], other_names: tuple[str, ...]
) -> str:
    """The nearest setting; where only the table of a dotted name is right, what it has."""
    stem, _, field = name.rpartition(".")
    fields = [full.removeprefix(f"{stem}.") for full in known if full.startswith(f"{stem}.")]
    if not stem or not fields:
        return nearest_name(name, [*other_names, *_spellings(known)])
    close = difflib.get_close_matches(field, fields, n=1, cutoff=0.5)
    return f"; did you mean '{stem}.{close[0]}'?" if close else f"; {stem} has {', '.join(fields)}"


def _spellings(known: Mapping[str, tuple[Quantity, Any]]) -> list[str]:
    names: list[str] = []
    for full, (quantity, _) in known.items():
        stem, _, field = full.rpartition(".")
        names += [full, field, f"{stem}.{quantity.symbol}"]
    return names


def nearest_name(name: str, names: Iterable[str]) -> str:
    """``; did you mean 'x'?`` with the nearest of the names, or an empty text."""
    close = difflib.get_close_matches(name, list(names), n=1, cutoff=0.4)
    return f"; did you mean '{close[0]}'?" if close else ""


def apply(
    gains: Any,
    scenario: Scenario,
    settings: Mapping[str, Any],
    other_names: tuple[str, ...] = (),
    motion: Any = (),
) -> tuple[Any, Scenario, Any, tuple[str, ...]]:
    """Gains, scenario and motion with settings applied.

    A single number fills the leaf; a list of one number per axis is spread over the rest of it.

    Args:
        gains: of the controller.
        scenario: of the run.
        settings: name -> number or nested list, SI.
        other_names: what else the user may have meant, for the hint.
        motion: parameters of the reference.

    Returns:
        Gains, scenario, motion, and the full names that were set.

    Raises:
        ValueError: a setting is unknown, ambiguous or of the wrong size.
    """
    paths: list[str] = []
    for name, value in settings.items():
        known = known_leaves(gains, scenario, motion)
        path = resolve(name, known, other_names)
        filled = _fill(path, value, known[path][1])
        root, *rest = path.split(".")
        if root == MOTION:
            motion = with_leaf(motion, rest, filled)
        else:
            gains, scenario = replaced(gains, scenario, path, filled)
        paths.append(path)
    return gains, scenario, motion, tuple(paths)


def replaced(gains: Any, scenario: Scenario, path: str, value: Any) -> tuple[Any, Scenario]:
    """Gains and scenario with the leaf of a full name replaced."""
    root, _, rest = path.partition(".")
    if root == "gains":
        return with_leaf(gains, rest.split("."), value), scenario
    part = with_leaf(getattr(scenario, root), rest.split("."), value)
    return gains, replace(scenario, **{root: part})


def _fill(path: str, value: Any, old: Any) -> Any:
    try:
        if not _is_real(value):
            raise TypeError
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        shown = reprlib.repr(value).strip("'")
        raise ValueError(f"{path} = {shown}: must be a number, or one number per axis") from None
    shape = np.shape(old)
    if array.ndim == 1 and len(shape) > 1 and array.shape[0] == shape[0]:
        array = array.reshape(-1, *[1] * (len(shape) - 1))
    if array.shape == (1,) or array.ndim == 0:
        array = array.reshape(())
    elif array.ndim != len(shape):
        raise ValueError(f"{path} takes {_sizes(shape)}, got {array.size} numbers")
    try:
        return jnp.asarray(np.broadcast_to(array, shape), dtype=jnp.result_type(old))  # pyright: ignore[reportUnknownMemberType]
    except ValueError:
        raise ValueError(f"{path} takes {_sizes(shape)}, got {array.size} numbers") from None


def _is_real(value: Any) -> bool:
    """True for whole and real numbers, arrays and nested lists of them: no bool and no text."""
    if isinstance(value, list | tuple):
        return all(_is_real(item) for item in cast(Sequence[Any], value))
    return np.asarray(value).dtype.kind in "iuf" or type(value) is int


def _sizes(shape: tuple[int, ...]) -> str:
    if not shape:
        return "one number"
    return f"one number or {shape[0]}" + (f", or an array {shape}" if len(shape) > 1 else "")


def with_leaf(tree: Any, names: list[str], value: Any) -> Any:
    """The tree with the leaf below the named fields replaced."""
    if not names:
        return value
    head, *rest = names
    if is_pytree_data(tree):
        return replace(tree, **{head: with_leaf(getattr(tree, head), rest, value)})
    index = int(head)
    items = list(tree)
    items[index] = with_leaf(items[index], rest, value)
    return type(tree)(items)


class TomlFile(NamedTuple):
    """A TOML file, read once: a pipe gives its text only once.

    Attributes:
        file: where it stands.
        text: what the values were read from, for the line of an error.
        values: dotted name -> value.
    """

    file: Path
    text: str
    values: dict[str, Any]

    def place(self, name: str, number: int = 0) -> str:
        """``file:line`` of a key by its dotted name, or of a [table], of which a list of tables has
        a ``number``-th, counted from 0. Line 1 where it is not found."""
        return f"{self.file}:{self._line(name, number)}"

    def _line(self, name: str, number: int) -> int:
        table, similar = "", 1
        for at, line in enumerate(self.text.splitlines(), start=1):
            content = line.split("#")[0].strip()
            header = _HEADER.fullmatch(content)
            if header:
                table, number = _dotted(header[1]), number - (_dotted(header[1]) == name)
                if table == name and number < 0:
                    return at
            elif "=" in content:
                key = _dotted(content.split("=")[0])
                full = f"{table}.{key}" if table else key
                if full == name or name.startswith(f"{full}."):  # a table within braces
                    return at
                if similar == 1 and full.rpartition(".")[2] == name.rpartition(".")[2]:
                    similar = at
        return similar


#: the line that begins a table, or one of a list of tables
_HEADER = re.compile(r"\[\[?([^\[\],]+)\]\]?")


def _dotted(text: str) -> str:
    """A key as TOML writes it, without quotes and blanks."""
    return ".".join(part.strip("\"' ") for part in text.split("."))


def read_toml(file: Path) -> TomlFile:
    """Read a TOML file.

    Raises:
        ValueError: it cannot be read; one line with file and line number.
    """
    text = ""
    try:
        text = read_input(file)
        return TomlFile(file, text, _flat(tomllib.loads(text), ""))
    except FileNotFoundError:
        raise ValueError(f"{file}: no such file") from None
    except OSError as error:
        raise ValueError(f"{file}: {error.strerror}") from None
    except RecursionError:
        raise ValueError(f"{file}: tables or lists are nested too deep") from None
    except tomllib.TOMLDecodeError as error:
        end = f"at the end, line {len(text.splitlines())}"
        message = str(error).replace("at end of document", end)
        raise ValueError(f"{file}: {message}") from None
    except ValueError as error:
        if "digits" not in str(error):
            raise
        raise ValueError(f"{file}: a whole number has too many digits") from None


def _flat(table: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in table.items():
        path = f"{prefix}.{name}" if prefix else name
        inner = cast(Mapping[str, Any], value) if isinstance(value, Mapping) else None
        flat |= {path: value} if inner is None else _flat(inner, path)
    return flat


def nested(tree: Any) -> Any:
    """Gains or parameters as nested tables of plain numbers and lists, ready for TOML."""
    table: dict[str, Any] = {}
    for path, _, value in leaves(tree):
        *tables, field = path.split(".")
        inner = table
        for name in tables:
            inner = inner.setdefault(name, {})
        inner[field] = np.asarray(value, dtype=float).tolist()
    return table


def to_toml(sections: Mapping[str, Any], values: Mapping[str, Any] | None = None) -> str:
    """TOML text of plain values and named pytrees; `read_toml` and `apply` take it back."""
    tables = {name: nested(tree) for name, tree in sections.items()}
    return plain_toml({**(values or {}), **{k: v for k, v in tables.items() if v}})


#: numbers of an array, one a line, as the writer of TOML leaves them: no string holds a line break
_ROW = re.compile(
    r"^(?P<indent> *)(?P<key>.*)\[\n(?P<numbers>(?: *[-+.\w]+,\n)+) *\]", re.MULTILINE
)
WIDTH = 100


def plain_toml(table: Mapping[str, Any]) -> str:
    """TOML text of plain data, with the rows of an array on lines."""
    return _ROW.sub(_on_a_line, tomli_w.dumps(table))


def _on_a_line(array: re.Match[str]) -> str:
    indent, numbers = array["indent"], " ".join(array["numbers"].split()).removesuffix(",")
    line = f"{indent}{array['key']}[{numbers}]"
    if len(line) < WIDTH:
        return line
    deeper = f"{indent}    "
    wrapper = textwrap.TextWrapper(
        WIDTH - 1, initial_indent=deeper, subsequent_indent=deeper, break_on_hyphens=False
    )
    return f"{indent}{array['key']}[\n{wrapper.fill(numbers + ',')}\n{indent}]"
