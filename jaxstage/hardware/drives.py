"""Drives: the stage between controller and plant, with limits, dead time and current-loop lag.

    u = clip(u_d, -u_max, u_max),   applied = lag(u delayed by d periods),   tau a' = u - a

u_d: demand of the law; u: command; a: what reaches the plant. Drives take the place of one another:
`ideal_drive`, `current_drive`, and `amplified` around one of them.
"""

import functools
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxstage.model.array_types import PerAxis
from jaxstage.model.blocks import Drive, Memory
from jaxstage.model.fields import param, part, pytree, signal
from jaxstage.numerics.smooth import clamp

#: dead time in periods; the commands on their way are memory of every run
LONGEST_DELAY = 10_000


@pytree
class CurrentDrive:
    """Parameters of `current_drive`."""

    limit: Array = param(
        "1", "u_max", "largest command, in its unit", shape="(axes,)", above=0.0, infinite=True
    )
    delay: Array = param("1", "d", "dead time in whole control periods", low=0.0)
    lag: Array = param("s", "tau", "time constant of the current loop", low=0.0)


@pytree
class CurrentMemory:
    """Commands under way, newest first, and the output of the lag."""

    queue: Array = signal("1", "u", "past commands", shape="(max_delay + 1, axes)")
    lagged: Array = signal("1", "a", "output of the lag at the end of the period", shape="(axes,)")


@functools.cache
def current_drive(max_delay: int = 0) -> Drive[CurrentDrive, CurrentMemory]:
    """command = clip(demand, +-u_max); applied = command delayed by ``delay`` periods, then lagged.

    The lag is tau a' = u - a; the plant gets its mean over the period, held: exact in impulse, for
    any tau against dt. tau = 0 is none. The delay is data; before the first command has arrived
    the plant sees 0. Parameters: `CurrentDrive`.

    Args:
        max_delay: largest dead time in periods, which sets the size of the memory.

    Raises:
        ValueError: ``max_delay`` is negative, or over `LONGEST_DELAY`.
    """
    if not 0 <= max_delay <= LONGEST_DELAY:
        raise ValueError(
            f"max_delay = {max_delay:g} periods: must be 0 .. {LONGEST_DELAY}; every run keeps so "
            f"many commands, here {8 * max_delay / 1e6:.3g} MB an axis"
        )

    def init(params: CurrentDrive, demand: PerAxis) -> CurrentMemory:
        zero = jnp.zeros_like(demand)
        return CurrentMemory(queue=jnp.stack([zero] * (max_delay + 1)), lagged=zero)

    def apply(
        params: CurrentDrive, memory: CurrentMemory, demand: PerAxis, dt: float
    ) -> tuple[PerAxis, PerAxis, CurrentMemory]:
        command = clamp(demand, params.limit)
        queue = jnp.concatenate([command[None], memory.queue[:-1]])
        arrived = queue[jnp.clip(params.delay, 0, max_delay).astype(jnp.int32)]
        tau = jnp.where(params.lag > 0, params.lag, jnp.ones_like(params.lag))
        zero = jnp.zeros_like(tau)
        left = jnp.where(params.lag > 0, jnp.exp(-dt / tau), zero)
        mean = jnp.where(params.lag > 0, -jnp.expm1(-dt / tau) * tau / dt, zero)
        behind = memory.lagged - arrived
        kept = CurrentMemory(queue=queue, lagged=arrived + left * behind)
        return command, arrived + mean * behind, kept

    return Drive(name="current_drive", init=init, apply=apply, max_delay=max_delay)


#: Applies the demand as it is; params ``()``.
ideal_drive: Drive[tuple[()], tuple[()]] = Drive(
    name="ideal_drive",
    init=lambda params, demand: (),
    apply=lambda params, memory, demand, dt: (demand, demand, ()),
)


@pytree
class Amplified:
    """Parameters of `amplified`."""

    factor: Array = param("1", "k_u", "what reaches the plant over what was commanded")
    drive: Any = part("parameters of the drive")


@functools.cache
def amplified(drive: Drive[Any, Memory]) -> Drive[Amplified, Memory]:
    """A drive whose output is ``factor`` times what it should be, unknown to the law.

    A loop that stays stable at factors 1/g .. g has a gain margin of g. Parameters: `Amplified`.
    """

    def init(params: Amplified, demand: PerAxis) -> Memory:
        return drive.init(params.drive, demand)

    def apply(
        params: Amplified, memory: Memory, demand: PerAxis, dt: float
    ) -> tuple[PerAxis, PerAxis, Memory]:
        command, applied, after = drive.apply(params.drive, memory, demand, dt)
        return command, params.factor * applied, after

    return Drive(name=f"amplified[{drive.name}]", init=init, apply=apply, max_delay=drive.max_delay)
