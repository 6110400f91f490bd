"""Model-reference adaptive control (MRAC) as an inner loop: the axis behaves like a rigid one.

It adds to the demand u_c of any law what makes y' follow a model of the nominal axis:

    v_m' = b u_c + l (y' - v_m),   v_m(0) = y'(0),   e_m = y' - v_m
    u = u_c + (1/b) sum_i W_i Phi_i,   Phi = (b u_c, y', tanh(y'/w_s), 1)
    W_i' = -g_i e_m Phi_i - sigma W_i,   |W_i| <= W_max,i,   W(0) = 0

Phi stands for a wrong input gain, viscous and dry friction and a constant load. For a rigid axis
y'' = b u - d and sigma = 0, V = e_m^2/2 + sum (W_i - W_i*)^2/(2 g_i) has V' = -l e_m^2. A sample
acts with its W first; then W takes an Euler step and v_m the exact one for held inputs.

| symbol | field | unit |
|---|---|---|
| l | model_rate | 1/s |
| w_s | dry_width | m/s |
| sigma | leak | 1/s |
| g_i | rates | `Rates` |
| W_max,i | limits | `Limits` |
| b | nominal: authority | m/s2 per command |

Leave g_1 = 0 around a law that switches: an input gain that adapts to switching ruins the loop.
Source: in place of the law that Zhang et al., Sensors 2023, 23, 9755, cite without printing it;
equations and proof derived here.
"""

import functools
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxstage.controllers.parts.nominal import RigidAxis, authority
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import gain, part, pytree, replace, signal
from jaxstage.model.signals import Measurement, Setpoint
from jaxstage.numerics.smooth import within


@pytree
class Rates:
    """Adaptation rates of the weights."""

    input: Array = gain("s2/m2", "g1", "adaptation of the input gain", low=0.0)
    viscous: Array = gain("1/m2", "g2", "adaptation of the viscous term", low=0.0)
    dry: Array = gain("1/s2", "g3", "adaptation of the dry friction", low=0.0)
    constant: Array = gain("1/s2", "g4", "adaptation of the constant load", low=0.0)


@pytree
class Limits:
    """Largest magnitude of each weight."""

    input: Array = gain("1", "W1max", "input gain", low=0.0)
    viscous: Array = gain("1/s", "W2max", "viscous term", low=0.0)
    dry: Array = gain("m/s2", "W3max", "dry friction", low=0.0)
    constant: Array = gain("m/s2", "W4max", "constant load", low=0.0)


@pytree
class Weights:
    """Adapted weights of the inner loop."""

    input: Array = signal("1", "W1", "error of the input gain")
    viscous: Array = signal("1/s", "W2", "viscous term")
    dry: Array = signal("m/s2", "W3", "dry friction")
    constant: Array = signal("m/s2", "W4", "constant load")


@pytree
class ModelReference:
    """Gains of the inner loop, and of the law around it."""

    law: Any = part("the law")
    model_rate: Array = gain("1/s", "l", "how fast the model is drawn to the axis", above=0.0)
    dry_width: Array = gain("m/s", "w_s", "speed of the dry friction term", above=0.0, shown="mm/s")
    leak: Array = gain("1/s", "sigma", "forgetting of the weights", low=0.0)
    rates: Rates = part("how fast the weights adapt")
    limits: Limits = part("largest weights")
    nominal: RigidAxis = part("the axis that is imitated")


@pytree
class ModelMemory:
    """Memory of the inner loop, and of the law around it."""

    law: Any = part("memory of the law")
    model: Array = signal("m/s", "v_m", "velocity of the model", shown="mm/s")
    weights: Weights = part("what the inner loop has learned")


def _four(values: Rates | Limits | Weights) -> tuple[Array, Array, Array, Array]:
    return values.input, values.viscous, values.dry, values.constant


def _compensated(
    gains: ModelReference, memory: ModelMemory, law_demand: Array, velocity: Array, dt: float
) -> tuple[Array, Array, Weights]:
    """One sample of the inner loop: the total demand, v_m and W of the next sample."""
    b = authority(gains.nominal)
    dry = jnp.tanh(velocity / gains.dry_width)
    features = (b * law_demand, velocity, dry, jnp.ones_like(velocity))
    weights = _four(memory.weights)
    added = sum(w * phi for w, phi in zip(weights, features, strict=True))
    error = velocity - memory.model
    adapted = [
        within(w - dt * (g * error * phi + gains.leak * w), -most, most)
        for w, g, phi, most in zip(
            weights, _four(gains.rates), features, _four(gains.limits), strict=True
        )
    ]
    old = jnp.exp(-gains.model_rate * dt)
    model = old * memory.model + (1 - old) * (velocity + b * law_demand / gains.model_rate)
    learned = Weights(input=adapted[0], viscous=adapted[1], dry=adapted[2], constant=adapted[3])
    return law_demand + added / b, model, learned


@functools.cache
def model_reference(law: Controller) -> Controller[ModelReference, ModelMemory]:
    """A law around the adaptive inner loop; gains `ModelReference`.

    Args:
        law: of one axis or several; the total demand and command reach its ``settle``.

    Returns:
        The law with its inner loop, for as many axes. Its ``longest_period`` is that of the law
        and at most 2 / sigma.
    """

    def init(gains: ModelReference, setpoint: Setpoint, measurement: Measurement) -> ModelMemory:
        none = jnp.zeros_like(measurement.velocity)
        return ModelMemory(
            law=law.init(gains.law, setpoint, measurement),
            model=measurement.velocity,
            weights=Weights(input=none, viscous=none, dry=none, constant=none),
        )

    def control(
        gains: ModelReference,
        memory: ModelMemory,
        setpoint: Setpoint,
        measurement: Measurement,
        dt: float,
    ) -> tuple[Array, ModelMemory]:
        law_demand, kept = law.control(gains.law, memory.law, setpoint, measurement, dt)
        demand, model, weights = _compensated(gains, memory, law_demand, measurement.velocity, dt)
        return demand, ModelMemory(law=kept, model=model, weights=weights)

    def settle(
        gains: ModelReference, memory: ModelMemory, demand: Array, command: Array, dt: float
    ) -> ModelMemory:
        return replace(memory, law=law.settle(gains.law, memory.law, demand, command, dt))

    def longest_period(gains: ModelReference) -> Array:
        # that of the law, and 2 / sigma of the weights
        forgets = gains.leak > 0
        weights = jnp.where(forgets, 2 / jnp.where(forgets, gains.leak, 1), jnp.inf)
        return jnp.minimum(jnp.min(weights), jnp.min(jnp.asarray(law.longest_period(gains.law))))

    return Controller(
        name=f"model_reference[{law.name}]",
        init=init,
        control=control,
        settle=settle,
        longest_period=longest_period,
    )
