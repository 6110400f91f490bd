"""XY table on linear PMSM drives with Coulomb-Stribeck friction that truly sticks.

    M v' + (B + K_v) v + F_f(v) + F_L + F = K_t w,   x' = v,   w = play(u)          (1), (3), (4)
    F_f(v) = [F_c + (F_s - F_c) exp(-(v/v_s)^2)] sgn v                              (2)

u: phase current in A; w: current that acts, behind the backlash; F: external load.
One step of length h treats the dry friction implicitly (backward Euler, proximal), so the axis
sticks exactly and no smallest step exists:

    t   = v + h (K_t w - F_L - F) / M
    t   = t - clip(t, +-h [F_c + (F_s - F_c) exp(-(v/v_s)^2)] / M)
    v'  = t / (1 + h (B + K_v) / M),   x' = x + h v'

Source: Mao et al., Energies 2021, 14, 7802, equations (1)-(4). The implicit step, the play
operator for the paper's unknown backlash function and the phase resistance are choices.
"""

import functools

import jax.numpy as jnp
from jax import Array

from jaxstage.model.array_types import PerAxis
from jaxstage.model.blocks import ForceProfile, Plant
from jaxstage.model.fields import param, pytree, signal
from jaxstage.model.signals import Output, Power
from jaxstage.numerics.smooth import DryFriction, play, positive, sticking
from jaxstage.plants.parts.friction import FrictionLaw
from jaxstage.plants.parts.rigid import one_body

N_PER_A = "N/A"
AXES = "(axes,)"


@pytree
class PmsmTable:
    """Parameters of the table, one value per axis."""

    force_constant: Array = param(N_PER_A, "K_t", "motor force per current", shape=AXES, above=0.0)
    mass: Array = param("kg", "M", "moving mass", shape=AXES, above=0.0)
    damping: Array = param("N s/m", "B", "viscous damping", shape=AXES, low=0.0)
    viscous: Array = param("N s/m", "K_v", "viscous part of the friction", shape=AXES, low=0.0)
    coulomb: Array = param("N", "F_c", "Coulomb friction", shape=AXES, low=0.0)
    static: Array = param(
        "N", "F_s", "break-away friction", shape=AXES, low=0.0, at_least="coulomb"
    )
    stribeck: Array = param("m/s", "v_s", "Stribeck velocity", shape=AXES, above=0.0)
    load: Array = param("N", "F_L", "constant load, positive against +x", shape=AXES)
    backlash: Array = param("A", "delta", "half width of the play, in current", shape=AXES, low=0.0)
    resistance: Array = param("ohm", "R", "phase resistance", shape=AXES, low=0.0)


@pytree
class TableState:
    """State of the table."""

    position: Array = signal("m", "x", "position", shape=AXES, shown="mm")
    velocity: Array = signal("m/s", "v", "velocity", shape=AXES, shown="mm/s")
    current: Array = signal("A", "w", "current that acts, behind the backlash", shape=AXES)


def dry_limit(params: PmsmTable, velocity: PerAxis) -> PerAxis:
    """F_c + (F_s - F_c) exp(-(v/v_s)^2): the largest dry friction force at a velocity, in N."""
    fading = jnp.exp(-((velocity / params.stribeck) ** 2))
    return params.coulomb + (params.static - params.coulomb) * fading


#: The published law, equation (2).
stribeck = FrictionLaw(name="stribeck", limit=dry_limit)


def friction_force(params: PmsmTable, velocity: PerAxis) -> PerAxis:
    """F_f(v), equation (2) without K_v v, in N; velocity in m/s."""
    return dry_limit(params, velocity) * jnp.sign(velocity)


def init(params: PmsmTable, output: Output) -> TableState:
    """Start at the given output with the backlash centred."""
    return TableState(
        position=output.position,
        velocity=output.velocity,
        current=jnp.zeros_like(output.position),
    )


def _driven(
    params: PmsmTable, state: TableState, applied: PerAxis, external: PerAxis, dt: float
) -> tuple[PerAxis, PerAxis]:
    """Current behind the backlash, and the speed that the axis would have without dry friction."""
    current = play(state.current, applied, params.backlash)
    push = params.force_constant * current - params.load - external
    return current, state.velocity + dt * push / params.mass


def observe(params: PmsmTable, state: TableState) -> Output:
    """Tool and drive are one body."""
    return one_body(state.position, state.velocity)


def stored(params: PmsmTable, state: TableState) -> PerAxis:
    """Kinetic energy M v^2 / 2 of each axis, in J."""
    return params.mass * state.velocity**2 / 2


@functools.cache
def pmsm_table(
    axes: tuple[str, ...] = ("x", "y"),
    friction: DryFriction = sticking,
    law: FrictionLaw = stribeck,
) -> Plant[PmsmTable, TableState]:
    """The table with the named axes; friction `sticking`, or `creeping` as a smooth surrogate.

    law: how large dry friction can be.
    """

    def step(
        params: PmsmTable, state: TableState, applied: PerAxis, force: ForceProfile, dt: float
    ) -> TableState:
        current, free = _driven(params, state, applied, force(0.5), dt)
        limit = dt * law.limit(params, state.velocity) / params.mass
        slid = free - friction.held(free, limit)
        velocity = slid / (1 + dt * (params.damping + params.viscous) / params.mass)
        position = state.position + dt * velocity
        return TableState(position=position, velocity=velocity, current=current)

    def power(
        params: PmsmTable,
        before: TableState,
        after: TableState,
        applied: PerAxis,
        force: ForceProfile,
        dt: float,
    ) -> Power:
        """Each term a force of the step times the mean velocity (v + v')/2.

        copper R u^2, mechanical K_t w v, drawn max(copper + mechanical, 0): no regeneration.
        With the mean velocity the terms balance the kinetic energy exactly.
        """
        velocity = (before.velocity + after.velocity) / 2
        external = force(0.5)
        current, free = _driven(params, before, applied, external, dt)
        dry = friction.held(free * params.mass / dt, law.limit(params, before.velocity))
        viscous = (params.damping + params.viscous) * after.velocity
        copper = params.resistance * applied**2
        mechanical = params.force_constant * current * velocity
        return Power(
            copper=copper,
            mechanical=mechanical,
            dissipated=(dry + viscous) * velocity,
            load=(params.load + external) * velocity,
            drawn=positive(copper + mechanical),
        )

    return Plant(
        name=f"pmsm_table[{law.name}, {friction.name}]",
        axes=axes,
        command_unit="A",
        init=init,
        step=step,
        observe=observe,
        power=power,
        stored=stored,
    )
