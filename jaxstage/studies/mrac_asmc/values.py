"""Values of the model-reference and adaptive sliding-mode study.

Source: Zhang et al., "Integrated Controller Design and Application for CNC Machine Tool Servo
Systems Based on Model Reference Adaptive Control and Adaptive Sliding Mode Control", Sensors 2023,
23, 9755. "published": printed there; "chosen": not printed or not usable as printed, with reason.

The paper's law works in rad. With 1 rad for 1 mm (chosen: eps J is a torque only for eps in rad/s2;
read in metres the bristles would bend 5.3 mm, more than the stroke) S = 1000 rad/m, and
c stays, eps / S, a S, g_eps stays, g_a S^3, g_c S^2.
"""

from typing import Any, cast

import jax
import numpy as np
from jax import Array

from jaxstage.controllers import (
    AdaptiveSliding,
    Cascade,
    Limits,
    ModelReference,
    Offset,
    PositionFeedforward,
    Rates,
    RigidAxis,
    Sliding,
)
from jaxstage.hardware.drives import CurrentDrive
from jaxstage.hardware.sensors import Encoder
from jaxstage.model.fields import replace
from jaxstage.model.signals import Scenario, Start
from jaxstage.numerics.smooth import Layer, SmoothWidth
from jaxstage.plants import Lugre, TwoInertia

#: control period in s, published (there called a frequency)
DT = 0.48e-3
#: plant steps a period (chosen: metrics are within 1e-3 of those of far smaller steps)
SUBSTEPS = 12
#: angle per travel in rad/m (chosen, see above)
RATIO = 1000.0
#: the motion r = A (1 + cos(2 pi t/T)): 1 mm and 4 s, three times; published
AMPLITUDE, PERIOD, DURATION = 1e-3, 4.0, 12.0
#: metrics cover t >= this, in s (chosen: the second and third period)
SKIP = 4.0
#: time after a reversal in s that belongs to its peak (chosen: so slow a motion breaks away late)
REVERSAL = 0.25
#: position feed-forward in m, published
FEEDFORWARD = 2e-6
#: bounds of eps, a and c in rad units (chosen): wide, and the tighter caps of the last two
EPS, SHARP, SLOPE = (0.0, 1e6), (1e-3, 1e6), (1.0, 1e6)
CAP_SHARP, CAP_SLOPE = 60.0, 300.0


def value(x: float) -> Array:
    """A number for the one axis."""
    # numpy until a case is built: importing must not start JAX
    return cast(Array, np.array([x], float))


def plant() -> TwoInertia:
    """Tables 1 and 2; read as rotary: the printed units of friction and damping do not fit."""
    return TwoInertia(
        motor_inertia=value(2.85e-4),  # published
        load_inertia=value(5.12e-5),  # published
        stiffness=value(18.29),  # published
        damping=value(0.064),  # published number, unit chosen
        ratio=value(RATIO),
        copper_loss=value(8.0),  # chosen: 2 ohm and 0.5 N m/A; energy is not in the paper
        friction=Lugre(
            coulomb=value(0.0091),  # published numbers, units chosen: N m, rad
            static=value(0.04263),
            stribeck=value(0.007353),
            bristle_stiffness=value(8.0274),
            bristle_damping=value(2.343),
            viscous=value(0.02772),
        ),
    )


def nominal() -> RigidAxis:
    """What the laws assume: both inertias as one, K, C and friction left out, equation (6)."""
    whole = np.asarray(plant().motor_inertia) + np.asarray(plant().load_inertia)
    return RigidAxis(
        force_constant=value(RATIO),
        mass=cast(Array, whole * RATIO**2),
        damping=value(0.0),
        coulomb=value(0.0),
        load=value(0.0),
    )


def scenario(rough: bool = False) -> Scenario:
    """The published drive, at rest on the path: c cannot adapt from an error of 2 mm (chosen).

    rough: scenario R, all chosen but the resolution: encoder of 2000 counts/mm, velocity
    differenced and filtered at 200 Hz, one period of dead time. The filter was picked from 100,
    200, 300, 500 and 800 Hz because the variance of `smc1500` is then near the printed one.
    """
    return Scenario(
        plant=plant(),
        load=(),
        sensor=Encoder(
            resolution=cast(Array, np.asarray(0.5e-6)), bandwidth=cast(Array, np.asarray(200.0))
        )
        if rough
        else (),
        drive=CurrentDrive(
            limit=value(5.0),  # chosen: never reached on the published motion
            delay=cast(Array, np.asarray(1.0 if rough else 0.0)),
            lag=cast(Array, np.asarray(0.0)),
        ),
        start=Start(offset=value(0.0), velocity=value(0.0)),
        key=jax.random.key(0),
    )


