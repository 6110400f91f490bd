"""First-order filters."""

import jax.numpy as jnp
from jax import Array


def low_pass_weight(bandwidth: Array, dt: float) -> Array:
    """w = 1 - exp(-2 pi f dt) of y <- y + w (x - y); f in Hz, inf gives 1."""
    return -jnp.expm1(-2 * jnp.pi * bandwidth * dt)
