"""Control effort: what the controller asks of the drive, and how much of it is cut."""

import functools

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments, moments_of
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import part, pytree, signal
from jaxstage.model.signals import Sample, Setpoint
from jaxstage.numerics.filters import low_pass_weight


@pytree
class Effort:
    """Command of each axis, in the command unit of the plant."""

    command_rms: Array = signal("command", "", "RMS", shape="(axes,)")
    command_max: Array = signal("command", "", "largest magnitude", shape="(axes,)")
    command_variance: Array = signal("command2", "", "population variance", shape="(axes,)")
    command_variation: Array = signal(
        "command/s", "", "total variation per second", shape="(axes,)"
    )
    chattering: Array = signal("command", "", "RMS of the high-passed command", shape="(axes,)")


@pytree
class EffortSums:
    """Moments of the command, its variation, and the high-pass."""

    command: Moments = part("moments of the command")
    high: Moments = part("moments of the high-passed command")
    last: Array = signal("command", "", "command before", shape="(axes,)")
    slow: Array = signal("command", "", "output of the low-pass", shape="(axes,)")
    variation: Array = signal(
        "command", "", "sum of the magnitudes of the changes", shape="(axes,)"
    )
    time: Array = signal("s", "", "time between first and last command")


@functools.cache
def effort(cutoff: float = 100.0) -> Metric[EffortSums, Effort]:
    """Variance, total variation and chattering of the command.

    Chattering is the RMS of u - LP(u), a first-order high-pass at ``cutoff`` Hz that starts
    settled; a smooth command leaves next to nothing there. It is NaN where the cutoff is not below
    half the sampling rate.
    """

    def init(setpoint: Setpoint) -> EffortSums:
        zero = jnp.zeros_like(setpoint.position)
        none = moments.empty(zero)
        time = jnp.zeros((), zero.dtype)
        return EffortSums(command=none, high=none, last=zero, slow=zero, variation=zero, time=time)

    def update(acc: EffortSums, sample: Sample, dt: float) -> tuple[EffortSums, None]:
        u = sample.command
        first = acc.command.count == 0
        weight = low_pass_weight(jnp.asarray(cutoff, u.dtype), dt)
        slow = jnp.where(first, u, acc.slow + weight * (u - acc.slow))
        change = jnp.where(first, jnp.zeros_like(u), jnp.abs(u - acc.last))
        return EffortSums(
            command=moments.add(acc.command, u),
            high=moments.add(acc.high, u - slow) if cutoff < 0.5 / dt else acc.high,
            last=u,
            slow=slow,
            variation=acc.variation + change,
            time=acc.time + jnp.where(first, 0.0, dt).astype(u.dtype),
        ), None

    def finish(acc: EffortSums) -> Effort:
        return Effort(
            command_rms=moments.rms(acc.command),
            command_max=moments.largest(acc.command),
            command_variance=moments.variance(acc.command),
            command_variation=jnp.where(acc.time > 0, acc.variation / acc.time, jnp.nan),
            chattering=moments.rms(acc.high),
        )

    return Metric(name="effort", init=init, update=update, finish=finish)


@pytree
class Saturation:
    """How often the drive could not give what was asked."""

    saturated_share: Array = signal("1", "", "share of periods at a limit", shape="(axes,)")


def _cut(sample: Sample, dt: float) -> tuple[Array]:
    return ((sample.command != sample.demand).astype(sample.command.dtype),)


#: Share of control periods whose demand was cut; report `Saturation`.
saturation = moments_of(
    "saturation", _cut, lambda cut: Saturation(saturated_share=moments.mean(cut))
)


@pytree
class CommandChange:
    """Change of the command of each axis from period to period."""

    command_change_rms: Array = signal("command", "", "RMS", shape="(axes,)")


@pytree
class ChangeSums:
    """Moments of the change, and the command before."""

    change: Moments = part("moments of the change")
    last: Array = signal("command", "", "command before", shape="(axes,)")
    begun: Array = signal("1", "", "1 once there is a command before")


def _change_init(setpoint: Setpoint) -> ChangeSums:
    zero = jnp.zeros_like(setpoint.position)
    return ChangeSums(change=moments.empty(zero), last=zero, begun=jnp.zeros((), zero.dtype))


def _change_update(acc: ChangeSums, sample: Sample, dt: float) -> tuple[ChangeSums, None]:
    # the first command is no change
    added = moments.add(acc.change, sample.command - acc.last)
    change = jax.tree.map(functools.partial(jnp.where, acc.begun > 0), added, acc.change)
    return ChangeSums(change=change, last=sample.command, begun=jnp.ones_like(acc.begun)), None


#: RMS change of the command; report `CommandChange`.
command_change = Metric(
    name="command_change",
    init=_change_init,
    update=_change_update,
    finish=lambda acc: CommandChange(command_change_rms=moments.rms(acc.change)),
)
