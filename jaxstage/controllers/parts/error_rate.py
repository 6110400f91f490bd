"""Rate of the following error, from the measured velocity or from the error itself.

    `measured`      e' = r' - y'
    `differenced`   e'_k = (e_k - e_{k-1}) / dt, the first sample as `measured`

The two differ where r' is not the mean velocity of the reference over the period before.
"""

from collections.abc import Callable
from typing import Generic

import jax.numpy as jnp
from jax import Array

from jaxstage.controllers.parts.surface import errors
from jaxstage.model.blocks import Memory
from jaxstage.model.fields import definition, pytree, signal
from jaxstage.model.signals import Measurement, Setpoint


@definition
class ErrorRate(Generic[Memory]):
    """A way to the rate of the following error.

    Attributes:
        name: what it is called.
        init: (error m) -> memory.
        of: (memory, setpoint, measurement, dt s) -> e' in m/s and the memory.
    """

    name: str
    init: Callable[[Array], Memory]
    of: Callable[[Memory, Setpoint, Measurement, float], tuple[Array, Memory]]


@pytree
class LastError:
    """Memory of `differenced`."""

    error: Array = signal("m", "e", "following error one period ago")
    fresh: Array = signal("1", "", "1 until the first sample was seen")


def _measured(
    memory: tuple[()], setpoint: Setpoint, measurement: Measurement, dt: float
) -> tuple[Array, tuple[()]]:
    return errors(setpoint, measurement)[1], ()


def _differenced(
    memory: LastError, setpoint: Setpoint, measurement: Measurement, dt: float
) -> tuple[Array, LastError]:
    error, rate = errors(setpoint, measurement)
    rate = jnp.where(memory.fresh > 0, rate, (error - memory.error) / dt)
    return rate, LastError(error=error, fresh=jnp.zeros_like(memory.fresh))


#: e' = r' - y'.
measured = ErrorRate(name="measured", init=lambda error: (), of=_measured)

#: e' from the last two errors.
differenced = ErrorRate(
    name="differenced",
    init=lambda error: LastError(error=error, fresh=jnp.ones_like(error)),
    of=_differenced,
)
