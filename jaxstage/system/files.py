"""Files that are there whole or not at all."""

import glob
import os
import select
import stat
import time
import uuid
from contextlib import suppress
from pathlib import Path

#: s after which nobody writes an unfinished file any more
ABANDONED = 3600.0
#: most bytes of a file of a user, and s that nobody may write to a pipe
LARGEST, PATIENCE = 10_000_000, 30.0


def write_whole(file: Path, data: bytes) -> None:
    """Write a file atomically: whole or not at all, also when the power fails.

    Several writers may write one file at a time: the last one's stays. What a writer that was
    killed left beside the file is removed by a later one.

    Args:
        file: Where; its folder exists.
        data: What it is to hold.

    Raises:
        OSError: Names the file; what stood there before is then as it was.
    """
    partial = file.with_name(f".{file.name}.{uuid.uuid4().hex[:12]}.partial")
    try:
        try:
            with partial.open("xb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(partial, file)
        finally:
            partial.unlink(missing_ok=True)
        keep_name(file.parent)
        _remove_leftovers(file)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(file)) from None


def _remove_leftovers(file: Path) -> None:
    """Remove the unfinished files of writers that are no more."""
    for partial in file.parent.glob(f".{glob.escape(file.name)}.*.partial"):
        with suppress(OSError):
            if time.time() - partial.stat().st_mtime > ABANDONED:
                partial.unlink()


def read_input(file: Path) -> str:
    """Text of a file or pipe of a user, read once.

    Raises:
        ValueError: not UTF-8 (a byte order mark may begin it), larger than `LARGEST`, or a pipe to
            which nobody writes for `PATIENCE`.
        OSError: it cannot be read.
    """
    opened = os.open(file, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    with open(opened, "rb") as stream:
        if stat.S_ISFIFO(os.fstat(opened).st_mode):
            if not select.select([stream], [], [], PATIENCE)[0]:
                raise ValueError(f"{file}: a pipe to which nobody has written for {PATIENCE:g} s")
            os.set_blocking(opened, True)
        data = stream.read(LARGEST + 1)
    if len(data) > LARGEST:
        raise ValueError(f"{file}: larger than {LARGEST / 1e6:g} MB")
    try:
        if b"\0" in data:  # UTF-16 of plain letters
            raise UnicodeError
        return data.decode("utf-8-sig")
    except UnicodeError:
        raise ValueError(f"{file}: save it as UTF-8") from None


def write_text(file: Path, text: str) -> None:
    """`write_whole` of text."""
    write_whole(file, text.encode())


def goes_on(error: OSError, how: str) -> OSError:
    """The same error, with how the work that it stopped is gone on with."""
    return OSError(error.errno, f"{error.strerror or error}; {how}", error.filename)


def keep_name(folder: Path) -> None:
    """Put the names in a folder on the disk, too."""
    if os.name == "posix":
        opened = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(opened)
        finally:
            os.close(opened)


def private_folder(folder: Path) -> Path:
    """Make a folder that only its owner may enter, and those above it, where they are missing."""
    with suppress(FileExistsError):  # a file: the next line says that it is no folder
        folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=0o700, exist_ok=True)
    return folder


def distrust(place: Path) -> str | None:
    """Why code in a file or folder must not be run, or None: others could have written it."""
    if not hasattr(os, "geteuid"):
        return None
    status = place.stat()
    if status.st_uid != os.geteuid():
        return f"it belongs to user {status.st_uid}"
    others = stat.S_IWOTH if status.st_gid == os.getegid() else stat.S_IWOTH | stat.S_IWGRP
    if status.st_mode & others:
        return f"others may write it (mode {stat.S_IMODE(status.st_mode):o})"
    return None
