"""What a law assumes about its axis. Not tuned, and not changed when the true plant changes."""

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
    """b = K_t / M: acceleration per command, m/s2 per command unit."""
    return nominal.force_constant / nominal.mass


def drift(nominal: RigidAxis, velocity: Array) -> Array:
    """f = -(B v + F_L) / M in m/s2: what the axis does without command and dry friction."""
    return -(nominal.damping * velocity + nominal.load) / nominal.mass
