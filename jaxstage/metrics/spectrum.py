"""Spectra: periodogram of a command, amplitude spectrum of an error, recorded or online.

Periodogram: how the variance of a command spreads over frequency,

    P_k = 2 |U_k|^2 / M^2,   U_k = sum_j (u_j - mean u) exp(-2 pi i j k / M),   f_k = k / (M dt)

for k = 1 .. (M - 1)/2; the bin at half the sampling rate, if there is one, is not doubled. No
window, so that the bins add up to the population variance. The variance above a frequency is what
remains of it in a command that should be smooth: chattering, noise, quantisation.

Amplitude spectrum: how large the oscillations of a signal are,

    A_k = 2 |sum_j w_j (e_j - mean e) exp(-2 pi i j k / M)| / sum_j w_j

w: periodic Hann window. A sine of a whole number of periods shows its amplitude in its own bin,
and half of it in the two beside it.
"""

import functools

import jax.numpy as jnp
from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments
from jaxstage.metrics.windows import recorded
from jaxstage.model.blocks import Metric
from jaxstage.model.fields import part, pytree, signal
from jaxstage.model.signals import Sample, Setpoint

#: what `high_frequency` sums online; a tick costs a sine and a cosine a bin
MOST_BINS = 2000


def periodogram(values: Array, dt: float) -> tuple[Array, Array]:
    """Frequencies in Hz, (bins,), and P_k, (bins, ...), of samples (M, ...) taken every dt s."""
    count = values.shape[0]
    transform = jnp.fft.rfft(values - jnp.mean(values, axis=0, keepdims=True), axis=0)
    power = 2 * (transform.real**2 + transform.imag**2) / count**2
    if count % 2 == 0:
        power = power.at[-1].divide(2)
    return jnp.arange(power.shape[0], dtype=float) / (count * dt), power


def bins_up_to(cutoff: float, count: int, dt: float) -> int:
    """Number of the last bin at or below a frequency in Hz, rounding forgiven."""
    return min(int(cutoff * count * dt * (1 + 1e-9)), count // 2)


def variance_above(values: Array, dt: float, cutoff: float) -> Array:
    """Variance (...) in the bins above ``cutoff`` Hz of samples (M, ...) taken every dt s."""
    _, power = periodogram(values, dt)
    return jnp.sum(power[bins_up_to(cutoff, values.shape[0], dt) + 1 :], axis=0)


@pytree
class HighFrequency:
    """What the command does above a frequency."""

    command_high_variance: Array = signal(
        "command2", "", "variance above the frequency", shape="(axes,)"
    )


@pytree
class HighFrequencySums:
    """Moments of the command and its transform at the bins up to the frequency."""

    command: Moments = part("moments of the command")
    cosine: Array = signal("command", "", "real part", shape="(bins, axes)")
    sine: Array = signal("command", "", "imaginary part", shape="(bins, axes)")


@functools.cache
def high_frequency(
    cutoff: float, ticks: int, dt: float
) -> Metric[HighFrequencySums, HighFrequency]:
    """`variance_above` of the command without recording it, over exactly ``ticks`` samples.

    The variance less the bins up to ``cutoff`` Hz, whose transforms are summed online. NaN where
    the metric saw another number of samples, where the cutoff is not below half the sampling rate,
    and where there are over `MOST_BINS` bins below it (or 2^31 / ticks): then record the command.
    dt: control period in s. Raises ValueError for a cutoff <= 0.
    """
    if not cutoff > 0:
        raise ValueError(f"cutoff = {cutoff} Hz: must be > 0")
    below = bins_up_to(cutoff, ticks, dt)
    known = below <= MOST_BINS and below * ticks < 2**31 and cutoff < 0.5 / dt
    bins = below if known else 0

    def init(setpoint: Setpoint) -> HighFrequencySums:
        none = jnp.zeros((bins, *setpoint.position.shape), setpoint.position.dtype)
        return HighFrequencySums(command=moments.empty(setpoint.position), cosine=none, sine=none)

    def update(
        acc: HighFrequencySums, sample: Sample, period: float
    ) -> tuple[HighFrequencySums, None]:
        u = sample.command
        # whole turns are taken off as integers, so that the angle keeps its digits; the tick is
        # the same in all runs of a batch, the count of samples may not be
        turn = (jnp.arange(1, bins + 1, dtype=jnp.int32) * (sample.step % ticks)) % ticks
        angle = (2 * jnp.pi / ticks * turn.astype(u.dtype))[:, None]
        return HighFrequencySums(
            command=moments.add(acc.command, u),
            cosine=acc.cosine + jnp.cos(angle) * u[None],
            sine=acc.sine + jnp.sin(angle) * u[None],
        ), None

    def finish(acc: HighFrequencySums) -> HighFrequency:
        power = 2 * (acc.cosine**2 + acc.sine**2) / ticks**2
        above = moments.variance(acc.command) - jnp.sum(power, axis=0)
        whole = known & (acc.command.count == ticks)
        return HighFrequency(command_high_variance=jnp.where(whole, above, jnp.nan))

    return Metric(name="high_frequency", init=init, update=update, finish=finish)


#: Stores the command of every tick, (ticks, axes), for `periodogram`. No report of its own.
recorded_command = recorded("recorded_command", lambda sample: sample.command)


def amplitude_spectrum(values: Array, dt: float) -> tuple[Array, Array]:
    """Frequencies in Hz, (bins,), and A_k, (bins, ...), of samples (M, ...) taken every dt s."""
    count = values.shape[0]
    window = (1 - jnp.cos(2 * jnp.pi * jnp.arange(count, dtype=float) / count)) / 2
    window = window.astype(values.dtype).reshape(-1, *[1] * (values.ndim - 1))
    centred = values - jnp.mean(values, axis=0, keepdims=True)
    amplitude = 2 * jnp.abs(jnp.fft.rfft(window * centred, axis=0)) / jnp.sum(window)
    return jnp.arange(amplitude.shape[0], dtype=float) / (count * dt), amplitude


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
    """The metric of a recorded following error, (ticks, axes) m."""
    return DriveChattering(drive_chattering=chattering_amplitude(error, dt))
