"""Energy over a run or window, summed over the axes."""

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.blocks import Metric
from jaxstage.fields import pytree, signal
from jaxstage.signals import Power, Sample, Setpoint


@pytree
class Energy:
    """Work of each term of the power ledger."""

    energy: Array = signal("J", "E", "drawn from the mains")
    energy_copper: Array = signal("J", "E_cu", "resistive loss")
    energy_mechanical: Array = signal("J", "E_m", "work of the motors, regeneration credited")
    energy_net: Array = signal("J", "E_n", "both together: what a lossless supply would deliver")
    energy_dissipated: Array = signal("J", "E_d", "friction and damping")
    energy_load: Array = signal("J", "E_L", "work against external forces")


def _init(setpoint: Setpoint) -> Power:
    zero = jnp.zeros_like(setpoint.position)
    return Power(copper=zero, mechanical=zero, dissipated=zero, load=zero, drawn=zero)


def _update(acc: Power, sample: Sample, dt: float) -> tuple[Power, None]:
    return jax.tree.map(lambda total, p: total + p * dt, acc, sample.power), None


def _finish(acc: Power) -> Energy:
    return Energy(
        energy=jnp.sum(acc.drawn),
        energy_copper=jnp.sum(acc.copper),
        energy_mechanical=jnp.sum(acc.mechanical),
        energy_net=jnp.sum(acc.copper + acc.mechanical),
        energy_dissipated=jnp.sum(acc.dissipated),
        energy_load=jnp.sum(acc.load),
    )


#: Energy in J; report `Energy`.
energy = Metric(name="energy", init=_init, update=_update, finish=_finish)
