"""The following error between the samples, where a controller does not look."""

import jax.numpy as jnp
from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments
from jaxstage.metrics.tracking import following_error
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import pytree, signal
from jaxstage.model.signals import Sample


@pytree
class Between:
    """Largest following error of each axis at the samples and at the substeps."""

    following_max_between: Array = signal(
        "m", "", "largest magnitude, between the samples too", shape="(axes,)", shown="um"
    )


def error_between(sample: Sample, dt: float) -> Array:
    """r + r' tau + r'' tau^2 / 2 - x at the end of each substep, (substeps, axes) m."""
    wanted, tool = sample.setpoint, sample.between.position
    count = tool.shape[0]
    tau = (dt / count * jnp.arange(1, count + 1, dtype=tool.dtype))[:, None]
    carried = wanted.velocity[None] * tau + wanted.acceleration[None] * tau**2 / 2
    return wanted.position[None] + carried - tool


def _update(acc: Moments, sample: Sample, dt: float) -> tuple[Moments, None]:
    inside = jnp.max(jnp.abs(error_between(sample, dt)), axis=0)
    return moments.add(acc, jnp.maximum(jnp.abs(following_error(sample)), inside)), None


#: Largest following error, between the samples too; report `Between`.
between = Metric(
    name="between",
    init=lambda setpoint: moments.empty(setpoint.position),
    update=_update,
    finish=lambda acc: Between(following_max_between=moments.largest(acc)),
)
