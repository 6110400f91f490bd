"""How often files are opened, whoever opens them."""

import os
import sys
from collections import Counter
from contextlib import contextmanager

_watching: list[Counter] = []


def _audit(event, arguments):
    if event == "open" and isinstance(arguments[0], str | os.PathLike):
        for opened in _watching:
            opened[os.fspath(arguments[0])] += 1


sys.addaudithook(_audit)


@contextmanager
def counted():
    """A counter that fills: file -> how often it was opened."""
    opened: Counter = Counter()
    _watching.append(opened)
    try:
        yield opened
    finally:
        _watching.remove(opened)
