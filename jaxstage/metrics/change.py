"""How much the command changes from one control period to the next."""

from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import part, pytree, signal
from jaxstage.model.signals import Sample, Setpoint


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


def _init(setpoint: Setpoint) -> ChangeSums:
    zero = jnp.zeros_like(setpoint.position)
    return ChangeSums(
        change=moments.empty(zero), last=zero, begun=jnp.zeros((), setpoint.position.dtype)
    )


def _update(acc: ChangeSums, sample: Sample, dt: float) -> tuple[ChangeSums, None]:
    # the first command is no change
    added = moments.add(acc.change, sample.command - acc.last)
    change = jax.tree.map(partial(jnp.where, acc.begun > 0), added, acc.change)
    return ChangeSums(change=change, last=sample.command, begun=jnp.ones_like(acc.begun)), None


#: RMS change of the command; report `CommandChange`.
command_change = Metric(
    name="command_change",
    init=_init,
    update=_update,
    finish=lambda acc: CommandChange(
        command_change_rms=moments.root(moments.mean_square(acc.change))
    ),
)
