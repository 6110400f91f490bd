"""Checkpoint folder: keeps the configuration of long work, which can be stopped and gone on with.

The configuration is TOML text that everything depends on. A folder that holds something else, or
the same work with another configuration, is refused before anything is written.
"""

import hashlib
import os
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from jaxstage.system.files import write_text

#: differences of two configurations that are named
SHOWN = 5


class FolderKind(NamedTuple):
    """What a folder holds.

    Attributes:
        file: Name of the file of its configuration.
        noun: What the work is called.
        keys: What every such configuration has.
    """

    file: str
    noun: str
    keys: tuple[str, ...]


def create(folder: Path, kind: FolderKind, text: str, resume: bool) -> None:
    """Make the folder, or take one that holds the same work when ``resume``.

    Raises ValueError for a folder that holds something else, another configuration (with what
    differs), or this one without ``resume``; nothing is touched then.
    """
    if not folder.exists() or (folder.is_dir() and all(map(is_leftover, folder.iterdir()))):
        if resume and not folder.exists():
            raise ValueError(f"--resume: {folder} does not exist")
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / kind.file, text)
        return
    old = read_configuration(folder, kind)
    if old != text:
        changed = differences(old, text)
        more = f" and {len(changed) - SHOWN} more" if len(changed) > SHOWN else ""
        raise ValueError(
            f"{folder} holds a {kind.noun} of another configuration; "
            f"{'; '.join(changed[:SHOWN])}{more}"
        )
    if not resume:
        raise ValueError(f"{folder} holds this {kind.noun} already: --resume goes on with it")


def is_leftover(file: Path) -> bool:
    """Whether a file is what a writer that was killed left unfinished."""
    return file.name.endswith(".partial")


def read_configuration(folder: Path, kind: FolderKind) -> str:
    """The configuration of a folder. Raises ValueError where there is none, or a foreign one."""
    file = folder / kind.file
    if not folder.exists():
        raise ValueError(f"{folder} does not exist")
    if not file.is_file():
        raise ValueError(f"{folder} holds no {kind.noun}: there is no {kind.file}")
    try:
        text = file.read_text(encoding="utf-8")
        table = tomllib.loads(text)
    except ValueError as error:
        raise ValueError(f"{file} is no configuration of a {kind.noun}: {error}") from None
    lacking = [name for name in kind.keys if name not in table]
    if lacking:
        raise ValueError(f"{file} is no configuration of a {kind.noun}: it has no '{lacking[0]}'")
    return text


@contextmanager
def locked(folder: Path | None, doing: str) -> Iterator[None]:
    """Keep other processes out of a folder; the lock ends with this process, however it ends.

    Args:
        folder: is made where it does not exist, and is gone again where nothing was left in it;
            without one nothing is locked.
        doing: what a process that is refused is told, e.g. "sweeping".

    Raises:
        ValueError: where another process is at work.
    """
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        folder = None
    if folder is None:
        yield
        return
    absent = [place for place in (folder, *folder.parents) if not place.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    opened = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(f"another process is {doing} into {folder}") from None
        except OSError:
            pass  # no locks in this file system
        yield
    finally:
        os.close(opened)
        with suppress(OSError):  # something was left there
            for place in absent:
                place.rmdir()


def digest(text: str) -> str:
    """The name of a configuration: 16 digits of its SHA-256."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def differences(old: str, new: str) -> list[str]:
    """What differs between two configurations, ``name: old -> new`` each."""
    return list(_differing("", tomllib.loads(old), tomllib.loads(new)))


def _differing(name: str, before: Any, after: Any) -> Iterator[str]:
    """Numbers of nested tables by their dotted name; tables in lists by their own name."""
    one, other = _table(before), _table(after)
    if one is not None and other is not None:
        for inner in {**one, **other}:
            dotted = f"{name}.{inner}" if name else inner
            yield from _differing(dotted, one.get(inner), other.get(inner))
    elif before != after:
        yield f"{name}: {_told(before)} -> {_told(after)}"


def _table(value: Any) -> dict[str, Any] | None:
    """A table, or a list of tables by their names; None for anything else."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return {str(v.get("name", v.get("path", i))): v for i, v in enumerate(value)}
    return value if isinstance(value, dict) else None


def _told(value: Any) -> str:
    return "none" if value is None else "given" if _table(value) is not None else str(value)
