"""Composition of control laws: functions from laws to laws.

Equal compositions are the identical definition.

A law is written for one axis, with scalars; `per_axis` makes it drive several. Every composition
forwards `settle` with the TOTAL demand and command: an observer that heard only its own law's
command would take the coupling for a disturbance and cancel it.
"""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.model.blocks import Controller, Gains, Memory
from jaxstage.model.fields import Quantity, known, map_leaves, part, pytree, replace
from jaxstage.model.signals import Measurement, Setpoint

#: gains with a ``law`` and an ``extra`` part
Pair = TypeVar("Pair", "Both", "Coupled")

#: which parts of a Setpoint belong to one axis
_PER_AXIS = Setpoint(position=0, velocity=0, acceleration=0, tangent=0, curvature=None)  # type: ignore[arg-type]


@functools.cache
def per_axis(law: Controller[Gains, Memory]) -> Controller[Gains, Memory]:
    """Decentralised control: the same law on every axis, each with its own gains.

    Args:
        law: a law of one axis.

    Returns:
        The law of several axes. Leaves of its gains are (axes, ...); a leaf in its shape for one
        axis holds for all of them.
    """
    init = jax.vmap(law.init, in_axes=(0, _PER_AXIS, 0))
    control = jax.vmap(law.control, in_axes=(0, 0, _PER_AXIS, 0, None))
    settle = jax.vmap(law.settle, in_axes=(0, 0, 0, 0, None))

    def init_all(gains: Gains, setpoint: Setpoint, measurement: Measurement) -> Memory:
        return init(_on_axes(gains, setpoint.position.shape[0]), setpoint, measurement)

    def control_all(
        gains: Gains, memory: Memory, setpoint: Setpoint, measurement: Measurement, dt: float
    ) -> tuple[Array, Memory]:
        spread = _on_axes(gains, setpoint.position.shape[0])
        return control(spread, memory, setpoint, measurement, dt)

    def settle_all(
        gains: Gains, memory: Memory, demand: Array, command: Array, dt: float
    ) -> Memory:
        return settle(_on_axes(gains, demand.shape[0]), memory, demand, command, dt)

    return replace(law, init=init_all, control=control_all, settle=settle_all)


def _on_axes(gains: Gains, axes: int) -> Gains:
    """Gains with a leading (axes,) on every leaf that has the shape of one axis."""

    def spread(quantity: Quantity, value: Array) -> Array:
        rank = len(quantity.sizes)
        return jnp.broadcast_to(value, (axes, *value.shape)) if value.ndim == rank else value

    return map_leaves(spread, gains)


@pytree
class Both:
    """Gains or memory of a sum of two laws."""

    law: Any = part("the law")
    extra: Any = part("what is added to it")


@functools.cache
def plus(law: Controller, extra: Controller) -> Controller[Both, Both]:
    """Sum of two laws, u = u_law + u_extra: feed-forward, or an observer, around any law.

    An observer is a law whose demand is what cancels its estimate, in command units, and whose
    ``settle`` hears the total command. Each law hears the whole cut (command - demand), so two
    integrators with anti-windup leave a limit faster than one.

    Args:
        law: the law.
        extra: what is added to it, for as many axes.

    Returns:
        The sum; gains and memory `Both`.
    """
    return _summed(f"{law.name} + {extra.name}", law, extra, lambda gains: 1.0)


@pytree
class Coupled:
    """Gains of a cross-coupled law."""

    law: Any = part("the law of the axes")
    extra: Any = part("the contour law")
    command_per_acceleration: Array = known(
        "command s2/m", "1/a_n", "command that gives 1 m/s2", shape="(axes,)", above=0.0
    )


@functools.cache
def cross_coupled(axis: Controller, contour: Controller) -> Controller[Coupled, Both]:
    """Cross-coupled control, u = u_axis + U / a_n.

    The nominal command per acceleration lets any law be wrapped, and makes unequal axes answer in
    the direction of U. The contour law's ``settle`` hears the totals in its own unit, m/s2.

    Args:
        axis: the law of all axes, its demand in command units.
        contour: the contour law; it demands an acceleration U, (axes,) m/s2.

    Returns:
        The sum; gains `Coupled`, memory `Both`.
    """
    return _summed(
        f"cross_coupled[{axis.name}, {contour.name}]",
        axis,
        contour,
        lambda gains: gains.command_per_acceleration,
    )


def _summed(
    name: str, law: Controller, extra: Controller, unit: Callable[[Pair], Array | float]
) -> Controller[Pair, Both]:
    """The sum of two laws; ``unit(gains)``: command units in one unit of the extra law."""

    def init(gains: Pair, setpoint: Setpoint, measurement: Measurement) -> Both:
        return Both(
            law=law.init(gains.law, setpoint, measurement),
            extra=extra.init(gains.extra, setpoint, measurement),
        )

    def control(
        gains: Pair, memory: Both, setpoint: Setpoint, measurement: Measurement, dt: float
    ) -> tuple[Array, Both]:
        first, kept = law.control(gains.law, memory.law, setpoint, measurement, dt)
        second, added = extra.control(gains.extra, memory.extra, setpoint, measurement, dt)
        return first + unit(gains) * second, Both(law=kept, extra=added)

    def settle(gains: Pair, memory: Both, demand: Array, command: Array, dt: float) -> Both:
        return Both(
            law=law.settle(gains.law, memory.law, demand, command, dt),
            extra=extra.settle(
                gains.extra, memory.extra, demand / unit(gains), command / unit(gains), dt
            ),
        )

    def longest_period(gains: Pair) -> Array:
        both = law.longest_period(gains.law), extra.longest_period(gains.extra)
        return jnp.minimum(*(jnp.min(jnp.asarray(period)) for period in both))

    return Controller(
        name=name, init=init, control=control, settle=settle, longest_period=longest_period
    )


@pytree
class Offset:
    """Gains of a law that follows a shifted setpoint."""

    law: Any = part("the law")
    offset: Any = part("gains of the shift")


@functools.cache
def offset_setpoint(
    law: Controller[Any, Memory], name: str, shift: Callable[[Any, Setpoint], Array]
) -> Controller[Offset, Memory]:
    """Setpoint offset: the law follows r + shift; metrics keep the original r.

    Velocity and acceleration of the setpoint stay.

    Args:
        law: the law.
        name: what the shift is called.
        shift: (``gains.offset``, setpoint) -> (axes,) m.

    Returns:
        The law of the shifted setpoint; gains `Offset`, memory that of the law.
    """

    def moved(gains: Offset, setpoint: Setpoint) -> Setpoint:
        return replace(setpoint, position=setpoint.position + shift(gains.offset, setpoint))

    def init(gains: Offset, setpoint: Setpoint, measurement: Measurement) -> Memory:
        return law.init(gains.law, moved(gains, setpoint), measurement)

    def control(
        gains: Offset, memory: Memory, setpoint: Setpoint, measurement: Measurement, dt: float
    ) -> tuple[Array, Memory]:
        return law.control(gains.law, memory, moved(gains, setpoint), measurement, dt)

    def settle(gains: Offset, memory: Memory, demand: Array, command: Array, dt: float) -> Memory:
        return law.settle(gains.law, memory, demand, command, dt)

    return Controller(
        name=f"{law.name} on {name}",
        init=init,
        control=control,
        settle=settle,
        longest_period=lambda gains: law.longest_period(gains.law),
    )
