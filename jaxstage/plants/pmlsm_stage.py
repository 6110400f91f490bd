"""Stage on permanent-magnet linear synchronous motors (PMLSM), without friction or play.

    M p'' = K_f i_q - B p' - F_d

u = i_q: thrust current in A, held over the step (ideal current loop). F_d: external force, asked
for inside the classical Runge-Kutta step. The motor and the tool are one body.

| symbol | field | unit |
|---|---|---|
| M | mass | kg |
| B | damping | N s/m |
| K_f | force_constant | N/A |
| R | resistance | ohm |

Source: Science Progress 2021, doi:10.1177/00368504211011847, "mechanical motion equation"; the
equation itself is lost in the text at hand and is the standard one of the motor. The phase
resistance is a choice: the paper says nothing of energy.
"""

import functools

from jax import Array

from jaxstage.model.array_types import PerAxis
from jaxstage.model.blocks import ForceProfile, Plant
from jaxstage.model.fields import param, pytree
from jaxstage.model.signals import Power
from jaxstage.numerics.integrate import rk4
from jaxstage.numerics.smooth import positive
from jaxstage.plants.parts import rigid
from jaxstage.plants.parts.rigid import RigidState

AXES = "(axes,)"


@pytree
class PmlsmStage:
    """Parameters of the stage, one value per axis."""

    force_constant: Array = param("N/A", "K_f", "thrust per current", shape=AXES, above=0.0)
    mass: Array = param("kg", "M", "moving mass", shape=AXES, above=0.0)
    damping: Array = param("N s/m", "B", "viscous damping", shape=AXES, low=0.0)
    resistance: Array = param("ohm", "R", "phase resistance", shape=AXES, low=0.0)


def slope(params: PmlsmStage, state: RigidState, current: PerAxis, force: PerAxis) -> RigidState:
    """The equation of motion: (p', v') under a current in A and an external force in N."""
    push = params.force_constant * current - params.damping * state.velocity - force
    return RigidState(position=state.velocity, velocity=push / params.mass)


def _step(
    params: PmlsmStage, state: RigidState, applied: PerAxis, force: ForceProfile, dt: float
) -> RigidState:
    return rk4(lambda s, fraction: slope(params, s, applied, force(fraction)), state, dt)


def _power(
    params: PmlsmStage,
    before: RigidState,
    after: RigidState,
    applied: PerAxis,
    force: ForceProfile,
    dt: float,
) -> Power:
    """copper R u^2; mechanical K_f u Delta p / dt; the other two by Simpson's rule.

    The velocity in the middle is that of the cubic through both ends with their accelerations, so
    the ledger closes to the fourth order of the step. drawn max(copper + mechanical, 0): no
    regeneration.
    """
    forces = force(0.0), force(0.5), force(1.0)
    begin = slope(params, before, applied, forces[0]).velocity
    end = slope(params, after, applied, forces[2]).velocity
    middle = (before.velocity + after.velocity) / 2 + dt / 8 * (begin - end)
    speeds = before.velocity, middle, after.velocity
    copper = params.resistance * applied**2
    mechanical = params.force_constant * applied * (after.position - before.position) / dt
    return Power(
        copper=copper,
        mechanical=mechanical,
        dissipated=params.damping * _simpson([v**2 for v in speeds]),
        load=_simpson([f * v for f, v in zip(forces, speeds, strict=True)]),
        drawn=positive(copper + mechanical),
    )


def _simpson(values: list[PerAxis]) -> PerAxis:
    """Mean over the step from its start, middle and end."""
    return (values[0] + 4 * values[1] + values[2]) / 6


def _stored(params: PmlsmStage, state: RigidState) -> PerAxis:
    """Kinetic energy M v^2 / 2 of each axis, in J."""
    return params.mass * state.velocity**2 / 2


@functools.cache
def pmlsm_stage(axes: tuple[str, ...] = ("x", "y", "z")) -> Plant[PmlsmStage, RigidState]:
    """The stage with the named axes."""
    return Plant(
        name="pmlsm_stage",
        axes=axes,
        command_unit="A",
        init=rigid.init,
        step=_step,
        observe=rigid.observe,
        power=_power,
        stored=_stored,
    )
