"""Spectrum of a command, recorded and online, and the error between the samples."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.metrics import between, high_frequency, periodogram, variance_above, windowed
from jaxstage.model.signals import Output, Setpoint

DT, COUNT = 5e-3, 400
TIME = np.arange(COUNT) * DT
RNG = np.random.default_rng(0)
NOISE = RNG.normal(size=(COUNT, 2))


def sines():
    """3 V at 5 Hz and 0.5 V at 40 Hz; 2 V at 12 Hz with an offset; whole periods."""
    x = 3 * np.sin(2 * np.pi * 5 * TIME) + 0.5 * np.cos(2 * np.pi * 40 * TIME + 1)
    return np.stack([x, 7 + 2 * np.cos(2 * np.pi * 12 * TIME)], axis=1)


@pytest.mark.fast
def test_a_sine_is_in_its_bin():
    frequency, power = periodogram(jnp.asarray(sines()), DT)
    for hz, axis, amplitude in ((5, 0, 3.0), (40, 0, 0.5), (12, 1, 2.0)):
        np.testing.assert_allclose(power[np.argmin(np.abs(frequency - hz)), axis], amplitude**2 / 2)
    assert frequency[-1] == 0.5 / DT


@pytest.mark.fast
@pytest.mark.parametrize("count", [COUNT, COUNT - 1], ids=["even", "odd"])
def test_bins_add_up_to_the_variance(count):
    _, power = periodogram(jnp.asarray(NOISE[:count]), DT)
    np.testing.assert_allclose(np.sum(power, axis=0), np.var(NOISE[:count], axis=0), rtol=1e-12)
    np.testing.assert_allclose(power[0], 0, atol=1e-30)


@pytest.mark.fast
def test_variance_above():
    """The bin at the frequency itself is left out, although 20 Hz * M dt rounds to 40.000...01."""
    command = jnp.asarray(sines())
    np.testing.assert_allclose(variance_above(command, DT, 20.0), [0.125, 0.0], atol=1e-13)
    np.testing.assert_allclose(variance_above(command, DT, 40.0), [0.0, 0.0], atol=1e-13)
    np.testing.assert_allclose(variance_above(command, DT, 39.9), [0.125, 0.0], atol=1e-13)
    np.testing.assert_allclose(variance_above(command, DT, 11.0), [0.125, 2.0], rtol=1e-12)


def sample(step, command):
    return types.SimpleNamespace(step=step, command=command)


def first():
    two = jnp.zeros(2)
    return Setpoint(
        position=two, velocity=two, acceleration=two, tangent=two, curvature=jnp.zeros(())
    )


def online(metric, values, begin=0):
    """Report of a metric that saw ``values`` from tick ``begin`` on."""

    def update(acc, row):
        return metric.update(acc, sample(*row), DT)[0], None

    rows = (jnp.arange(len(values), dtype=jnp.int32) + begin, jnp.asarray(values))
    return metric.finish(jax.lax.scan(update, metric.init(first()), rows)[0])


@pytest.mark.parametrize("cutoff", [20.0, 99.7])
def test_online_is_exact(cutoff):
    metric = high_frequency(cutoff, 380, DT)
    for begin, values in ((0, NOISE[:380]), (17, NOISE[20:])):
        got = online(metric, values, begin).command_high_variance
        expected = variance_above(jnp.asarray(values), DT, cutoff)
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-13)


def test_online_within_a_window():
    got = online(windowed(high_frequency(20.0, 380, DT), 20, 400), NOISE).command_high_variance
    np.testing.assert_allclose(got, variance_above(jnp.asarray(NOISE[20:]), DT, 20.0), rtol=1e-9)


def test_online_where_it_cannot_know():
    """Another number of samples; a frequency that is not sampled; too many bins."""
    for metric in (
        high_frequency(20.0, 380, DT),
        high_frequency(100.0, COUNT, DT),
        high_frequency(20.0, 10**6, DT),
    ):
        assert np.isnan(online(metric, NOISE).command_high_variance).all()
    with pytest.raises(ValueError, match="cutoff = 0"):
        high_frequency(0.0, 380, DT)


@pytest.mark.fast
def test_error_between_the_samples():
    """max over samples and substeps of |r + r' tau + r'' tau^2/2 - x|."""
    substeps = 4
    tau = DT * np.arange(1, substeps + 1) / substeps
    wanted = first()
    wanted = Setpoint(
        position=jnp.array([1e-3, 2e-3]), velocity=jnp.array([0.1, -0.2]),
        acceleration=jnp.array([3.0, -4.0]), tangent=wanted.tangent, curvature=wanted.curvature,
    )  # fmt: skip
    off = 1e-6 * np.array([[1, 0], [-5, 0], [2, 0], [1, 0.5]])
    carried = (
        np.array([1e-3, 2e-3]) + np.array([0.1, -0.2]) * tau[:, None]
        + np.array([3.0, -4.0]) * tau[:, None] ** 2 / 2
    )  # fmt: skip
    inside = jnp.asarray(carried - off)

    def tick(error):
        zero, at = jnp.zeros(2), wanted.position - jnp.asarray(error)
        return types.SimpleNamespace(
            setpoint=wanted,
            output=Output(position=at, velocity=zero, drive_position=at, drive_velocity=zero),
            between=Output(
                position=inside, velocity=inside, drive_position=inside, drive_velocity=inside
            ),
        )

    acc = between.init(wanted)
    assert np.isnan(between.finish(acc).following_max_between).all()
    acc, _ = between.update(acc, tick([0.0, -7e-6]), DT)
    np.testing.assert_allclose(between.finish(acc).following_max_between, [5e-6, 7e-6], rtol=1e-9)
    acc, _ = between.update(acc, tick([6e-6, 0.0]), DT)
    np.testing.assert_allclose(between.finish(acc).following_max_between, [6e-6, 7e-6], rtol=1e-9)
