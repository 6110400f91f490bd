"""Computed motions in single precision: the same phase is the same setpoint in every lap."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.references import circle as ring
from jaxstage.references import (
    constant_feed_phase,
    helical,
    helix,
    make_trifolium,
    nurbs_lap,
    swing,
    swinging,
    trifolium,
)
from jaxstage.references.motion import time_of

pytestmark = pytest.mark.fast
DT = 1e-4
LAP = 20_000

MOTIONS = {
    "trifolium": (trifolium(DT), make_trifolium(0.01, 2.0)),
    "trifolium at constant feed": (trifolium(DT, constant_feed_phase), make_trifolium(0.01, 2.0)),
    "to and fro": (swinging(DT), swing(0.02, 2.0)),
    "turn": (helical(DT), helix(0.02, np.pi, 0.0)),
    "turn the other way": (helical(DT), helix(0.02, -np.pi, 0.0)),
    "nurbs": (nurbs_lap(LAP, DT), ring()),
}


def in_single(params):
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), params)


@pytest.mark.parametrize("name", MOTIONS)
def test_no_drift_over_fourteen_hours(name):
    """Ticks a lap apart, up to 50 000 s: to the bit. And it is the setpoint of double precision."""
    motion, params = MOTIONS[name]
    sample = jax.jit(motion.sample)
    for phase in (0, 1, 4999, 12_345, LAP - 1):
        first = sample(in_single(params), jnp.asarray(phase, jnp.int32))
        exact = motion.sample(jax.tree.map(jnp.asarray, params), jnp.asarray(phase))
        np.testing.assert_allclose(first.position, exact.position, atol=2e-8)
        for laps in (1, 500, 24_999):
            tick = jnp.asarray(phase + laps * LAP, jnp.int32)
            later = sample(in_single(params), tick)
            assert later.position.dtype == jnp.float32
            np.testing.assert_array_equal(later.position, first.position)
            np.testing.assert_array_equal(later.velocity, first.velocity)


def test_a_rising_turn_goes_on_rising():
    params = in_single(helix(0.02, np.pi, 1e-4))
    tick = jnp.asarray(12_345 + 500 * LAP, jnp.int32)
    setpoint = helical(DT).sample(params, tick)
    np.testing.assert_allclose(setpoint.position[2], 1e-4 * (12_345 + 500 * LAP) * DT, rtol=3e-7)
    near = helical(DT).nearest(params, tick, setpoint.position * jnp.asarray([1.01, 1.01, 1.0]))
    np.testing.assert_allclose(near.distance, 2e-4, rtol=1e-3)


def test_a_lap_of_no_whole_number_of_ticks():
    """k dt mod T within the rounding of T itself; its derivative by T is minus the laps done."""
    period = jnp.asarray(1.23456789, jnp.float32)
    for tick in (3, 40_000, 10_000_000):
        time, slope = jax.value_and_grad(
            lambda T, k=tick: time_of({"T": T}, jnp.asarray(k, jnp.int32), DT, lambda p: p["T"])
        )(period)
        exact = np.float64(tick) * DT
        laps = np.round((exact - np.float64(time)) / np.float64(period))
        np.testing.assert_allclose(slope, -laps)
        drift = exact - laps * np.float64(period) - np.float64(time)
        assert abs(drift) <= 1e-7 * exact + 1e-7


def test_double_precision_counts_the_time_as_it_was():
    params = {"T": jnp.asarray(2.0)}
    time = time_of(params, jnp.asarray(123_456_789), DT, lambda p: p["T"])
    assert time == 123_456_789 * DT
