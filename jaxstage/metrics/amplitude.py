"""What is left of a recorded error at high frequency: its amplitude spectrum.

    A_k = 2 |sum_j w_j (e_j - mean e) exp(-2 pi i j k / M)| / sum_j w_j,   f_k = k / (M dt)

w: periodic Hann window. A sine of a whole number of periods shows its amplitude in its own bin,
and half of it in the two beside it. For a power that adds up to the variance see `spectrum`.
"""

import jax.numpy as jnp
from jax import Array

from jaxstage.model.fields import pytree, signal


def amplitude_spectrum(values: Array, dt: float) -> tuple[Array, Array]:
    """Frequencies in Hz, (bins,), and A_k, (bins, ...), of samples (M, ...) taken every dt s."""
    count = values.shape[0]
    window = (1 - jnp.cos(2 * jnp.pi * jnp.arange(count) / count)) / 2
    window = window.astype(values.dtype).reshape(-1, *[1] * (values.ndim - 1))
    centred = values - jnp.mean(values, axis=0, keepdims=True)
    amplitude = 2 * jnp.abs(jnp.fft.rfft(window * centred, axis=0)) / jnp.sum(window)
    return jnp.arange(amplitude.shape[0]) / (count * dt), amplitude


def chattering_amplitude(values: Array, dt: float, above: float = 50.0) -> Array:
    """Largest amplitude (...) at or above a frequency in Hz, of samples (M, ...) every dt s.

    Where nothing chatters, the bins just above the frequency belong to the spikes of reversals.
    NaN where the samples have no such bin.
    """
    frequency, amplitude = amplitude_spectrum(values, dt)
    high = (frequency >= above).reshape(-1, *[1] * (values.ndim - 1))
    largest = jnp.max(jnp.where(high, amplitude, 0), axis=0)
    return jnp.where(jnp.any(high), largest, jnp.nan)


@pytree
class DriveChattering:
    """What the drives do at high frequency."""

    drive_chattering: Array = signal(
        "m", "", "largest amplitude of the following error from 50 Hz", shape="(axes,)", shown="um"
    )


def drive_chattering(error: Array, dt: float) -> DriveChattering:
    """The figure of a recorded following error, (ticks, axes) m."""
    return DriveChattering(drive_chattering=chattering_amplitude(error, dt))
