"""Loads, sensors and drives, each against its own formula."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxstage.hardware.drives import CurrentDrive, current_drive, ideal_drive
from jaxstage.hardware.loads import SineLoad, no_load, sine_load
from jaxstage.hardware.sensors import Encoder, encoder, ideal_sensor, quantise
from jaxstage.model.signals import Output
from tests.helpers.batteries import cast

DT = 1e-3
KEY = jax.random.key(0)
types = pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64], ids=["f32", "f64"])


def truth(x, v, dtype=jnp.float64):
    """A table whose drive side stands 1 mm behind the tool."""
    x, v = np.asarray(x, float), np.asarray(v, float)
    return cast(
        Output(position=x, velocity=v, drive_position=x - 1e-3, drive_velocity=2 * v), dtype
    )


def drive_params(limit=1.0, delay=0.0, lag=0.0, dtype=jnp.float64):
    return cast(CurrentDrive(limit=np.full(2, limit), delay=delay, lag=lag), dtype)


def driven(drive, params, demands):
    """Commands and applied values (ticks, 2) of a series of demands."""
    memory = drive.init(params, jnp.zeros_like(demands[0]))

    def tick(memory, demand):
        command, applied, memory = drive.apply(params, memory, demand, DT)
        return memory, (command, applied)

    return jax.lax.scan(tick, memory, demands)[1]


NOISE = jnp.asarray(np.random.default_rng(0).normal(0, 1, (30, 2)))


# --- loads ----------------------------------------------------------------------------------


@pytest.mark.fast
@types
def test_loads(dtype):
    output = truth([0.1, 0.2], [0, 0], dtype)
    quiet = no_load.force((), jnp.asarray(3.0, dtype), KEY, output)
    assert quiet.dtype == dtype
    np.testing.assert_array_equal(quiet, [0, 0])
    params = cast(
        SineLoad(
            amplitude=np.array([2.0, 3]), frequency=np.array([4.0, 5]), phase=np.array([0, 0.5]),
            bias=np.array([10.0, -10]),
        ),
        dtype,
    )  # fmt: skip
    force = sine_load.force(params, jnp.asarray(0.7, dtype), KEY, output)
    expected = [10 + 2 * np.sin(2.8), -10 + 3 * np.sin(4.0)]
    assert force.dtype == dtype
    np.testing.assert_allclose(force, expected, rtol=1e-6 if dtype == jnp.float32 else 1e-14)


# --- sensors --------------------------------------------------------------------------------


@pytest.mark.fast
def test_ideal_sensor_shows_the_truth():
    output = truth([0.1, 0.2], [0.3, 0.4])
    seen, memory = ideal_sensor.read((), ideal_sensor.init((), output), KEY, output, DT)
    assert memory == ()
    for name in ("position", "velocity", "drive_position", "drive_velocity"):
        np.testing.assert_array_equal(getattr(seen, name), getattr(output, name))


@pytest.mark.fast
@given(position=st.floats(-1, 1), steps=st.sampled_from([1e-9, 2.5e-8, 1e-6, 1e-3]))
@settings(deadline=None, max_examples=50)
def test_quantised_to_the_nearest_step(position, steps):
    seen = float(quantise(jnp.asarray(position), jnp.asarray(steps)))
    assert abs(seen - position) <= steps / 2 * (1 + 1e-6) + 1e-15
    assert abs(seen / steps - round(seen / steps)) < 1e-6
    assert float(quantise(jnp.asarray(position), jnp.asarray(0.0))) == position


@pytest.mark.fast
def test_half_a_step_rounds_up():
    x = jnp.asarray([-1.5, -0.5, 0.5, 1.5]) * 0.25
    np.testing.assert_array_equal(quantise(x, jnp.asarray(0.25)), [-0.25, 0, 0.25, 0.5])


def encoded(params, positions, velocity=0.0, dtype=jnp.float64):
    """What an encoder sees of a series of tool positions (ticks, 2)."""
    output = truth(positions[0], [velocity] * 2, dtype)
    memory, seen = encoder.init(cast(params, dtype), output), []
    for x in positions:
        one, memory = encoder.read(
            cast(params, dtype), memory, KEY, truth(x, [velocity] * 2, dtype), DT
        )
        seen.append(one)
    return jax.tree.map(lambda *x: jnp.stack(x), *seen), memory


@types
def test_encoder_differences(dtype):
    """The first sample is the truth; then the difference of what was read, on both sides."""
    positions = np.array([[0, 0], [1.4e-3, -1e-3], [2.6e-3, -3e-3]])
    seen, memory = encoded(Encoder(resolution=1e-3, bandwidth=np.inf), positions, 0.7, dtype)
    assert all(leaf.dtype == dtype for leaf in jax.tree.leaves((seen, memory)))
    close = dict(rtol=1e-4, atol=1e-6) if dtype == jnp.float32 else dict(rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(seen.position[:, 0], [0, 1e-3, 3e-3], **close)
    np.testing.assert_allclose(seen.velocity, [[0.7, 0.7], [1, -1], [2, -2]], **close)
    np.testing.assert_allclose(seen.drive_position[:, 0], [-1e-3, 0, 2e-3], **close)
    np.testing.assert_allclose(seen.drive_velocity[0], [1.4, 1.4], **close)
    np.testing.assert_allclose(seen.drive_velocity[1:, 0], [1, 2], **close)


def test_encoder_low_pass():
    """A step of the speed from 0 to V is answered by V (1 - exp(-2 pi f t))."""
    positions = np.arange(30)[:, None] * np.array([1e-3, -2e-3])
    seen, _ = encoded(Encoder(resolution=0.0, bandwidth=40.0), positions)
    time = np.arange(30)[:, None] * DT
    expected = (1 - np.exp(-2 * np.pi * 40 * time)) * [1.0, -2.0]
    np.testing.assert_allclose(seen.velocity, expected, rtol=1e-9, atol=1e-12)


def test_encoder_gradient_by_its_bandwidth():
    positions = jnp.asarray(np.arange(5)[:, None] * np.array([1e-3, -2e-3]))

    def speed(bandwidth):
        params = Encoder(resolution=jnp.asarray(0.0), bandwidth=bandwidth)
        return encoded_last(params, positions)

    assert jax.grad(speed)(jnp.asarray(jnp.inf)) == 0
    h = 1e-4
    numeric = (speed(jnp.asarray(40 + h)) - speed(jnp.asarray(40 - h))) / (2 * h)
    np.testing.assert_allclose(jax.grad(speed)(jnp.asarray(40.0)), numeric, rtol=1e-6)


def encoded_last(params, positions):
    zero = jnp.zeros(2)

    def output(x):
        return Output(position=x, velocity=zero, drive_position=x, drive_velocity=zero)

    memory = encoder.init(params, output(positions[0]))
    for x in positions:
        seen, memory = encoder.read(params, memory, KEY, output(x), DT)
    return seen.velocity[0]


@pytest.mark.fast
@types
@pytest.mark.parametrize("sensor", ["ideal", "encoder"])
def test_sensor_memory_keeps_its_kind(sensor, dtype):
    block, params = {
        "ideal": (ideal_sensor, ()),
        "encoder": (encoder, cast(Encoder(resolution=1e-6, bandwidth=100.0), dtype)),
    }[sensor]
    output = truth([0.1, 0.2], [0, 0], dtype)
    before = block.init(params, output)
    _, after = block.read(params, before, KEY, output, DT)
    assert jax.tree.structure(before) == jax.tree.structure(after)
    for a, b in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        assert (a.shape, a.dtype, a.weak_type) == (b.shape, b.dtype, b.weak_type)


# --- drives ---------------------------------------------------------------------------------


@pytest.mark.fast
def test_ideal_drive_gives_what_is_asked():
    demand = jnp.asarray([1e9, -1e9])
    command, applied, memory = ideal_drive.apply((), (), demand, DT)
    np.testing.assert_array_equal(command, demand)
    np.testing.assert_array_equal(applied, demand)
    assert memory == ()


@pytest.mark.parametrize("max_delay", [0, 3])
def test_a_drive_without_faults_is_ideal_to_the_last_bit(max_delay):
    command, applied = driven(current_drive(max_delay), drive_params(np.inf), NOISE)
    np.testing.assert_array_equal(command, NOISE)
    np.testing.assert_array_equal(applied, NOISE)


def test_limits_are_per_axis():
    params = cast(CurrentDrive(limit=np.array([0.5, 2.0]), delay=0.0, lag=0.0))
    command, applied = driven(current_drive(), params, NOISE)
    np.testing.assert_array_equal(command, np.clip(NOISE, [-0.5, -2], [0.5, 2]))
    np.testing.assert_array_equal(applied, command)


def test_delay_shifts_the_limited_command():
    many = jax.vmap(lambda d: driven(current_drive(4), drive_params(0.8, d), NOISE))
    command, applied = many(jnp.arange(5.0))
    for delay in range(5):
        np.testing.assert_array_equal(command[delay], np.clip(NOISE, -0.8, 0.8))
        np.testing.assert_array_equal(applied[delay, :delay], 0)
        np.testing.assert_array_equal(applied[delay, delay:], command[delay, : 30 - delay])


def test_lag_is_first_order_after_the_delay():
    """A step is answered by the mean of 1 - exp(-t/tau) over each period."""
    demand, lag, delay = jnp.ones((30, 2)), 5e-3, 2
    _, applied = driven(current_drive(2), drive_params(np.inf, delay, lag), demand)
    begin = (np.arange(30) - delay) * DT / lag
    mean = 1 - np.exp(-begin) * (1 - np.exp(-DT / lag)) * lag / DT
    expected = np.where(begin > -1e-9, mean, 0)
    np.testing.assert_allclose(applied[:, 0], expected, rtol=1e-12)


def test_a_lag_far_shorter_than_the_period_still_delays():
    """tau = dt/10: of the first period a tenth is missing, whatever the sampling."""
    _, applied = driven(current_drive(), drive_params(np.inf, 0, DT / 10), jnp.ones((2, 2)))
    np.testing.assert_allclose(applied[0], 1 - 0.1 * (1 - np.exp(-10)), rtol=1e-12)


def test_gradient_by_the_lag():
    def energy(lag):
        params = CurrentDrive(limit=jnp.full(2, jnp.inf), delay=jnp.asarray(0.0), lag=lag)
        return jnp.sum(driven(current_drive(), params, NOISE)[1] ** 2)

    assert np.isfinite(jax.grad(energy)(jnp.asarray(0.0)))
    h = 1e-8
    numeric = (energy(jnp.asarray(2e-3 + h)) - energy(jnp.asarray(2e-3 - h))) / (2 * h)
    np.testing.assert_allclose(jax.grad(energy)(jnp.asarray(2e-3)), numeric, rtol=1e-6)


@pytest.mark.fast
@types
def test_drive_memory_keeps_its_kind(dtype):
    drive, params = current_drive(3), drive_params(1.0, 2.0, 1e-3, dtype)
    before = drive.init(params, jnp.zeros(2, dtype))
    command, applied, after = drive.apply(params, before, jnp.ones(2, dtype), DT)
    assert command.dtype == applied.dtype == dtype
    for a, b in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        assert (a.shape, a.dtype, a.weak_type) == (b.shape, b.dtype, b.weak_type)


@pytest.mark.fast
def test_equal_drives_are_one_definition():
    assert current_drive(3) is current_drive(3)
    assert current_drive(3).max_delay == 3
    with pytest.raises(ValueError, match=r"max_delay = -1 periods: must be 0 .. 10000"):
        current_drive(-1)


def test_a_dead_time_without_end_is_refused_with_its_memory():
    says = r"max_delay = 1e\+09 periods: must be 0 .. 10000; .* 8e\+03 MB an axis"
    with pytest.raises(ValueError, match=says):
        current_drive(10**9)
    assert current_drive(10_000).max_delay == 10_000