def adaptive(
    slope: float,
    gain: float,
    sharpness: float,
    rates: tuple[float, float, float] = (0, 0, 0),
    caps: bool = False,
) -> AdaptiveSliding:
    """c(0), eps(0), a(0) and (g_c, g_eps, g_a) as printed, angles in rad."""
    return AdaptiveSliding(
        slope=value(slope),
        slope_rate=value(rates[0] * RATIO**2),
        slope_least=value(SLOPE[0]),
        slope_most=value(CAP_SLOPE if caps else SLOPE[1]),
        switching_gain=value(gain / RATIO),
        switching_rate=value(rates[1]),
        switching_least=value(EPS[0] / RATIO),
        switching_most=value(EPS[1] / RATIO),
        sharpness=value(sharpness * RATIO),
        sharpness_rate=value(rates[2] * RATIO**3),
        sharpness_least=value(SHARP[0] * RATIO),
        sharpness_most=value((CAP_SHARP if caps else SHARP[1]) * RATIO),
        nominal=nominal(),
    )


def sim1() -> AdaptiveSliding:
    """First simulation, section 4: fixed slope. Published."""
    return adaptive(30, 10, 5, (0, 800, 10))


def sim2() -> AdaptiveSliding:
    """Second simulation, section 4: the slope adapts. Published."""
    return adaptive(30, 230, 50, (3000, 500, 10))


def asmc(caps: bool = False) -> AdaptiveSliding:
    """Table 3, ASMC. caps: c <= 300, a <= 60 (chosen: without, scenario R diverges)."""
    return adaptive(250, 230, 50, (3000, 500, 10), caps)


def sigmoid(sharpness: float = 50) -> AdaptiveSliding:
    """The law (12) with the values of Table 3, not adapting."""
    return adaptive(250, 230, sharpness)


def sliding_mode(gain: float, switch: Layer | SmoothWidth | tuple[()] = ()) -> Sliding:
    """The law (8), c = 500 published; gain: eps in rad/s2."""
    return Sliding(
        slope=value(500.0),
        switching_gain=value(gain / RATIO),
        disturbance_bound=value(0.0),
        switch=switch,
        nominal=nominal(),
    )


def cascade_gains() -> Cascade:
    """PID with rate feed-forward (all chosen: not printed; its peak error is like the printed)."""
    return Cascade(
        position_gain=value(60.0),
        velocity_gain=value(400.0),
        integral_gain=value(8000.0),
        velocity_feedforward=value(1.0),
        acceleration_feedforward=value(0.0),
        friction_feedforward=value(0.0),
        load_feedforward=value(0.0),
        friction_width=value(1e-5),
        nominal=nominal(),
    )


def inner(law: Any, active: bool = True) -> ModelReference:
    """The MRAC inner loop (chosen: the paper cites a law without printing it).

    Pick from about 45 settings, partly by their result in scenario R. active: without, all rates
    are 0 and the loop passes the demand of the law through.
    """
    rates = Rates(
        input=value(0.0), viscous=value(20.0 * RATIO**2), dry=value(2000.0), constant=value(400.0)
    )
    return ModelReference(
        law=law,
        model_rate=value(100.0),
        dry_width=value(0.05 / RATIO),
        leak=value(0.0),
        rates=rates if active else jax.tree.map(np.zeros_like, rates),
        limits=Limits(
            input=value(0.9),
            viscous=value(500.0),
            dry=value(1000.0 / RATIO),
            constant=value(1000.0 / RATIO),
        ),
        nominal=nominal(),
    )


def ahead(gains: Any, amplitude: float = FEEDFORWARD) -> Offset:
    """Gains of a law with position feed-forward."""
    return Offset(law=gains, offset=PositionFeedforward(amplitude=value(amplitude)))


def softer(uncertain: Scenario, damping: float = 6.4e-4) -> Scenario:
    """The drive with a hundredth of the printed damping, so that its resonance shows (chosen)."""
    return replace(uncertain, plant=replace(uncertain.plant, damping=value(damping)))
