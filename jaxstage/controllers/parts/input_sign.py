"""Sign of the input gain, q = sgn d(theta)/du: which way the input is taken to move the axis.

| form | q | remark |
|---|---|---|
| `forward` | 1 | a positive command pushes the axis forward |
| `position_input` | sgn(y u) | as printed; for a position y >= 0 it is sgn u, which fails |
| `moving` | sgn y' | |
| `difference` | sgn((y_k - y_k-1)(u_k - u_k-1)) | the discrete form of the derivative |

y, y': measured position and velocity; u: the command of the same sample, within the limits of the
drive. Before the first sample y stands still and u is 0.
Source: Zhang et al., Sensors 2023, 23, 9755, text before equation (15); the others are readings.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

from jaxstage.model.fields import definition, pytree, signal
from jaxstage.model.signals import Measurement
from jaxstage.numerics.smooth import sign


@pytree
class Exchange:
    """Input and output of an axis, in this sample and the one before."""

    position: Array = signal("m", "y", "measured position")
    velocity: Array = signal("m/s", "y'", "measured velocity")
    command: Array = signal("command", "u", "command")
    last_position: Array = signal("m", "y_k-1", "measured position before")
    last_command: Array = signal("command", "u_k-1", "command before")

    def seen_next(self, measurement: Measurement) -> "Exchange":
        """The exchange one sample on; its command is still that of this sample."""
        return Exchange(
            position=measurement.position,
            velocity=measurement.velocity,
            command=self.command,
            last_position=self.position,
            last_command=self.command,
        )


@definition
class InputSign:
    """A reading of q.

    Attributes:
        name: what it is called.
        of: q in {-1, 0, 1} of an `Exchange`, in the shape of its position.
    """

    name: str
    of: Callable[[Exchange], Array]


def _position_input(seen: Exchange) -> Array:
    return sign(seen.position * seen.command)


def _difference(seen: Exchange) -> Array:
    moved = seen.position - seen.last_position
    return sign(moved * (seen.command - seen.last_command))


forward = InputSign(name="forward", of=lambda seen: jnp.ones_like(seen.position))
position_input = InputSign(name="position_input", of=_position_input)
moving = InputSign(name="moving", of=lambda seen: sign(seen.velocity))
difference = InputSign(name="difference", of=_difference)
