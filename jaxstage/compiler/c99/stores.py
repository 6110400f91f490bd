"""What a function of a law writes where: single places, elements that an index selects, loops."""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

from jaxstage.compiler.c99.patterns import LOOPED, Pattern, pattern
from jaxstage.compiler.ir.graph import Node

#: an indexed store: leaf, number of the element less the index, index and value by their numbers
Group = tuple[int, int, int, int]


class Places(NamedTuple):
    """The C text of inputs. element(leaf, index): one number; array(leaf): what can be indexed."""

    element: Callable[[int, int], str]
    array: Callable[[int], str]


class Result(NamedTuple):
    """A node and its place: the element ``number`` of an array, or a scalar where that is None.

    old: leaf and number of the input that stands there, or None."""

    array: str
    number: int | None
    node: Node
    old: tuple[int, int] | None = None

    @property
    def place(self) -> str:
        """The left side of an assignment."""
        return self.array if self.number is None else f"{self.array}[{self.number}]"


class Store(NamedTuple):
    """place: left side; touches: all that may be overwritten. With an index, the place is an array,
    of which ``offset + index`` is meant. With a form, so many elements of an array from ``offset``
    on."""

    place: str
    node: Node
    touches: frozenset[str]
    offset: int = 0
    index: Node | None = None
    form: Pattern | None = None

    @property
    def needs(self) -> list[Node]:
        """What has to be known before it."""
        if self.form is not None:
            return self.form.needs
        return [self.node] if self.index is None else [self.node, self.index]


def stores_of(results: Sequence[Result], places: Places, uses: Counter[int]) -> list[Store]:
    """What has to be written, elements of an indexed store and of a loop together."""
    groups: dict[Group, list[int]] = {}
    for result in results:
        key = _selected(result)
        if key is not None:
            groups.setdefault(key[0], []).append(key[1])
    written = {result.place for result in results}
    stores, done = [], set()
    for run in _runs(results):
        indexed = any(_is_indexed(result, groups) for result in run)
        form = None if indexed else _form(run, places, uses, written)
        if form is not None:
            first, touches = run[0], frozenset(result.place for result in run)
            offset = first.number or 0
            stores.append(Store(first.array, first.node, touches, offset, form=form))
            continue
        for result in run:
            node, key = result.node, _selected(result)
            if key is None or not _is_indexed(result, groups):
                stores.append(Store(result.place, node, frozenset({result.place})))
            elif key[0] not in done:
                done.add(key[0])
                leaf, offset = key[0][:2]
                index, value = node.args[0].args[0], node.args[1]
                touches = frozenset(places.element(leaf, offset + k) for k in groups[key[0]])
                stores.append(Store(places.array(leaf), value, touches, offset, index))
    return stores


def _runs(results: Sequence[Result]) -> list[list[Result]]:
    """The results, elements in a row of one array together."""
    runs: list[list[Result]] = []
    for result in results:
        last = runs[-1][-1] if runs else None
        if (
            last is not None and last.array == result.array
            and last.number is not None and result.number == last.number + 1
        ):  # fmt: skip
            runs[-1].append(result)
        else:
            runs.append([result])
    return runs


def _form(
    run: list[Result], places: Places, uses: Counter[int], written: set[str]
) -> Pattern | None:
    """The form of a run that becomes a loop, or None. A loop may read what is written nowhere, and
    of its own array the element that it writes."""
    if len(run) < LOOPED:
        return None
    form = pattern([result.node for result in run], uses)
    if form is None:
        return None
    for leaf, first in form.rows:
        read = {places.element(leaf, first + k) for k in range(form.count)}
        if read & written and (leaf, first) != run[0].old:
            return None
    return form


def _selected(result: Result) -> tuple[Group, int] | None:
    """For an element that is ``index == k ? value : old``: (leaf, number - k, index, value), k."""
    node = result.node
    if result.old is None or node.op != "select":
        return None
    test, value, old = node.args
    if old.op != "in" or old.value != result.old or test.op != "eq":
        return None
    index, k = test.args
    if k.op != "const" or index.kind not in "iul":
        return None
    leaf, number = result.old
    return (leaf, number - k.value, index.id, value.id), k.value


def reach(index: Node) -> range:
    """All that an index can be."""
    return range(int(index.low), int(index.high) + 1)


def _is_indexed(result: Result, groups: dict[Group, list[int]]) -> bool:
    """Whether an element belongs to an indexed store: all that the index can be are there."""
    key = _selected(result)
    if key is None:
        return False
    every = reach(result.node.args[0].args[0])
    return len(every) <= len(groups[key[0]]) and set(groups[key[0]]) >= set(every)
