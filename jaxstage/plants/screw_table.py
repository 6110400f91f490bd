"""XY table on lead screws with DC servo motors: motor, screw and table as one inertia an axis.

    J v' + B v + F_f(v) + F_r sin(2 pi x / p) + F_b + F = K i,   x' = v             (1)-(4)
    J = m + k^2 n,   B = c + k^2 h,   K = k k_t,   k = 2 pi / p

u: command in V, held over a step, from which the `Motor` makes the current i; F_f: the
`CreepingFriction`; F: external load. Integrated by the classical Runge-Kutta method; the friction
work and the load work are integrated beside the motion by the same stages, so that the ledger

    K i v - (B v + F_f) v - (F_b + F) v = d/dt [ J v^2 / 2 + F_r p / (2 pi) (1 - cos(2 pi x / p)) ]

closes to the fourth order of the step. The supply limit is taken at the start of the step.

| symbol | field | unit |
|---|---|---|
| m, c | mass, damping | kg, N s/m |
| p | pitch | m |
| k_t, R_a, n, h, g_a | motor | N m/A, ohm, kg m2, N m s/rad, A/V |
| F_c, F_s, v_s, w | friction | N, N, m/s, m/s |
| F_r, F_b | ripple, bias | N |

Source: Msukwa and Uchiyama, IEEE Access 2019, equations (1)-(4). Their disturbance d is not
described: friction, ripple and bias are choices, and so is the electrical side.
"""

import functools

import jax.numpy as jnp
from jax import Array

from jaxstage.model.array_types import PerAxis
from jaxstage.model.blocks import ForceProfile, Plant
from jaxstage.model.fields import param, part, pytree, signal
from jaxstage.model.signals import Power
from jaxstage.numerics.integrate import rk4
from jaxstage.plants.parts import motor as motors
from jaxstage.plants.parts import rigid
from jaxstage.plants.parts.friction import CreepingFriction, friction_force
from jaxstage.plants.parts.motor import Motor
from jaxstage.plants.parts.rigid import RigidState

AXES = "(axes,)"


@pytree
class ScrewTable:
    """Parameters of the table, one value per axis."""

    mass: Array = param("kg", "m", "moving mass", shape=AXES, above=0.0)
    damping: Array = param("N s/m", "c", "viscous damping of the guide", shape=AXES, low=0.0)
    pitch: Array = param("m", "p", "travel per turn", shape=AXES, above=0.0, shown="mm")
    motor: Motor = part("the motors")
    friction: CreepingFriction = part("dry friction")
    ripple: Array = param("N", "F_r", "amplitude of the force once a turn", shape=AXES, low=0.0)
    bias: Array = param("N", "F_b", "constant load, positive against +x", shape=AXES)


@pytree
class _Step:
    """What is integrated over a step; the last three start from 0."""

    position: Array = signal("m", "x", "position", shape=AXES)
    velocity: Array = signal("m/s", "v", "velocity", shape=AXES)
    travel: Array = signal("m", "", "distance made in the step", shape=AXES)
    friction: Array = signal("J", "", "work of friction and damping", shape=AXES)
    load: Array = signal("J", "", "work of bias and external load", shape=AXES)


def _turns(params: ScrewTable) -> PerAxis:
    """k = 2 pi / p: rotation per travel, rad/m."""
    return 2 * jnp.pi / params.pitch


def inertia(params: ScrewTable) -> PerAxis:
    """J = m + k^2 n: what the motor moves, as a mass in kg."""
    return params.mass + _turns(params) ** 2 * params.motor.inertia


def viscosity(params: ScrewTable) -> PerAxis:
    """B = c + k^2 h: viscous damping of table and motor, N s/m."""
    return params.damping + _turns(params) ** 2 * params.motor.damping


def force_constant(params: ScrewTable) -> PerAxis:
    """K = k k_t: force per current, N/A."""
    return _turns(params) * params.motor.torque_constant


def _current(params: ScrewTable, state: RigidState, applied: PerAxis) -> PerAxis:
    return motors.current(params.motor, applied, _turns(params) * state.velocity)


def _advance(
    params: ScrewTable, state: RigidState, applied: PerAxis, force: ForceProfile, dt: float
) -> _Step:
    push = force_constant(params) * _current(params, state, applied)
    mass, viscous, turns = inertia(params), viscosity(params), _turns(params)

    def slope(at: _Step, fraction: float) -> _Step:
        lost = viscous * at.velocity + friction_force(params.friction, at.velocity)
        external = params.bias + force(fraction)
        ripple = params.ripple * jnp.sin(turns * at.position)
        return _Step(
            position=at.velocity,
            velocity=(push - lost - external - ripple) / mass,
            travel=at.velocity,
            friction=lost * at.velocity,
            load=external * at.velocity,
        )

    zero = jnp.zeros_like(state.position)
    begin = _Step(
        position=state.position, velocity=state.velocity, travel=zero, friction=zero, load=zero
    )
    return rk4(slope, begin, dt)


def step(
    params: ScrewTable, state: RigidState, applied: PerAxis, force: ForceProfile, dt: float
) -> RigidState:
    """One Runge-Kutta step with the current held."""
    after = _advance(params, state, applied, force, dt)
    return RigidState(position=after.position, velocity=after.velocity)


def stored(params: ScrewTable, state: RigidState) -> PerAxis:
    """Kinetic energy, and the potential of the ripple, of each axis in J."""
    turns = _turns(params)
    potential = params.ripple / turns * (1 - jnp.cos(turns * state.position))
    return inertia(params) * state.velocity**2 / 2 + potential


def power(
    params: ScrewTable,
    before: RigidState,
    after: RigidState,
    applied: PerAxis,
    force: ForceProfile,
    dt: float,
) -> Power:
    """Mean power of a step.

    copper R_a i^2; mechanical K i times the distance made; drawn: both together, plus what was
    returned and not taken back, (1 - eta_r) max(-P, 0) by the trapezoid of start and end.
    """
    done = _advance(params, before, applied, force, dt)
    flowing, turns = _current(params, before, applied), _turns(params)
    copper = params.motor.resistance * flowing**2
    mechanical = force_constant(params) * flowing * done.travel / dt
    first, last = (
        motors.returned(params.motor, flowing, turns * end.velocity) for end in (before, after)
    )
    wasted = (1 - params.motor.regeneration) * (first + last) / 2
    return Power(
        copper=copper,
        mechanical=mechanical,
        dissipated=done.friction / dt,
        load=done.load / dt,
        drawn=copper + mechanical + wasted,
    )


@functools.cache
def screw_table(axes: tuple[str, ...] = ("x", "y")) -> Plant[ScrewTable, RigidState]:
    """The table with the named axes."""
    return Plant(
        name="screw_table",
        axes=axes,
        command_unit="V",
        init=rigid.init,
        step=step,
        observe=rigid.observe,
        power=power,
        stored=stored,
    )
