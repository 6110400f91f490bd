"""What the controller asks of the drive."""

import functools

import jax.numpy as jnp
from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments
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
def effort(cutoff: float = 100.0) -> Metric:
    """Variance, total variation and chattering of the command.

    Chattering is the RMS of u - LP(u), a first-order high-pass at ``cutoff`` Hz that starts
    settled; a smooth command leaves next to nothing there. It is NaN where the cutoff is not below
    half the sampling rate.
    """

    def init(setpoint: Setpoint) -> EffortSums:
        zero = jnp.zeros_like(setpoint.position)
        none = moments.empty(zero)
        return EffortSums(
            command=none, high=none, last=zero, slow=zero, variation=zero,
            time=jnp.zeros((), zero.dtype),
        )  # fmt: skip

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
            command_rms=moments.root(moments.mean_square(acc.command)),
            command_max=moments.largest(acc.command),
            command_variance=moments.variance(acc.command),
            command_variation=jnp.where(acc.time > 0, acc.variation / acc.time, jnp.nan),
            chattering=moments.root(moments.mean_square(acc.high)),
        )

    return Metric(name="effort", init=init, update=update, finish=finish)


@pytree
class Saturation:
    """How often the drive could not give what was asked."""

    saturated_share: Array = signal("1", "", "share of periods at a limit", shape="(axes,)")


def _saturation_init(setpoint: Setpoint) -> Moments:
    return moments.empty(setpoint.position)


def _saturation_update(acc: Moments, sample: Sample, dt: float) -> tuple[Moments, None]:
    cut = (sample.command != sample.demand).astype(sample.command.dtype)
    return moments.add(acc, cut), None


#: Share of control periods whose demand was cut; report `Saturation`.
saturation = Metric(
    name="saturation",
    init=_saturation_init,
    update=_saturation_update,
    finish=lambda acc: Saturation(saturated_share=moments.mean(acc)),
)
