"""Two inertias, motor and load, joined by a shaft, with LuGre friction on one of them.

    J_1 w_1' = u - K (th_1 - th_2) - C (w_1 - w_2) - [F on the motor]                        (1)
    J_2 w_2' = K (th_1 - th_2) + C (w_1 - w_2) - [F on the load] - F_ext / S                 (2)
    th_1' = w_1,  th_2' = w_2,  tool x = th_2 / S,  drive x_d = th_1 / S

u: motor torque in N m, held over the step; F: `lugre`; F_ext: external force on the tool.

| symbol | field | unit |
|---|---|---|
| J_1, J_2 | motor_inertia, load_inertia | kg m2 |
| K, C | stiffness, damping | N m/rad, N m s/rad |
| S | ratio | rad/m |
| F: F_c, F_s, v_s, sigma_0 to sigma_2 | friction | `Lugre` |
| copper loss P = k u^2 | copper_loss | W/N2 m2 |

The bristles make the load stiff: with the published values its fastest pole at rest is at
-47 548 1/s, and explicit Runge-Kutta steps must stay below 59 us. The `implicit` step has no such
limit. It is the default because of these figures, for the published motion (12 s, control period
T = 0.48 ms) under the cascade, the sigmoid law and the adaptive law, both with MRAC: largest
relative difference of the maximum, mean and variance of the following error from explicit steps
of T/96; and time of a plant step against explicit steps of T/48, one run and 64 in a batch:

| steps a period | friction on the load | on the motor | time |
|---|---|---|---|
| explicit, 6 | not finite | | |
| explicit, 12 | 2.6e-2 | 2.7e-4 | |
| explicit, 48 | 6.7e-5 | 2.6e-6 | 1 |
| implicit, 1 | 1.7e-2 | 6.1e-2 | 0.007, 0.02 |
| implicit, 4 | 1.1e-3 | 1.2e-2 | |
| implicit, 12 | 1.9e-4 | 1.5e-3 | 0.07, 0.28 |

Away from reversals, where |v| has its kink, it is of second order.
Source: Zhang et al., Sensors 2023, 23, 9755, equations (1)-(3), read as rotating bodies with the
lead 1/S for the tool; side of the friction, copper loss and integration are choices.
"""

import functools
from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

from jaxstage.model.array_types import PerAxis
from jaxstage.model.blocks import ForceProfile, Plant
from jaxstage.model.fields import definition, param, part, pytree, signal
from jaxstage.model.signals import Output, Power
from jaxstage.numerics.integrate import rk4, sdirk2
from jaxstage.numerics.smooth import positive
from jaxstage.plants.parts.lugre import (
    Lugre,
    bristle_rate,
    dissipated,
    friction_torque,
    implicit_step,
)

AXES = "(axes,)"


@pytree
class TwoInertia:
    """Parameters of the drive, one value per axis."""

    motor_inertia: Array = param("kg m2", "J_1", "inertia of the motor", shape=AXES, above=0.0)
    load_inertia: Array = param("kg m2", "J_2", "inertia of the load", shape=AXES, above=0.0)
    stiffness: Array = param("N m/rad", "K", "stiffness of the shaft", shape=AXES, above=0.0)
    damping: Array = param("N m s/rad", "C", "damping of the shaft", shape=AXES, low=0.0)
    ratio: Array = param("rad/m", "S", "angle per travel of the tool", shape=AXES, above=0.0)
    copper_loss: Array = param(
        "W/(N2 m2)", "k_cu", "copper loss per squared torque", shape=AXES, low=0.0
    )
    friction: Lugre = part("friction on the load or the motor")


@pytree
class TwoInertiaState:
    """State of the drive."""

    motor_angle: Array = signal("rad", "th_1", "angle of the motor", shape=AXES)
    motor_speed: Array = signal("rad/s", "w_1", "speed of the motor", shape=AXES)
    load_angle: Array = signal("rad", "th_2", "angle of the load", shape=AXES)
    load_speed: Array = signal("rad/s", "w_2", "speed of the load", shape=AXES)
    bristle: Array = signal("rad", "z", "deflection of the bristles", shape=AXES)


@definition
class FrictionSide:
    """Which of the two bodies rubs.

    Attributes:
        name: of the body.
        order: ``(motor, load) -> (rubbing, other)``, and by the same exchange back again.
    """

    name: str
    order: Callable[[PerAxis, PerAxis], tuple[PerAxis, PerAxis]]


#: Friction on the guideway: the load rubs.
on_load = FrictionSide(name="load", order=lambda motor, load: (load, motor))

#: Friction in the bearings of the motor.
on_motor = FrictionSide(name="motor", order=lambda motor, load: (motor, load))


def slope(
    side: FrictionSide, params: TwoInertia, state: TwoInertiaState, torque: PerAxis, force: PerAxis
) -> TwoInertiaState:
    """The equations of motion. torque: u in N m; force: on the tool in N, positive against +x."""
    rubbing, _ = side.order(state.motor_speed, state.load_speed)
    friction = friction_torque(params.friction, rubbing, state.bristle)
    on_motor, on_load = side.order(friction, jnp.zeros_like(friction))
    shaft = params.stiffness * (state.motor_angle - state.load_angle) + params.damping * (
        state.motor_speed - state.load_speed
    )
    return TwoInertiaState(
        motor_angle=state.motor_speed,
        motor_speed=(torque - shaft - on_motor) / params.motor_inertia,
        load_angle=state.load_speed,
        load_speed=(shaft - on_load - force / params.ratio) / params.load_inertia,
        bristle=bristle_rate(params.friction, rubbing, state.bristle),
    )


