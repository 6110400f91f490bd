"""Adaptive sliding mode: slope, switching gain and sharpness of a smooth switch adapt.

    e = r - y,   s = c e + e',   phi = 2/(1 + exp(-a s)) - 1 = tanh(a s/2)          (5), (11)
    u = (1/b) (r'' + c e' + eps phi)                                                     (12)
    eps' = g_eps e q phi,   a' = g_a e q s,   c' = g_c s e'                  (16), (17), (25)

Each adapts by forward Euler from the values of a sample, used from the next one on, and is kept in
its range. With the three rates 0 it is the fixed sigmoid law, `sliding` with the `smooth` switch of
width 2/a.

| symbol | field | unit | published value, angles in rad |
|---|---|---|---|
| c(0), eps(0), a(0) | slope, switching_gain, sharpness | 1/s, m/s2, s/m | 250, 230, 50 |
| g_c, g_eps, g_a | slope_rate, switching_rate, sharpness_rate | 1/m2, 1/s3, s/m3 | 3000, 500, 10 |
| their ranges | *_least, *_most | | chosen |
| q | the `InputSign` the law was made with | 1 | sgn(theta u) |
| b | nominal: authority | m/s2 per command | 1/J |

The integral of c' is c e^2/2 + int e'^2 dt: c never stops rising, and with a quantised velocity it
rises fast, so that a cap is needed. eps and a rise whenever e s > 0 and have no equilibrium either.
Sampled, a stiff switch oscillates at half the sampling rate once `sampled_gain` passes 2 M_1/M, M_1
the mass that answers at once (the motor) and M the whole one.
Source: Zhang et al., Sensors 2023, 23, 9755, equations (4)-(25); ranges chosen.
"""

import functools

import jax.numpy as jnp
from jax import Array

from jaxstage.controllers.parts.input_sign import Exchange, InputSign, forward
from jaxstage.controllers.parts.nominal import RigidAxis, authority
from jaxstage.controllers.parts.surface import errors
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import gain, part, pytree, replace, signal
from jaxstage.model.signals import Measurement, Setpoint
from jaxstage.numerics.smooth import within


@pytree
class AdaptiveSliding:
    """Gains of the adaptive sliding-mode law, one axis."""

    slope: Array = gain("1/s", "c0", "slope of the surface at the start", above=0.0)
    slope_rate: Array = gain("1/m2", "g_c", "adaptation of the slope", low=0.0)
    slope_least: Array = gain("1/s", "c_min", "least slope", above=0.0)
    slope_most: Array = gain("1/s", "c_max", "largest slope", at_least="slope_least")
    switching_gain: Array = gain("m/s2", "eps0", "switching gain at the start", low=0.0)
    switching_rate: Array = gain("1/s3", "g_eps", "adaptation of the switching gain", low=0.0)
    switching_least: Array = gain("m/s2", "eps_min", "least switching gain", low=0.0)
    switching_most: Array = gain(
        "m/s2", "eps_max", "largest switching gain", at_least="switching_least"
    )
    sharpness: Array = gain("s/m", "a0", "sharpness of the switch at the start", above=0.0)
    sharpness_rate: Array = gain("s/m3", "g_a", "adaptation of the sharpness", low=0.0)
    sharpness_least: Array = gain("s/m", "a_min", "least sharpness", above=0.0)
    sharpness_most: Array = gain("s/m", "a_max", "largest sharpness", at_least="sharpness_least")
    nominal: RigidAxis = part("what the law assumes about the axis")


@pytree
class AdaptiveMemory:
    """Adapted parameters, and the sample that they adapt to."""

    slope: Array = signal("1/s", "c", "slope of the surface")
    switching_gain: Array = signal("m/s2", "eps", "switching gain")
    sharpness: Array = signal("s/m", "a", "sharpness of the switch")
    surface: Array = signal("m/s", "s", "sliding variable", shown="mm/s")
    error: Array = signal("m", "e", "following error", shown="um")
    rate: Array = signal("m/s", "e'", "its rate", shown="mm/s")
    exchange: Exchange = part("what the axis was told and did")


