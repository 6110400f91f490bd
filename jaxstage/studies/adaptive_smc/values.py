"""Values of the adaptive sliding-mode study.

Source: Msukwa and Uchiyama, "Design and Experimental Verification of Adaptive Sliding Mode Control
for Precision Motion and Energy Saving in Feed Drive Systems", IEEE Access 7 (2019).
"published": printed there, Tables 1 and 2; "chosen": not printed, with the reason.
"""

from typing import Any, cast

import jax
import numpy as np
from jax import Array

from jaxstage.controllers import NonlinearSurface, RigidAxis
from jaxstage.controllers.parts.damping import BoundedDamping
from jaxstage.controllers.parts.reaching import AdaptiveGain, FixedGain, IntegralGain
from jaxstage.hardware.drives import CurrentDrive
from jaxstage.model.fields import replace
from jaxstage.model.signals import Scenario, Start
from jaxstage.plants import CreepingFriction, Motor, ScrewTable
from jaxstage.references import Trifolium, make_trifolium

#: control period in s, published
DT = 5e-3
#: resolution of the position in m, published
RESOLUTION = 25e-9
#: q = 0.3 of Table 2, whose unit m/s2 contradicts (12): in N, and in m/s2
Q_FORCE = 0.3
Q_PRINTED = 0.3
#: switching gain that matters and does not ruin the energy, m/s2 (chosen)
Q_SMALL = 0.01


def _xy(x: float, y: float | None = None) -> Array:
    # numpy until a case is built: importing must not start JAX
    return cast(Array, np.array([x, x if y is None else y], float))


def _scalar(value: float) -> Array:
    return cast(Array, np.asarray(value, float))


def _motor() -> Motor:
    return Motor(
        torque_constant=_xy(0.5),  # chosen, with the resistance
        resistance=_xy(0.4),  # chosen: the run with friction then costs the published 75 mWh
        inertia=_xy(0.05),  # published
        damping=_xy(0.31),  # published
        amplifier_gain=_xy(2.0),  # chosen: the variance is then near that of Table 5
        supply_voltage=_xy(np.inf),  # chosen: not given
        regeneration=_xy(0.0),  # chosen: braking power is lost, as in most small drives
    )


def frictionless() -> ScrewTable:
    """The table of Table 1 without disturbance."""
    return ScrewTable(
        mass=_xy(8.0, 2.5),  # published
        damping=_xy(102.48e3, 140.90e3),  # published, 102.48 and 140.90 N s/mm
        pitch=_xy(5e-3),  # chosen: 25 nm is then 1/200 000 of a turn, 50 000 lines four times
        motor=_motor(),
        friction=CreepingFriction(
            coulomb=_xy(0.0), static=_xy(0.0), stribeck=_xy(2e-4), width=_xy(5e-5)
        ),
        ripple=_xy(0.0),
        bias=_xy(0.0),
    )


def inertia() -> np.ndarray:
    """J_e in kg, on the host."""
    table = frictionless()
    turns = 2 * np.pi / np.asarray(table.pitch)
    return np.asarray(table.mass) + turns**2 * np.asarray(table.motor.inertia)


def viscosity() -> np.ndarray:
    """B_e in N s/m, on the host."""
    table = frictionless()
    turns = 2 * np.pi / np.asarray(table.pitch)
    return np.asarray(table.damping) + turns**2 * np.asarray(table.motor.damping)


def force_per_volt() -> np.ndarray:
    """K_mu g_a in N/V, on the host."""
    table = frictionless()
    motor = table.motor
    turns = 2 * np.pi / np.asarray(table.pitch)
    return turns * np.asarray(motor.torque_constant) * np.asarray(motor.amplifier_gain)


def _with_friction(coulomb: tuple[float, float], ratio: tuple[float, float]) -> ScrewTable:
    """coulomb: F_c / J_e in m/s2. ratio: F_s / F_c."""
    table = frictionless()
    dry = inertia() * np.array(coulomb)
    friction = replace(
        table.friction, coulomb=cast(Array, dry), static=cast(Array, dry * np.array(ratio))
    )
    return replace(table, friction=friction)


