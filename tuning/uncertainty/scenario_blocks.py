"""Loads, sensors and drives that a scenario file adds to a loop, neutral until they are set.

[blocks]
drive = "current_drive"
sensor = "encoder"
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.hardware.drives import CurrentDrive, current_drive, ideal_drive
from jaxstage.hardware.loads import CouplingLoad, SineLoad, coupling_load, no_load, sine_load
from jaxstage.hardware.sensors import Encoder, Noisy, encoder, ideal_sensor, noisy
from jaxstage.model.fields import replace
from jaxstage.model.settings import nearest_name
from jaxstage.studies import Case

#: control periods that a drive may delay
MOST_DELAY = 100_000


def _number(value: float) -> Array:
    return jnp.asarray(value, float)


def _drive(axes: int) -> tuple[Any, Any]:
    params = CurrentDrive(limit=jnp.full(axes, np.inf), delay=_number(0), lag=_number(0))
    return current_drive(), params


def _encoder(axes: int) -> tuple[Any, Any]:
    return encoder, Encoder(resolution=_number(0), bandwidth=_number(np.inf))


def _noisy_encoder(axes: int) -> tuple[Any, Any]:
    _, inner = _encoder(axes)
    return noisy(encoder), Noisy(noise=_number(0), sensor=inner)


def _sine(axes: int) -> tuple[Any, Any]:
    zero = jnp.zeros(axes)
    return sine_load, SineLoad(amplitude=zero, frequency=zero, phase=zero, bias=zero)


def _coupling(axes: int) -> tuple[Any, Any]:
    return coupling_load, CouplingLoad(coupling=jnp.zeros((axes, axes)))


#: part of the scenario -> name -> number of axes to (definition, neutral parameters)
BLOCKS: dict[str, dict[str, Callable[[int], tuple[Any, Any]]]] = {
    "drive": {"current_drive": _drive},
    "sensor": {"encoder": _encoder, "noisy_encoder": _noisy_encoder},
    "load": {"sine_load": _sine, "coupling_load": _coupling},
}
#: only these are replaced: a block of the system's own stays
_IDEAL = {"drive": ideal_drive, "sensor": ideal_sensor, "load": no_load}


def with_blocks(case: Case, blocks: Mapping[str, Any]) -> Case:
    """The case with blocks by name in the place of ideal ones.

    Args:
        case: A loop whose drive, sensor or load is ideal.
        blocks: Part of the scenario -> name, both of `BLOCKS`.

    Raises:
        ValueError: For an unknown part or name, and where the loop has a block of its own.
    """
    for part, name in blocks.items():
        if part not in BLOCKS:
            raise ValueError(f"'blocks.{part}': must be one of {', '.join(BLOCKS)}")
        if not isinstance(name, str) or name not in BLOCKS[part]:
            hint = nearest_name(str(name), BLOCKS[part])
            raise ValueError(
                f"blocks.{part} = {name}{hint}: must be one of {', '.join(BLOCKS[part])}"
            )
        own = getattr(case.loop, part)
        if own != _IDEAL[part]:
            raise ValueError(
                f"blocks.{part} = {name}: {case.name} has its own, whose values may be set and "
                f"spread: {own.name}"
            )
        definition, params = BLOCKS[part][name](len(case.loop.plant.axes))
        case = case._replace(
            loop=replace(case.loop, **{part: definition}),
            scenario=replace(case.scenario, **{part: params}),
        )
    return case


def with_max_delay(case: Case, periods: float) -> Case:
    """The case with a `current_drive` that can delay so many control periods; any other stays.

    Raises ValueError for more than `MOST_DELAY`: the drive keeps a command for each.
    """
    drive = case.loop.drive
    known = drive in (current_drive(), current_drive(drive.max_delay))
    if not known or not drive.max_delay < periods < math.inf:
        return case
    if periods > MOST_DELAY:
        raise ValueError(f"drive.delay = {periods:g} periods: must be <= {MOST_DELAY}")
    return case._replace(loop=replace(case.loop, drive=current_drive(math.ceil(periods))))
