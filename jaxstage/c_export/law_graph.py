"""The three functions of a control law as scalar graphs, and the structs that they speak of."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxstage.c_export.structs import Member, members
from jaxstage.compiler.frontend.scalarize import cells, scalar_graph
from jaxstage.compiler.ir.node import Node, ordered
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import Quantity, map_leaves
from jaxstage.model.signals import Measurement, Setpoint

#: arguments of the law that are structs in C; ``demand`` and ``command`` are arrays
STRUCTS = ("gains", "memory", "setpoint", "measurement")


class Element(NamedTuple):
    """One number among the arguments of the law.

    Attributes:
        group: The argument: gains, memory, setpoint, ...
        leaf: Number of the array in it.
        at: Number of the element in C order.
    """

    group: str
    leaf: int
    at: int


class Function(NamedTuple):
    """A function of the law, element by element.

    Attributes:
        demand: What is demanded of each axis.
        memory: The memory after it.
        leaves: Group, and number in the group, of each leaf that the graph counts.
    """

    demand: tuple[Node, ...]
    memory: tuple[Node, ...]
    leaves: tuple[tuple[str, int], ...]

    def elements(self, node: Node) -> list[Element]:
        """What a node reads of the arguments: nothing, an input, or all that a look-up reaches."""
        if node.op not in ("in", "load"):
            return []
        (leaf, first), reach = node.value, range(1)
        if node.op == "load":
            reach = range(int(node.args[0].low), int(node.args[0].high) + 1)
        group, number = self.leaves[leaf]
        return [Element(group, number, first + k) for k in reach]


class LawGraph(NamedTuple):
    """A control law, scalar by scalar.

    Attributes:
        init: The memory before the first period.
        step: Demand and memory of a period.
        settle: The memory once the command is known; None where the law need not be told: then
            `step` holds what its own settle does.
        gains: Members of the struct of gains; the other three alike.
        axes: Number of axes.
    """

    init: Function
    step: Function
    settle: Function | None
    gains: tuple[Member, ...]
    memory: tuple[Member, ...]
    setpoint: tuple[Member, ...]
    measurement: tuple[Member, ...]
    axes: int

    @property
    def functions(self) -> tuple[Function, ...]:
        """Those that there are."""
        both = (self.init, self.step)
        return both if self.settle is None else (*both, self.settle)


def trace(
    controller: Controller,
    gains: Any,
    setpoint: Setpoint,
    measurement: Measurement,
    dt: float,
    command_unit: str,
    one_axis: bool = False,
) -> LawGraph:
    """The law at the types and shapes of its arguments.

    Args:
        controller: The law.
        gains: What is tuned.
        setpoint: A commanded sample, each leaf ``(axes,)``.
        measurement: A measured sample.
        dt: Control period in s.
        command_unit: Unit of a demand.
        one_axis: Whether it is of a single axis, whose leading 1 is left out of the structs.

    Raises:
        LoweringError: Something of it has no scalar form.
    """
    demand = jax.ShapeDtypeStruct(setpoint.position.shape, setpoint.position.dtype)
    begun = jax.eval_shape(controller.init, gains, setpoint, measurement)
    arguments = {"gains": gains, "memory": begun, "setpoint": setpoint, "measurement": measurement}
    afterwards = {"demand": demand, "command": demand}

    def init(gains: Any, setpoint: Setpoint, measurement: Measurement) -> Any:
        return (), controller.init(gains, setpoint, measurement)

    def step(gains: Any, memory: Any, setpoint: Setpoint, measurement: Measurement) -> Any:
        return controller.control(gains, memory, setpoint, measurement, dt)

    def settle(gains: Any, memory: Any, demand: Any, command: Any) -> Any:
        return (), controller.settle(gains, memory, demand, command, dt)

    def both(
        gains: Any, memory: Any, setpoint: Any, measurement: Any, demand: Any, command: Any
    ) -> Any:
        demanded, kept = step(gains, memory, setpoint, measurement)
        return demanded, settle(gains, kept, demand, command)[1]

    single = demand.dtype == np.float32
    whole = _function(both, arguments | afterwards, single)
    apart = any(element.group in afterwards for element in read(whole))
    return LawGraph(
        init=_function(
            init, {name: arguments[name] for name in arguments if name != "memory"}, single
        ),
        step=_function(step, arguments, single) if apart else whole,
        settle=_function(settle, {"gains": gains, "memory": begun, **afterwards}, single)
        if apart
        else None,
        axes=demand.shape[0],
        **{name: members(tree, command_unit, one_axis) for name, tree in arguments.items()},
    )


def _function(function: Callable[..., Any], inputs: dict[str, Any], single: bool) -> Function:
    """``function(*inputs) -> (demand, memory)`` as a graph."""
    traced = scalar_graph(function, *inputs.values(), single=single)
    leaves = tuple(
        (group, number)
        for group, tree in inputs.items()
        for number in range(len(jax.tree.leaves(tree)))
    )
    demand, memory = traced.outputs
    return Function(tuple(cells(demand)), tuple(cells(memory)), leaves)


def read(function: Function) -> set[Element]:
    """The inputs that a function reads."""
    nodes = ordered((*function.demand, *function.memory))
    return {element for node in nodes for element in function.elements(node)}


def elements(every: tuple[Member, ...]) -> Iterator[tuple[int, Member, int]]:
    """Number of the leaf, leaf and number of the element of every element, in order."""
    for leaf, member in enumerate(every):
        for index in range(member.size):
            yield leaf, member, index


def of_axis(tree: Any, axis: int, axes: int) -> Any:
    """Gains of one axis, with a leading 1, out of the gains of all."""

    def cut(quantity: Quantity, value: Any) -> Any:
        return value[axis : axis + 1] if _per_axis(quantity, value.shape, axes) else value

    return map_leaves(cut, tree)


def _per_axis(quantity: Quantity, shape: tuple[int, ...], axes: int) -> bool:
    """Whether the first index of a gain counts axes."""
    described = [d for d in quantity.shape.strip("()").split(",") if d.strip()]
    own = described[:1] == ["axes"] or len(shape) == len(described) + 1
    return own and shape[:1] == (axes,)


def coupled(law: LawGraph) -> str | None:
    """What of one axis depends on another axis, or None: then each axis is a law of its own."""
    owner: dict[Element, int | None] = {
        Element(group, leaf, index): _axis(member, group, law.axes, index)
        for group in STRUCTS
        for leaf, member, index in elements(getattr(law, group))
    }
    owner |= {Element(group, 0, i): i for group in ("demand", "command") for i in range(law.axes)}
    for function in law.functions:
        results = [(i, "the demand", node) for i, node in enumerate(function.demand)]
        results += [
            (owner[Element("memory", leaf, index)], f"memory.{member.name}", node)
            for (leaf, member, index), node in zip(
                elements(law.memory), function.memory, strict=True
            )
        ]
        for own, name, node in results:
            heard = {owner[e] for n in ordered([node]) for e in function.elements(n)}
            if heard - {own, None}:
                return name
    return None


def _axis(member: Member, group: str, axes: int, index: int) -> int | None:
    """The axis that an element belongs to, None for what all axes share."""
    if member.shape[:1] != (axes,):
        return None
    if group == "gains" and member.quantity is not None:
        if not _per_axis(member.quantity, member.shape, axes):
            return None
    return index * axes // member.size
