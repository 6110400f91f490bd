"""Disturbance observer: estimates the acceleration that the nominal model leaves unexplained.

    d^' = k1 (w^ - v)
    w^' = a_n u - (B v + F_L)/M_n - d^ - k2 (w^ - v),   w^(0) = v(0), d^(0) = 0
    u_obs = d^ / a_n,   a_n = K_t / M_n

u_obs cancels the estimate. `plus(law, per_axis(disturbance_observer))` puts it around any law. u is
the total command, after coupling and limits; told less, the observer would take the rest for a
disturbance.

| symbol | field | unit |
|---|---|---|
| k1 | disturbance_gain | 1/s2 |
| k2 | velocity_gain | 1/s |
| d^, w^ | `Estimate` | m/s2, m/s |
| v | seen | m/s |

d^/d = k1 / (p^2 + k2 p + k1), so it is stable iff k1 > 0 and k2 > 0, and as sampled, by forward
Euler, for control periods below 2/|p| (real poles) or k2/k1 (complex ones). An estimate of a
varying disturbance has a bounded error, not none: |d - d^|/|d| = |p (p + k2)| / |p^2 + k2 p + k1|.

Source: Science Progress 2021, doi:10.1177/00368504211011847, in words; equations after J. Liu's
observer for sliding mode control, derived here. Known damping and load of the axis are part of the
model, so that a law that feeds them forward does not do so twice.
"""

import jax.numpy as jnp
from jax import Array

from jaxstage.controllers.parts.nominal import RigidAxis, authority, drift
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import gain, part, pytree, replace, signal
from jaxstage.model.signals import Measurement, Setpoint
from jaxstage.numerics.integrate import shifted
from jaxstage.numerics.smooth import positive


@pytree
class DisturbanceObserver:
    """Gains of the disturbance observer, one axis."""

    disturbance_gain: Array = gain("1/s2", "k1", "gain on the disturbance", above=0.0)
    velocity_gain: Array = gain("1/s", "k2", "gain on the velocity", above=0.0)
    nominal: RigidAxis = part("what the observer assumes about the axis")


@pytree
class Estimate:
    """State of the observer."""

    disturbance: Array = signal("m/s2", "d^", "estimated disturbance")
    velocity: Array = signal("m/s", "w^", "estimated velocity", shown="mm/s")


@pytree
class ObserverMemory:
    """State of the observer, and the velocity last measured."""

    estimate: Estimate = part("what the observer integrates")
    seen: Array = signal("m/s", "v", "measured velocity", shown="mm/s")


def rate(gains: DisturbanceObserver, memory: ObserverMemory, command: Array) -> Estimate:
    """State derivative of the observer, (d^', w^'), at the velocity in the memory.

    Args:
        gains: those of one axis.
        memory: after ``control`` of the sample.
        command: u, the total command of the axis, in command units.

    Returns:
        d^' in m/s3 and w^' in m/s2, in the fields of an `Estimate`.
    """
    estimate, axis = memory.estimate, gains.nominal
    off = estimate.velocity - memory.seen
    modelled = authority(axis) * command + drift(axis, memory.seen)
    return Estimate(
        disturbance=gains.disturbance_gain * off,
        velocity=modelled - estimate.disturbance - gains.velocity_gain * off,
    )


def longest_period(gains: DisturbanceObserver) -> Array:
    """Stability limit of the sampled observer: the longest control period in s.

    Forward Euler of p^2 + k2 p + k1: 4 / (k2 + sqrt(k2^2 - 4 k1)) for real poles, k2 / k1 for
    complex ones. Elementwise in the gains.
    """
    k1, k2 = gains.disturbance_gain, gains.velocity_gain
    square = positive(k2**2 - 4 * k1)
    real = square > 0
    root = jnp.sqrt(jnp.where(real, square, 1))
    return jnp.where(real, 4 / (k2 + root), k2 / k1)


def _init(gains: DisturbanceObserver, setpoint: Setpoint, seen: Measurement) -> ObserverMemory:
    none = jnp.zeros_like(seen.velocity)
    return ObserverMemory(
        estimate=Estimate(disturbance=none, velocity=seen.velocity), seen=seen.velocity
    )


def _control(
    gains: DisturbanceObserver,
    memory: ObserverMemory,
    setpoint: Setpoint,
    seen: Measurement,
    dt: float,
) -> tuple[Array, ObserverMemory]:
    demand = memory.estimate.disturbance / authority(gains.nominal)
    return demand, replace(memory, seen=seen.velocity)


def _settle(
    gains: DisturbanceObserver, memory: ObserverMemory, demand: Array, command: Array, dt: float
) -> ObserverMemory:
    slope = rate(gains, memory, command)
    return replace(memory, estimate=shifted(memory.estimate, slope, dt))


#: The observer for one axis; gains `DisturbanceObserver`.
disturbance_observer = Controller(
    name="disturbance_observer",
    init=_init,
    control=_control,
    settle=_settle,
    longest_period=longest_period,
)
