"""Nominal model of an axis: what a law assumes, whatever the true plant is. It is not tuned."""

from jax import Array

from jaxstage.model.fields import known, pytree


@pytree
class RigidAxis:
    """Nominal rigid axis M v' = K_t u - B v - F_L - F_c sgn v."""

    force_constant: Array = known("N/command", "K_t", "assumed motor force per command", above=0.0)
    mass: Array = known("kg", "M", "assumed mass", above=0.0)
    damping: Array = known("N s/m", "B", "assumed viscous damping", low=0.0)
    coulomb: Array = known("N", "F_c", "assumed dry friction", low=0.0)
    load: Array = known("N", "F_L", "assumed constant load, positive against +x")


def authority(nominal: RigidAxis) -> Array:
    """Input gain b = K_t / M: acceleration per command, m/s2 per command unit."""
    return nominal.force_constant / nominal.mass


def drift(nominal: RigidAxis, velocity: Array) -> Array:
    """Drift f = -(B v + F_L) / M in m/s2: the acceleration without command and dry friction.

    Args:
        nominal: the axis.
        velocity: v, m/s.
    """
    return -(nominal.damping * velocity + nominal.load) / nominal.mass