def fitted_friction() -> ScrewTable:
    """With friction fitted to Table 3: two numbers an axis, two printed errors an axis (chosen).

    It needs a break-away force of 36 and 16 times the Coulomb force; 1.1 to 2 is usual.
    """
    return _with_friction((8.0e-4, 1.7e-3), (36.0, 16.0))


def plain_friction() -> ScrewTable:
    """With Coulomb friction and no break-away (chosen)."""
    return _with_friction((1e-3, 1e-3), (1.0, 1.0))


def nominal(mass_error: float = 1.0) -> RigidAxis:
    """What the laws assume. mass_error: assumed over true inertia."""
    return RigidAxis(
        force_constant=cast(Array, force_per_volt()),
        mass=cast(Array, inertia() * mass_error),
        damping=cast(Array, viscosity()),
        coulomb=_xy(0.0),
        load=_xy(0.0),
    )


def fixed_gain(start: float = 80.0) -> FixedGain:
    """K = 80 1/s, published."""
    return FixedGain(start=_xy(start))


def adaptive_gain(rate: float = 3e5, dead_zone: float = 1.4e-5) -> AdaptiveGain:
    """K(0) = 80 1/s, published; all else chosen: nothing of (14) is printed."""
    return AdaptiveGain(
        start=_xy(80.0),
        rate=_xy(rate),
        dead_zone=_xy(dead_zone),
        floor=_xy(1.0),
        recovery=_xy(10.0),
        cap=_xy(300.0),  # below the sampled limit of K
    )


def steady_gain(start: float | Array = 80.0) -> AdaptiveGain:
    """A fixed gain in the form of an adaptive one: kbar = 0."""
    none = _xy(0.0)
    return AdaptiveGain(
        start=_xy(1.0) * start,
        rate=none,
        dead_zone=none,
        floor=none,
        recovery=none,
        cap=_xy(np.inf),
    )


def integral_gain(rate: float = 0.8e12) -> IntegralGain:
    """rho = 0.8 and the cap of 100 1/s, published; s in um/s (chosen: rho has no unit)."""
    return IntegralGain(start=_xy(80.0), rate=_xy(rate), cap=_xy(100.0))


def gains(
    reaching: Any,
    slope: float = 40.0,
    q: float | None = None,
    switch: Any = (),
    mass_error: float = 1.0,
) -> NonlinearSurface:
    """lam = 40, gam = 1.8, beta = 10 of Table 2. q: m/s2; None is the printed number as 0.3 N."""
    axis = nominal(mass_error)
    return NonlinearSurface(
        slope=_xy(slope),
        damping_slope=_xy(1.8),  # published
        switching_gain=cast(Array, Q_FORCE / np.asarray(axis.mass)) if q is None else _xy(q),
        damping=BoundedDamping(final=_xy(10.0), speed=_xy(1e-3)),  # published; chosen
        reaching=reaching,
        switch=switch,
        nominal=axis,
    )


def path(lap_time: float = 20.0) -> Trifolium:
    """r = 5 mm in 20 s (chosen: the friction work must stay below the published 74.6 mWh)."""
    return make_trifolium(5e-3, lap_time)


def scenario(table: ScrewTable, sensor: Any = (), start_speed: float = 0.0) -> Scenario:
    """Started on the path at a share of its speed (0: at rest, chosen)."""
    return Scenario(
        plant=table,
        load=(),
        sensor=sensor,
        # chosen: the paper tells of neither limit, dead time nor lag
        drive=CurrentDrive(limit=_xy(np.inf), delay=_scalar(0.0), lag=_scalar(0.0)),
        start=Start(offset=_xy(0.0), velocity=_xy(start_speed)),
        key=jax.random.key(0),
    )
