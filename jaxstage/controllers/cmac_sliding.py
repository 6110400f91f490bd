"""CMAC sliding mode: a CMAC learns the equivalent control while the axis slides.

    e = r - y,  s = -(c1 e + e')                                                     (15)
    theta <- theta - 2 r1 nu s b xi dt       adapt first                             (22)
    u = xi^T theta - (eta / b) w(s)          with the new theta                      (21)

xi: receptive fields of (e, e'), `crisp` (conventional CMAC) or `gaussian` (direct fuzzy CMAC,
"DFCMAC"). Adapting first keeps the sampled loop stable up to dt = 2/omega,
omega = b sqrt(2 r1 nu |xi|^2); output first is stable only below (B/M)/omega^2, about 10 us.

| symbol | field | unit | published value in SI |
|---|---|---|---|
| c1 | slope | 1/s | 1 |
| r1 | rate | command2 s2/m2 | 10 (printed 0.001, lengths in cm: times 100^2) |
| nu | credit | 1 | CMAC 1/4 (one of four cells, equation (9)); DFCMAC 1 |
| eta | switching_gain | m/s2 | 0.01 (printed 1 cm/s2) |
| theta(0) | weights | A | 0 |
| W | error_width, rate_width | m, m/s | 5 mm, 50 mm/s (chosen) |

The credit nu decides which of the two laws is better: |xi|^2 is 1.768 for the fuzzy law and 4 nu
for the crisp one, and the error falls as 1/(r1 nu |xi|^2). With nu = 1/4 the published order
appears (DFCMAC better by 1/1.768); with equal products the two laws cannot be told apart; with
nu = 1 the crisp CMAC is the better one.
Source: Mao et al., Energies 2021, 14, 7802; order of the two steps, nu and W chosen.
"""

import functools
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxstage.controllers.parts.cmac import Receptive, coordinate, features, gaussian
from jaxstage.controllers.parts.nominal import RigidAxis, authority
from jaxstage.controllers.parts.surface import errors, linear_surface
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import gain, part, pytree, signal
from jaxstage.model.signals import Measurement, Setpoint
from jaxstage.numerics.smooth import Switch, exact


@pytree
class CmacSliding:
    """Gains of the CMAC sliding-mode law, one axis."""

    slope: Array = gain("1/s", "c1", "slope of the sliding surface", above=0.0)
    rate: Array = gain("command2 s2/m2", "r1", "learning rate", low=0.0)
    credit: Array = gain("1", "nu", "share of a correction that each cell takes", above=0.0)
    switching_gain: Array = gain("m/s2", "eta", "switching gain", low=0.0)
    error_width: Array = gain("m", "W_e", "interval of the error", above=0.0, shown="mm")
    rate_width: Array = gain("m/s", "W_v", "interval of its rate", above=0.0, shown="mm/s")
    weights: Array = gain("command", "theta0", "weights at the start", shape="(4, 3, 3)")
    receptive: Any = part("parameters of the receptive fields")
    switch: Any = part("parameters of the switch")
    nominal: RigidAxis = part("what the law assumes about the axis")


@pytree
class CmacMemory:
    """Adapted weights, and the sliding variable."""

    weights: Array = signal("command", "theta", "adapted weights", shape="(4, 3, 3)")
    surface: Array = signal("m/s", "s", "sliding variable", shown="mm/s")


def _init(gains: CmacSliding, setpoint: Setpoint, measurement: Measurement) -> CmacMemory:
    error, rate = errors(setpoint, measurement)
    return CmacMemory(weights=gains.weights, surface=linear_surface(gains.slope, error, rate))


@functools.cache
def cmac_sliding(
    receptive: Receptive = gaussian, switch: Switch = exact
) -> Controller[CmacSliding, CmacMemory]:
    """CMAC sliding-mode law of one axis; gains `CmacSliding`.

    Args:
        receptive: `crisp` (conventional CMAC) or `gaussian` (direct fuzzy CMAC).
        switch: w(s): `exact`, `smooth`, `sat` or `implicit`.

    Returns:
        The controller. Equal arguments give the identical one.
    """

    def control(
        gains: CmacSliding,
        memory: CmacMemory,
        setpoint: Setpoint,
        measurement: Measurement,
        dt: float,
    ) -> tuple[Array, CmacMemory]:
        error, rate = errors(setpoint, measurement)
        surface = linear_surface(gains.slope, error, rate)
        where, xi = features(
            receptive,
            gains.receptive,
            coordinate(error, gains.error_width),
            coordinate(rate, gains.rate_width),
        )
        b = authority(gains.nominal)
        active = memory.weights[where] - 2 * gains.rate * gains.credit * surface * b * xi * dt
        weights = memory.weights.at[where].set(active)
        eta = gains.switching_gain
        switched = eta / b * switch.apply(gains.switch, surface, eta * dt)
        return jnp.sum(xi * active) - switched, CmacMemory(weights=weights, surface=surface)

    return Controller(
        name=f"cmac_sliding[{receptive.name}, {switch.name}]", init=_init, control=control
    )
