"""Energy over a run or window, summed over the axes."""

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.model.blocks import Metric
from jaxstage.model.fields import pytree, signal
from jaxstage.model.signals import Power, Sample, Setpoint


@pytree
class Energy:
    """Work of each term of the power ledger."""

    energy: Array = signal("J", "E", "drawn from the mains")
    energy_copper: Array = signal("J", "E_cu", "resistive loss")
    energy_mechanical: Array = signal("J", "E_m", "work of the motors, regeneration credited")
    energy_net: Array = signal("J", "E_n", "both together: what a lossless supply would deliver")
    energy_dissipated: Array = signal("J", "E_d", "friction and damping")
    energy_load: Array = signal("J", "E_L", "work against external forces")
    energy_stored: Array = signal("J", "E_s", "gain of kinetic and elastic energy")
    energy_residual: Array = signal(
        "J", "", "mechanical - dissipated - load - stored: what the integration loses or invents"
    )


def _init(setpoint: Setpoint) -> tuple[Power, Array]:
    zero = jnp.zeros_like(setpoint.position)
    return Power(copper=zero, mechanical=zero, dissipated=zero, load=zero, drawn=zero), zero


def _update(
    acc: tuple[Power, Array], sample: Sample, dt: float
) -> tuple[tuple[Power, Array], None]:
    added = (sample.power, sample.storing)
    return jax.tree.map(lambda total, p: total + p * dt, acc, added), None


def _finish(acc: tuple[Power, Array]) -> Energy:
    work, stored = acc
    residual = work.mechanical - work.dissipated - work.load - stored
    return Energy(
        energy=jnp.sum(work.drawn),
        energy_copper=jnp.sum(work.copper),
        energy_mechanical=jnp.sum(work.mechanical),
        energy_net=jnp.sum(work.copper + work.mechanical),
        energy_dissipated=jnp.sum(work.dissipated),
        energy_load=jnp.sum(work.load),
        energy_stored=jnp.sum(stored),
        energy_residual=jnp.sum(residual),
    )


#: Energy in J; report `Energy`.
energy = Metric(name="energy", init=_init, update=_update, finish=_finish)
