"""Values of the fuzzy cross-coupling study.

Source: "Adaptive fuzzy PID cross coupled control for multi-axis motion system based on sliding mode
disturbance observation", Science Progress 2021, doi:10.1177/00368504211011847. Its equations and
its tables of parameters are lost in the text at hand. "published": stated in its prose;
"literature": usual, recalled; "chosen": all else, with the reason.
"""

from typing import Any, cast

import jax
import numpy as np
from jax import Array

from jaxstage.controllers import (
    Both,
    Coupled,
    DisturbanceObserver,
    FuzzyPidContour,
    Pd,
    PidContour,
    RigidAxis,
    Sliding,
)
from jaxstage.controllers.fuzzy_pid_contour import Adaptation, Bounds, Rules, Scales
from jaxstage.controllers.parts.fuzzy import consequents, seven_sets
from jaxstage.controllers.parts.nominal import authority
from jaxstage.controllers.parts.pid_rules import DERIVATIVE, INTEGRAL, PROPORTIONAL
from jaxstage.hardware.drives import CurrentDrive
from jaxstage.hardware.loads import SineLoad
from jaxstage.model.signals import Scenario, Start
from jaxstage.numerics.smooth import SmoothWidth
from jaxstage.plants import PmlsmStage
from jaxstage.references import Helix, helix

#: what the contour gains are at the start: K_P in 1/s2, K_I in 1/s3, K_D in 1/s (chosen)
BASE = (1000.0, 5000.0, 10.0)
#: how far the outermost rules are from it (chosen)
SPREAD = (800.0, 4000.0, 8.0)
#: k = eta / phi in 1/s, the pole of the boundary layer (chosen)
LAYER_POLE = 100.0


def _axes(x: float, y: float | None = None, z: float | None = None) -> Array:
    # numpy until a case is built: importing must not start JAX
    return cast(Array, np.array([x, x if y is None else y, x if z is None else z]))


def _scalar(value: float) -> Array:
    return cast(Array, np.asarray(value, float))


def plant() -> PmlsmStage:
    """The stage; z is counterbalanced."""
    return PmlsmStage(
        force_constant=_axes(50.0, 50.0, 40.0),  # chosen: usual for laboratory axes
        mass=_axes(12.0, 8.0, 5.0),  # chosen: likewise; unequal, as the paper is about
        damping=_axes(10.0, 8.0, 12.0),  # chosen: likewise
        resistance=_axes(2.0),  # chosen: energy is not in the paper
    )


def load() -> SineLoad:
    """The disturbance, "randomly chosen" in the paper; slow against the observer."""
    return SineLoad(
        amplitude=_axes(20.0, 15.0, 10.0),  # chosen: a few per cent of the largest thrust
        frequency=_axes(np.pi, 2.0, 1.5),  # chosen: "slow time-varying" is published
        phase=_axes(0.0),  # chosen
        bias=_axes(0.0),  # chosen
    )


def path() -> Helix:
    """Two turns of a helix in 10 s: curve and duration published, size and speed chosen."""
    return helix(radius=0.05, turn_rate=0.4 * np.pi, climb_rate=0.01)


def scenario() -> Scenario:
    """Started at the speed of the path, 111.5 um beside it: the size of the published maxima."""
    return Scenario(
        plant=plant(),
        load=load(),
        sensor=(),
        # chosen: never reached on the published motion; an ideal current loop
        drive=CurrentDrive(limit=_axes(10.0), delay=_scalar(0.0), lag=_scalar(0.0)),
        # chosen: the published errors look like one at the start
        start=Start(offset=_axes(-100e-6, 0.0, -50e-6), velocity=_axes(1.0)),
        key=jax.random.key(0),
    )


def nominal(mass_error: Any = 1.0) -> RigidAxis:
    """What the laws assume; mass_error: assumed over true mass, () or (axes,)."""
    stage = plant()
    return RigidAxis(
        force_constant=stage.force_constant,
        mass=stage.mass * mass_error,
        damping=stage.damping,
        coulomb=_axes(0.0),
        load=_axes(0.0),
    )


def sliding_gains(axis: RigidAxis, eta: Any = 0.5, switch: Any = None) -> Sliding:
    """Sliding mode; eta: () m/s2. switch: parameters, phi = 5 mm/s where left out.

    The observer takes the disturbance, so the switching gain has no share for it.
    """
    return Sliding(
        slope=_axes(10.0, 12.0, 15.0),  # chosen
        switching_gain=_axes(1.0) * eta,  # chosen: above what the observer leaves
        disturbance_bound=_axes(0.0),
        switch=SmoothWidth(width=_axes(5e-3)) if switch is None else switch,
        nominal=axis,
    )


def pd_gains(axis: RigidAxis) -> Pd:
    """k_p = c k, k_d = c + k: the poles of the sliding-mode law in its boundary layer."""
    slope = np.array([10.0, 12.0, 15.0])
    return Pd(
        proportional_gain=cast(Array, slope * LAYER_POLE),
        derivative_gain=cast(Array, slope + LAYER_POLE),
        nominal=axis,
    )


def observer_gains(axis: RigidAxis) -> DisturbanceObserver:
    """A double pole at -500 1/s: chosen, fast against the disturbance."""
    return DisturbanceObserver(
        disturbance_gain=_axes(250e3), velocity_gain=_axes(1000.0), nominal=axis
    )


def pid_gains(base: tuple[float, float, float] = BASE) -> PidContour:
    """Constant contour gains ("after lots of debugging"; chosen)."""
    return PidContour(
        proportional_gain=_scalar(base[0]),
        integral_gain=_scalar(base[1]),
        derivative_gain=_scalar(base[2]),
        rest_speed=_scalar(1e-6),
        form=(),
    )


def fuzzy_gains(adapting: bool = True) -> FuzzyPidContour:
    """Scheduled contour gains, by rules (literature) that learn or stay; numbers chosen.

    Learning rates, scales and bounds are such that the gains change by their own size in 10 s.
    """
    rules = Rules(
        proportional=consequents(BASE[0], SPREAD[0], PROPORTIONAL),
        integral=consequents(BASE[1], SPREAD[1], INTEGRAL),
        derivative=consequents(BASE[2], SPREAD[2], DERIVATIVE),
    )
    learning = (4e4, 2e4, 400.0) if adapting else (0.0, 0.0, 0.0)
    return FuzzyPidContour(
        rules=rules,
        error_sets=seven_sets(),
        rate_sets=seven_sets(),
        scales=Scales(deviation=_scalar(50e-6), rate=_scalar(2e-3), integral=_scalar(5e-6)),
        adaptation=Adaptation(
            slope=_scalar(30.0),
            proportional_rate=_scalar(learning[0]),
            integral_rate=_scalar(learning[1]),
            derivative_rate=_scalar(learning[2]),
            leak=_scalar(0.0),
        ),
        bounds=Bounds(
            proportional_least=_scalar(0.0),
            proportional_most=_scalar(4000.0),
            integral_least=_scalar(0.0),
            integral_most=_scalar(20000.0),
            derivative_least=_scalar(0.0),
            derivative_most=_scalar(40.0),
        ),
        rounding=_scalar(1e-6),
        rest_speed=_scalar(1e-6),
        form=(),
    )


def observed(law: Any, axis: RigidAxis) -> Both:
    """A law of the axes with the observer beside it."""
    return Both(law=law, extra=observer_gains(axis))


def coupled(law: Any, contour: Any, axis: RigidAxis) -> Coupled:
    """A law of the axes with a contour law on top."""
    return Coupled(law=law, extra=contour, command_per_acceleration=1 / authority(axis))
