"""Position feed-forward: the law follows r + A sgn r', ahead of the friction that holds it back.

    position_feedforward(law):  r is replaced by r + A sgn r';  r' and r'' stay

| symbol | field | unit | published value |
|---|---|---|---|
| A | amplitude | m | 2e-6 |

It helps where the error it meets has the size A and the direction of motion, and adds A elsewhere.
The error is reported against the plain r.
Source: Zhang et al., Sensors 2023, 23, 9755, section 5.3.
"""

import functools
from typing import Any

from jax import Array

from jaxstage.controllers.compose import Offset, offset_setpoint
from jaxstage.model.blocks import Controller, Memory
from jaxstage.model.fields import gain, pytree
from jaxstage.model.signals import Setpoint
from jaxstage.numerics.smooth import sign


@pytree
class PositionFeedforward:
    """Gain of the shift, ``offset`` of `Offset`."""

    amplitude: Array = gain("m", "A", "shift of the commanded position", low=0.0, shown="um")


def _shift(gains: PositionFeedforward, setpoint: Setpoint) -> Array:
    return gains.amplitude * sign(setpoint.velocity)


@functools.cache
def position_feedforward(law: Controller[Any, Memory]) -> Controller[Offset, Memory]:
    """Position feed-forward around a law of any number of axes.

    Args:
        law: the law.

    Returns:
        The law that follows r + A sgn r'; gains `Offset`: ``law`` those of the law, ``offset`` a
        `PositionFeedforward`.
    """
    return offset_setpoint(law, "position_feedforward", _shift)
