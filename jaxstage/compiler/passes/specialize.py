"""Specialisation of a graph under a predicate that holds in nearly every tick."""

from jaxstage.compiler.ir.graph import Graph
from jaxstage.compiler.ir.node import Node, ordered
from jaxstage.compiler.passes.store_forms import Store, conjuncts


def specialize(graph: Graph, stores: list[Store], condition: Node) -> list[Store] | None:
    """The stores where a condition holds: its conjuncts are constants, and less is left to compute.

    Returns:
        The stores; None where they hold inner loops, which stay as they are.
    """
    nodes = ordered(n for s in stores for n in s.needs)
    if any(n.op == "loop" for n in nodes):
        return None
    known = {part.id: graph.const(truth, "b") for part, truth in conjuncts(condition)}
    for node in nodes:
        if node.id not in known:
            args = tuple(known[a.id] for a in node.args)
            same = all(a is b for a, b in zip(args, node.args, strict=True))
            known[node.id] = node if same else graph.rebuilt(node, args)
    return [s._replace(node=known[s.node.id]) for s in stores]
