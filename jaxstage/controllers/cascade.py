"""P-PI cascade, the industrial baseline: a position loop around a velocity loop, feed-forward.

    v_ref = k_p e + k_v r',   e_v = v_ref - y',   I <- I + e_v dt
    u = [ k_s e_v + k_i I + k_a r'' ] / b + { k_f [ B r' + F_c tanh(r'/w) ] + k_l F_L } / K_t

| symbol | field | unit |
|---|---|---|
| k_p | position_gain ("Kv factor") | 1/s |
| k_s | velocity_gain | 1/s |
| k_i | integral_gain | 1/s2 |
| k_v, k_a, k_f, k_l | velocity, acceleration, friction, load feed-forward: 0 off, 1 full | 1 |
| w | friction_width | m/s |

Anti-windup by back-calculation: what the drive cuts off is taken out of I. By hand, inner loop
first: k_s a few tenths of 1/dt, k_i about k_s^2/16, k_p about k_s/6, all feed-forward on.
"""

import jax.numpy as jnp
from jax import Array

from jaxstage.controllers.parts.nominal import RigidAxis, authority
from jaxstage.controllers.parts.surface import errors
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import gain, part, pytree, signal
from jaxstage.model.signals import Measurement, Setpoint


@pytree
class Cascade:
    """Gains of the P-PI cascade, one axis."""

    position_gain: Array = gain("1/s", "k_p", "position loop", low=0.0)
    velocity_gain: Array = gain("1/s", "k_s", "velocity loop", above=0.0)
    integral_gain: Array = gain("1/s2", "k_i", "integral of the velocity loop", low=0.0)
    velocity_feedforward: Array = gain("1", "k_v", "velocity feed-forward", low=0.0)
    acceleration_feedforward: Array = gain("1", "k_a", "acceleration feed-forward", low=0.0)
    friction_feedforward: Array = gain("1", "k_f", "friction feed-forward", low=0.0)
    load_feedforward: Array = gain("1", "k_l", "constant load, e.g. weight", low=0.0)
    friction_width: Array = gain(
        "m/s", "w", "speed over which the friction is blended in", above=0.0, shown="mm/s"
    )
    nominal: RigidAxis = part("what the law assumes about the axis")


@pytree
class CascadeMemory:
    """Integral of the velocity error."""

    integral: Array = signal("m", "I", "integral of the velocity error")


def _init(gains: Cascade, setpoint: Setpoint, measurement: Measurement) -> CascadeMemory:
    return CascadeMemory(integral=jnp.zeros_like(measurement.position))


def _control(
    gains: Cascade, memory: CascadeMemory, setpoint: Setpoint, measurement: Measurement, dt: float
) -> tuple[Array, CascadeMemory]:
    error, _ = errors(setpoint, measurement)
    commanded = gains.position_gain * error + gains.velocity_feedforward * setpoint.velocity
    lag = commanded - measurement.velocity
    integral = memory.integral + lag * dt
    axis = gains.nominal
    acceleration = (
        gains.velocity_gain * lag
        + gains.integral_gain * integral
        + gains.acceleration_feedforward * setpoint.acceleration
    )
    dry = axis.coulomb * jnp.tanh(setpoint.velocity / gains.friction_width)
    resistance = gains.friction_feedforward * (axis.damping * setpoint.velocity + dry)
    known = (resistance + gains.load_feedforward * axis.load) / axis.force_constant
    return acceleration / authority(axis) + known, CascadeMemory(integral=integral)


def _settle(
    gains: Cascade, memory: CascadeMemory, demand: Array, command: Array, dt: float
) -> CascadeMemory:
    """Back-calculation, I <- I + dt b (command - demand) / (k_s + k_i dt).

    That is the velocity error which would have met the limit of the drive.
    """
    stiffness = gains.velocity_gain + gains.integral_gain * dt
    cut = authority(gains.nominal) * (command - demand) / stiffness
    return CascadeMemory(integral=memory.integral + dt * cut)


#: The law for one axis; gains `Cascade`.
cascade = Controller(name="cascade", init=_init, control=_control, settle=_settle)
