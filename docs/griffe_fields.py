"""What the signatures of the site show of fields and constants.

An object has its entry in the module that defines it, which may have the same name: what a package
takes from its modules is left out of the package. The fields of a pytree class become one table
(symbol, unit, shape, range, meaning) in place of an entry each. A constant is explained by the
``#:`` comment above it.
"""

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import griffe

from docs.hooks import fields


class FieldTables(griffe.Extension):
    """Extension of the reader that mkdocstrings uses."""

    def on_module_members(self, *, mod: griffe.Module, **_: Any) -> None:
        """Leave out of a package what it takes from its modules."""
        if mod.is_init_module:
            for name in [n for n, member in mod.members.items() if member.is_alias]:
                del mod.members[name]

    def on_class(self, *, cls: griffe.Class, **_: Any) -> None:
        """Put the table of its fields into the docstring of a pytree class."""
        if not any(str(d.value) == "pytree" for d in cls.decorators):
            return
        for name, member in list(cls.members.items()):
            if member.is_attribute and name in _fields_of(cls):
                del cls.members[name]
        said = cls.docstring.value if cls.docstring else ""
        cls.docstring = griffe.Docstring(f"{said}\n\n{fields(cls.path)}", parent=cls)

    def on_attribute(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Take the comment above a constant for its docstring."""
        if attr.docstring is None and attr.lineno and isinstance(attr.filepath, Path):
            text = comment_above(attr.lines_collection[attr.filepath], attr.lineno)
            attr.docstring = griffe.Docstring(text, parent=attr) if text else None


def _fields_of(cls: griffe.Class) -> Sequence[str]:
    module = importlib.import_module(cls.module.path)
    return tuple(getattr(module, cls.name).__dataclass_fields__)


def comment_above(lines: Sequence[str], number: int) -> str:
    """The ``#:`` comment that ends above a line, counted from 1."""
    start = number - 1
    while start and lines[start - 1].startswith("#"):
        start -= 1
    block = [line.lstrip("#:").strip() for line in lines[start : number - 1]]
    return " ".join(block) if lines[start].startswith("#:") else ""
