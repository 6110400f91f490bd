"""How the variance of a command spreads over frequency: exact, recorded or online.

    P_k = 2 |U_k|^2 / M^2,   U_k = sum_j (u_j - mean u) exp(-2 pi i j k / M),   f_k = k / (M dt)

for k = 1 .. (M - 1)/2; the bin at half the sampling rate, if there is one, is not doubled. No
window, so that the bins add up to the population variance. The variance above a frequency is what
remains of it in a command that should be smooth: chattering, noise, quantisation.
"""

import functools

import jax.numpy as jnp
from jax import Array

from jaxstage.metrics import moments
from jaxstage.metrics.moments import Moments
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
    return jnp.arange(power.shape[0]) / (count * dt), power


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
def high_frequency(cutoff: float, ticks: int, dt: float) -> Metric:
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
recorded_command = Metric(
    name="recorded_command",
    init=lambda setpoint: (),
    update=lambda acc, sample, dt: (acc, sample.command),
    finish=lambda acc: None,
)