def _implicit_euler(
    side: FrictionSide,
    params: TwoInertia,
    base: TwoInertiaState,
    torque: PerAxis,
    force: PerAxis,
    dt: float,
) -> TwoInertiaState:
    """y = base + dt slope(y): the other body is eliminated, the rubbing one is a quadratic.

    The shaft is linear, so the other body moves with the rubbing one by a share of its speed.
    """
    twist = params.stiffness * (base.motor_angle - base.load_angle)
    coupling = dt * (dt * params.stiffness + params.damping)
    inertia, other = side.order(params.motor_inertia, params.load_inertia)
    push, other_push = side.order(
        params.motor_inertia * base.motor_speed + dt * (torque - twist),
        params.load_inertia * base.load_speed + dt * (twist - force / params.ratio),
    )
    share = coupling / (other + coupling)
    guess, _ = side.order(base.motor_speed, base.load_speed)
    speed, bristle = implicit_step(
        params.friction, inertia + share * other, push + share * other_push, base.bristle, guess, dt
    )
    motor, load = side.order(speed, (other_push + coupling * speed) / (other + coupling))
    return TwoInertiaState(
        motor_angle=base.motor_angle + dt * motor,
        motor_speed=motor,
        load_angle=base.load_angle + dt * load,
        load_speed=load,
        bristle=bristle,
    )


@definition
class Integration:
    """How a step is made.

    Attributes:
        name: of the method.
        advance: ``(side, params, state, torque, force profile, dt) -> state``.
    """

    name: str
    advance: Callable[
        [FrictionSide, TwoInertia, TwoInertiaState, PerAxis, ForceProfile, float], TwoInertiaState
    ]


def _advance_implicit(
    side: FrictionSide,
    params: TwoInertia,
    state: TwoInertiaState,
    torque: PerAxis,
    force: ForceProfile,
    dt: float,
) -> TwoInertiaState:
    def stage(base: TwoInertiaState, h: float, fraction: float) -> TwoInertiaState:
        return _implicit_euler(side, params, base, torque, force(fraction), h)

    return sdirk2(stage, state, dt)


def _advance_explicit(
    side: FrictionSide,
    params: TwoInertia,
    state: TwoInertiaState,
    torque: PerAxis,
    force: ForceProfile,
    dt: float,
) -> TwoInertiaState:
    return rk4(lambda s, fraction: slope(side, params, s, torque, force(fraction)), state, dt)


#: Second-order diagonally implicit Runge-Kutta steps, L-stable: for steps of any length.
implicit = Integration(name="implicit", advance=_advance_implicit)

#: Classical Runge-Kutta steps of fourth order; limited by the bristles.
explicit = Integration(name="explicit", advance=_advance_explicit)


def _init(params: TwoInertia, output: Output) -> TwoInertiaState:
    return TwoInertiaState(
        motor_angle=params.ratio * output.drive_position,
        motor_speed=params.ratio * output.drive_velocity,
        load_angle=params.ratio * output.position,
        load_speed=params.ratio * output.velocity,
        bristle=jnp.zeros_like(output.position),
    )


def _observe(params: TwoInertia, state: TwoInertiaState) -> Output:
    return Output(
        position=state.load_angle / params.ratio,
        velocity=state.load_speed / params.ratio,
        drive_position=state.motor_angle / params.ratio,
        drive_velocity=state.motor_speed / params.ratio,
    )


def _stored(params: TwoInertia, state: TwoInertiaState) -> PerAxis:
    """J_1 w_1^2/2 + J_2 w_2^2/2 + K (th_1 - th_2)^2/2 + sigma_0 z^2/2 of each axis, in J."""
    kinetic = (
        params.motor_inertia * state.motor_speed**2 + params.load_inertia * state.load_speed**2
    )
    twist = params.stiffness * (state.motor_angle - state.load_angle) ** 2
    return (kinetic + twist + params.friction.bristle_stiffness * state.bristle**2) / 2


@functools.cache
def two_inertia(
    axes: tuple[str, ...] = ("x",),
    side: FrictionSide = on_load,
    integration: Integration = implicit,
) -> Plant[TwoInertia, TwoInertiaState]:
    """The drive with the named axes; friction `on_load` or `on_motor`, `implicit` or `explicit`."""

    def step(
        params: TwoInertia, state: TwoInertiaState, applied: PerAxis, force: ForceProfile, dt: float
    ) -> TwoInertiaState:
        return integration.advance(side, params, state, applied, force, dt)

    def losses(params: TwoInertia, state: TwoInertiaState) -> PerAxis:
        rubbing, _ = side.order(state.motor_speed, state.load_speed)
        twisting = params.damping * (state.motor_speed - state.load_speed) ** 2
        return twisting + dissipated(params.friction, rubbing, state.bristle)

    def power(
        params: TwoInertia,
        before: TwoInertiaState,
        after: TwoInertiaState,
        applied: PerAxis,
        force: ForceProfile,
        dt: float,
    ) -> Power:
        """copper k u^2; mechanical u dth_1/dt, exact; dissipated and load by the trapezoidal rule.

        drawn max(copper + mechanical, 0): no regeneration.
        """
        copper = params.copper_loss * applied**2
        mechanical = applied * (after.motor_angle - before.motor_angle) / dt
        worked = force(0.0) * before.load_speed + force(1.0) * after.load_speed
        return Power(
            copper=copper,
            mechanical=mechanical,
            dissipated=(losses(params, before) + losses(params, after)) / 2,
            load=worked / (2 * params.ratio),
            drawn=positive(copper + mechanical),
        )

    return Plant(
        name=f"two_inertia[friction on {side.name}, {integration.name}]",
        axes=axes,
        command_unit="N m",
        init=_init,
        step=step,
        observe=_observe,
        power=power,
        stored=_stored,
    )
