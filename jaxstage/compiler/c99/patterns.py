"""Nodes of one form, such as the updates of all cells of a table: what a loop is made of."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

from jaxstage.compiler.ir.graph import Node

#: as many nodes of one form become a loop
LOOPED = 8

#: in place of a leaf: the number of an array that holds what has no common form
OTHERS = "others"


class Pattern(NamedTuple):
    """Nodes of one form.

    form: a node in terms of the counter: its inputs are (leaf, first element) for inputs in a row
    and (`OTHERS`, k) for ``others[k]``, which have no common form. same: nodes that are in all of
    them. rows: leaf and first element of the inputs in a row.
    """

    form: Node
    count: int
    same: tuple[Node, ...]
    others: tuple[tuple[Node, ...], ...]
    rows: tuple[tuple[Any, int], ...]

    @property
    def needs(self) -> list[Node]:
        """What has to be known before the loop."""
        return [*self.same, *(node for nodes in self.others for node in nodes)]


def pattern(nodes: Sequence[Node], uses: Counter[int]) -> Pattern | None:
    """The form that all nodes have in common, or None. uses: of every node of the graph.

    What is used elsewhere too is no part of the form.
    """
    found: dict[tuple[int, ...], Node] = {}
    same: list[Node] = []
    others: list[tuple[Node, ...]] = []
    rows: list[tuple[Any, int]] = []

    def leaf(together: tuple[Node, ...], value: Any) -> Node:
        first = together[0]
        return _joined(together, "in", (), value, -len(found) - 1, first.kind)

    def form(together: tuple[Node, ...]) -> Node:
        key = tuple(node.id for node in together)
        if key not in found:
            found[key] = common(together)
        return found[key]

    def common(together: tuple[Node, ...]) -> Node:
        first = together[0]
        if all(node is first for node in together):
            same.append(first)
            return first
        if _in_a_row(together):
            rows.append(first.value)
            return leaf(together, first.value)
        if _of_one_operation(together) and all(uses[node.id] == 1 for node in together):
            args = tuple(
                form(tuple(part)) for part in zip(*(n.args for n in together), strict=True)
            )
            return _joined(together, first.op, args, None, -len(found) - 1, first.kind)
        others.append(together)
        return leaf(together, (OTHERS, len(others) - 1))

    whole = form(tuple(nodes))
    operations = sum(node.id < 0 and bool(node.args) for node in found.values())
    mixed = any(len({node.kind for node in together}) > 1 for together in others)
    if mixed or (others and operations <= len(others)):
        return None  # nothing gained
    return Pattern(whole, len(nodes), tuple(same), tuple(others), tuple(rows))


def _joined(
    together: tuple[Node, ...], op: str, args: tuple[Node, ...], value: Any, number: int, kind: str
) -> Node:
    """A node that stands for any of them."""
    return Node(
        op=op, kind=kind, args=args, value=value, low=min(n.low for n in together),
        high=max(n.high for n in together), nan=any(n.nan for n in together), id=number,
    )  # fmt: skip


def _in_a_row(together: tuple[Node, ...]) -> bool:
    first = together[0]
    return first.op == "in" and all(
        node.op == "in" and node.value == (first.value[0], first.value[1] + k)
        for k, node in enumerate(together)
    )


def _of_one_operation(together: tuple[Node, ...]) -> bool:
    first = together[0]
    return first.op not in ("in", "const", "load") and all(
        (n.op, n.kind, len(n.args)) == (first.op, first.kind, len(first.args)) for n in together
    )


def sums(nodes: Sequence[Node], uses: Counter[int]) -> dict[int, Pattern]:
    """The sums of many terms of one form, by the number of their node.

    nodes: all of the graph, arguments before users.
    """
    inner = {
        arg.id for n in nodes if _adds(n) for arg in n.args if _adds(arg) and uses[arg.id] == 1
    }
    found = {}
    for node in nodes:
        if _adds(node) and node.id not in inner:
            terms = _terms(node, uses)
            form = pattern(terms, uses) if len(terms) >= LOOPED else None
            if form is not None:
                found[node.id] = form
    return found


def _adds(node: Node) -> bool:
    return node.op == "add" and node.kind == "f"


def _terms(node: Node, uses: Counter[int]) -> list[Node]:
    terms: list[Node] = []
    todo = list(node.args[::-1])
    while todo:
        term = todo.pop()
        if _adds(term) and uses[term.id] == 1:
            todo += term.args[::-1]
        else:
            terms.append(term)
    return terms
