"""First-order filters."""

import jax.numpy as jnp
from jax import Array


def low_pass_weight(bandwidth: Array, dt: float) -> Array:
    """Weight of a first-order low-pass: w = 1 - exp(-2 pi f dt) of y <- y + w (x - y).

    Args:
        bandwidth: f in Hz; inf gives 1.
        dt: time between samples in s.
    """
    return -jnp.expm1(-2 * jnp.pi * bandwidth * dt)
