"""Metrics on signals whose figures are known in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxstage as js
from jaxstage import metrics
from jaxstage.metrics import glitch, moments
from jaxstage.plants import pmsm_table
from jaxstage.simulate.rollout import replay

DT = 1e-3
N = 1000
T = np.arange(N) * DT


def samples(error, command=None, velocity=None, distance=None, power=None, demand=None):
    """Recorded samples with a given following error (n, 2) and, if asked, other signals."""
    error = np.asarray(error, float)
    zero = np.zeros_like(error)
    command = zero if command is None else np.asarray(command, float)
    velocity = zero if velocity is None else np.asarray(velocity, float)
    tangent = np.broadcast_to([1.0, 0.0], error.shape)
    count = len(error)
    setpoint = js.Setpoint(
        position=zero, velocity=velocity, acceleration=zero, tangent=tangent,
        curvature=np.zeros(count),
    )  # fmt: skip
    output = js.Output(position=-error, velocity=zero, drive_position=-error, drive_velocity=zero)
    seen = js.Measurement(
        position=-error, velocity=zero, drive_position=-error, drive_velocity=zero
    )
    distance = np.abs(error[:, 1]) if distance is None else distance
    nothing = js.Power(copper=zero, mechanical=zero, dissipated=zero, load=zero, drawn=zero)
    sample = js.Sample(
        step=np.arange(count), time=np.arange(count) * DT, setpoint=setpoint, output=output,
        nearest=js.Nearest(
            point=zero, distance=distance, arc=np.zeros(count), reach=np.full(count, 1.0)
        ),
        between=output,
        measurement=seen, memory=(), demand=command if demand is None else demand,
        command=command, applied=command, load=zero, power=power or nothing, storing=zero,
    )  # fmt: skip
    return jax.tree.map(jnp.asarray, sample)


def report(metric, rows):
    return replay(metric, rows, DT)[0]


@pytest.mark.fast
def test_ate_and_tesd_of_a_sine():
    """E = |A sin| : mean 2A/pi, standard deviation A sqrt(1/2 - 4/pi^2)."""
    wave = 3e-5 * np.sin(2 * np.pi * 5 * (np.arange(N) + 0.5) * DT)
    got = report(metrics.tracking, samples(np.stack([0.6 * wave, 0.8 * wave], 1)))
    np.testing.assert_allclose(got.ate, 3e-5 * 2 / np.pi, rtol=1e-4)
    np.testing.assert_allclose(got.tesd, 3e-5 * np.sqrt(0.5 - 4 / np.pi**2), rtol=1e-3)


def test_following_error_of_each_axis():
    error = np.stack([np.full(N, -2e-6), 1e-6 * np.sin(2 * np.pi * 10 * T)], 1)
    got = report(metrics.following, samples(error))
    np.testing.assert_allclose(got.following_rms, [2e-6, 1e-6 / np.sqrt(2)], rtol=1e-9)
    np.testing.assert_allclose(got.following_mean[0], 2e-6, rtol=1e-12)
    np.testing.assert_allclose(got.following_max, [2e-6, 1e-6], rtol=1e-9)


def test_contour_error_and_its_tangent_estimate():
    error = np.stack([np.full(N, 5e-6), np.linspace(-1e-6, 1e-6, N)], 1)
    got = report(metrics.contour, samples(error, distance=np.full(N, 7e-6)))
    np.testing.assert_allclose([got.contour_rms, got.contour_mean, got.contour_max], 7e-6)
    estimate = report(metrics.tangent_contour, samples(error))
    np.testing.assert_allclose(estimate.contour_tangent_max, 1e-6)
    np.testing.assert_allclose(estimate.contour_tangent_mean, np.abs(error[:, 1]).mean())


def test_command_variance_and_variation():
    ramp = np.stack([np.linspace(0, 2, N), np.tile([1.0, -1.0], N // 2)], 1)
    got = report(metrics.effort(), samples(np.zeros((N, 2)), command=ramp))
    np.testing.assert_allclose(got.command_variance, ramp.var(axis=0), rtol=1e-12)
    seconds = (N - 1) * DT
    np.testing.assert_allclose(got.command_variation, [2 / seconds, 2 / DT], rtol=1e-12)
    np.testing.assert_allclose(got.command_rms, np.sqrt((ramp**2).mean(axis=0)), rtol=1e-12)
    np.testing.assert_allclose(got.command_max, [2, 1])


def test_chattering_sees_switching_and_not_slow_motion():
    slow = 2 * np.sin(2 * np.pi * T)
    switching = np.tile([0.01, -0.01], N // 2)
    got = report(
        metrics.effort(), samples(np.zeros((N, 2)), np.stack([slow, slow + switching], 1))
    ).chattering
    assert got[0] < 0.03 * 2 / np.sqrt(2)
    alone = report(
        metrics.effort(), samples(np.zeros((N, 2)), np.stack([0 * slow, switching], 1))
    ).chattering
    assert alone[0] == 0
    weight = 1 - np.exp(-2 * np.pi * 100 * DT)
    at_nyquist = 2 * (1 - weight) / (2 - weight)  # gain of the high-pass at half the sampling rate
    np.testing.assert_allclose(alone[1], 0.01 * at_nyquist, rtol=0.02)


def test_saturated_share():
    demand = np.stack([np.linspace(-2, 2, N), np.zeros(N)], 1)
    got = report(
        metrics.saturation,
        samples(np.zeros((N, 2)), command=np.clip(demand, -1, 1), demand=demand),
    )
    np.testing.assert_allclose(got.saturated_share, [0.5, 0.0], atol=2e-3)


def test_energy_sums_each_term_over_time_and_axes():
    one = np.ones((N, 2))
    power = js.Power(
        copper=one * [1, 2], mechanical=-one, dissipated=0.5 * one, load=0 * one, drawn=4 * one
    )
    got = report(metrics.energy, samples(np.zeros((N, 2)), power=power))
    np.testing.assert_allclose(
        [got.energy, got.energy_copper, got.energy_mechanical, got.energy_dissipated],
        [8.0, 3.0, -2.0, 1.0],
        rtol=1e-12,
    )


def test_quadrant_glitch_finds_the_peak_after_each_reversal():
    """x reverses at 0.25 and 0.75 s; a glitch of 3 um, then one of 5 um; y never reverses."""
    velocity = np.stack([np.cos(2 * np.pi * (T + DT / 2)), np.ones(N)], 1)
    error = np.full((N, 2), 1e-7)
    error[260, 0], error[770, 0] = 3e-6, -5e-6
    error[500, 0] = 9e-6  # long after a reversal: not a glitch
    got = report(metrics.quadrant_glitch(span=0.1), samples(error, velocity=velocity))
    np.testing.assert_allclose(got.reversals, [2, 0])
    np.testing.assert_allclose(got.glitch_mean[0], 4e-6)
    np.testing.assert_allclose(got.glitch_max[0], 5e-6)
    assert np.isnan(got.glitch_max[1])


def test_setting_off_from_rest_is_no_reversal():
    """Nor is the error of a start beside the path a glitch."""
    velocity = np.stack([np.maximum(T - 0.1, 0), np.ones(N)], 1)
    beside = np.stack([1e-3 * np.exp(-T / 0.05), np.zeros(N)], 1)
    got = report(metrics.quadrant_glitch(), samples(beside, velocity=velocity))
    np.testing.assert_array_equal(got.reversals, [0, 0])
    assert np.isnan(got.glitch_max).all()


@pytest.mark.parametrize("rest", [1e-17, 9e-7], ids=["double", "single"])
def test_rounding_at_standstill_is_no_reversal(rest):
    """Point to point: x goes on after a rest, y comes back after it; both shake while they rest."""
    shaking = rest * (-1.0) ** np.arange(N)
    going, resting = (T < 0.3) | (T > 0.7), (T >= 0.3) & (T <= 0.7)
    x = np.where(going, 0.02, shaking)
    y = np.where(resting, shaking, np.where(T < 0.5, 0.02, -0.02))
    velocity = np.stack([x, y], 1)
    got = report(metrics.quadrant_glitch(), samples(np.zeros((N, 2)), velocity=velocity))
    np.testing.assert_array_equal(got.reversals, [0, 1])
    turned = np.asarray(glitch.reversals(jnp.asarray(velocity)))
    np.testing.assert_array_equal(np.flatnonzero(turned[:, 1]), [np.flatnonzero(T > 0.7)[0]])
    assert not turned[:, 0].any()


def test_a_slow_reversal_counts_above_the_threshold_only():
    ramp = np.linspace(-1, 1, N)
    velocity = np.stack([3e-6 * ramp, 0.9e-6 * ramp], 1)
    got = report(metrics.quadrant_glitch(), samples(np.zeros((N, 2)), velocity=velocity))
    np.testing.assert_array_equal(got.reversals, [1, 0])


def test_window_covers_its_ticks_only():
    error = np.stack([np.where(T < 0.5, 9e-6, 2e-6), np.zeros(N)], 1)
    late = metrics.windowed(metrics.tracking, 500, 1000)
    np.testing.assert_allclose(report(late, samples(error)).ate, 2e-6, rtol=1e-12)
    np.testing.assert_allclose(report(late, samples(error)).tesd, 0, atol=1e-18)
    beyond = metrics.windowed(metrics.tracking, 2000, 3000)
    assert np.isnan(report(beyond, samples(error)).ate)


def test_variation_starts_inside_the_window():
    command = np.stack([np.where(T < 0.5, 5.0, 0.0), np.zeros(N)], 1)
    late = metrics.windowed(metrics.effort(), 500, 1000)
    got = report(late, samples(np.zeros((N, 2)), command=command))
    assert got.command_variation[0] == 0
    assert got.chattering[0] == 0


@pytest.mark.parametrize(("start", "stop"), [(5, 5), (7, 3), (-1, 4)])
def test_empty_windows_are_refused(start, stop):
    with pytest.raises(ValueError, match="a window needs"):
        metrics.windowed(metrics.tracking, start, stop)


def test_two_metrics_of_one_name_are_refused():
    with pytest.raises(ValueError, match="different names"):
        metrics.together(metrics.tracking, metrics.tracking)


def test_columns_carry_units_and_axes():
    rows = samples(np.full((N, 2), 2e-6))
    together = metrics.together(metrics.tracking, metrics.following, metrics.energy)
    table = metrics.columns(report(together, rows), pmsm_table())
    np.testing.assert_allclose(table["ate_um"], 2 * np.sqrt(2))
    np.testing.assert_allclose(table["following_max_um"]["y"], 2.0)
    assert table["energy_J"] == 0.0


def test_columns_show_what_is_not_finite_as_none():
    nothing = metrics.windowed(metrics.tracking, 5000, 6000)
    table = metrics.columns(report(nothing, samples(np.zeros((N, 2)))), pmsm_table())
    assert table["ate_um"] is None


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40), st.floats(-1e6, 1e6))
def test_moments_agree_with_numpy_also_far_from_zero(values, offset):
    data = np.array(values) + offset
    acc = moments.empty(jnp.zeros(()))
    for value in data:
        acc = moments.add(acc, jnp.asarray(value))
    np.testing.assert_allclose(moments.mean(acc), data.mean(), rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(moments.variance(acc), data.var(), rtol=1e-6, atol=1e-7)
    assert moments.largest(acc) == np.abs(data).max()