def switch(sharpness: Array, surface: Array) -> Array:
    """Sigmoid switching function phi(s) = tanh(a s/2): equation (11) without its overflow.

    Args:
        sharpness: a, () s/m.
        surface: s, () m/s.

    Returns:
        phi in (-1, 1), ().
    """
    return jnp.tanh(sharpness * surface / 2)


def sampled_gain(slope: Array, switching_gain: Array, sharpness: Array, dt: float) -> Array:
    """Loop gain of the sampled switch, eps a T/2 + c T: the change of s in one period, per s.

    It holds for a rigid axis, near s = 0, where phi has the slope a/2.

    Args:
        slope: c, 1/s.
        switching_gain: eps, m/s2.
        sharpness: a, s/m.
        dt: T, control period in s.

    Returns:
        The gain, dimensionless; 1 is dead-beat, 2 the limit of stability.
    """
    return switching_gain * sharpness * dt / 2 + slope * dt


def _init(gains: AdaptiveSliding, setpoint: Setpoint, measurement: Measurement) -> AdaptiveMemory:
    error, rate = errors(setpoint, measurement)
    none = jnp.zeros_like(measurement.position)
    exchange = Exchange(
        position=measurement.position,
        velocity=measurement.velocity,
        command=none,
        last_position=measurement.position,
        last_command=none,
    )
    return AdaptiveMemory(
        slope=jnp.broadcast_to(gains.slope, none.shape),
        switching_gain=jnp.broadcast_to(gains.switching_gain, none.shape),
        sharpness=jnp.broadcast_to(gains.sharpness, none.shape),
        surface=gains.slope * error + rate,
        error=error,
        rate=rate,
        exchange=exchange,
    )


def _control(
    gains: AdaptiveSliding,
    memory: AdaptiveMemory,
    setpoint: Setpoint,
    measurement: Measurement,
    dt: float,
) -> tuple[Array, AdaptiveMemory]:
    error, rate = errors(setpoint, measurement)
    surface = memory.slope * error + rate
    switched = memory.switching_gain * switch(memory.sharpness, surface)
    acceleration = setpoint.acceleration + memory.slope * rate + switched
    exchange = memory.exchange.seen_next(measurement)
    memory = replace(memory, surface=surface, error=error, rate=rate, exchange=exchange)
    return acceleration / authority(gains.nominal), memory


@functools.cache
def adaptive_sliding(
    input_sign: InputSign = forward,
) -> Controller[AdaptiveSliding, AdaptiveMemory]:
    """Adaptive sliding-mode law of one axis; gains `AdaptiveSliding`.

    Args:
        input_sign: the reading of q: `forward`, `position_input`, `moving` or `difference`.

    Returns:
        The controller. Equal arguments give the identical one.
    """

    def settle(
        gains: AdaptiveSliding, memory: AdaptiveMemory, demand: Array, command: Array, dt: float
    ) -> AdaptiveMemory:
        exchange = replace(memory.exchange, command=command)
        drive = dt * memory.error * input_sign.of(exchange)
        slope = memory.slope + dt * gains.slope_rate * memory.surface * memory.rate
        gain = memory.switching_gain + gains.switching_rate * drive * switch(
            memory.sharpness, memory.surface
        )
        sharpness = memory.sharpness + gains.sharpness_rate * drive * memory.surface
        return replace(
            memory,
            slope=within(slope, gains.slope_least, gains.slope_most),
            switching_gain=within(gain, gains.switching_least, gains.switching_most),
            sharpness=within(sharpness, gains.sharpness_least, gains.sharpness_most),
            exchange=exchange,
        )

    return Controller(
        name=f"adaptive_sliding[{input_sign.name}]", init=_init, control=_control, settle=settle
    )
