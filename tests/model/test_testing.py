"""The checks of `jaxstage.testing` notice a broken law, each the one that is broken."""

import jax
import jax.numpy as jnp
import pytest
from jax import Array

from jaxstage.controllers import per_axis
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import gain, pytree, replace, signal
from jaxstage.testing import check_controller


@pytest.fixture(autouse=True, scope="module")
def _double():
    with jax.enable_x64(True):
        yield


@pytree
class Gains:
    """Of the law below."""

    proportional: Array = gain("command/m", "k", "proportional gain", low=0.0)


@pytree
class Memory:
    """Of the law below."""

    error: Array = signal("m", "e", "last error")


def _init(gains, setpoint, measurement):
    return Memory(error=setpoint.position - measurement.position)


def _control(gains, memory, setpoint, measurement, dt):
    error = setpoint.position - measurement.position
    return gains.proportional * (error + memory.error), Memory(error=error)


SOUND = Controller(name="sound", init=_init, control=_control)
GAINS = Gains(proportional=jnp.full(2, 2.0))


def failing(**changes):
    """Names of the checks that a changed law fails."""
    law = per_axis(replace(SOUND, **changes))
    return {check.name: check.said for check in check_controller(law, GAINS) if not check.passed}


def test_a_sound_law_passes():
    assert not failing()


def test_a_division_by_the_speed_is_not_finite_at_rest():
    def control(gains, memory, setpoint, measurement, dt):
        demand, after = _control(gains, memory, setpoint, measurement, dt)
        return demand / setpoint.velocity, after

    found = failing(control=control)
    assert found["finite everywhere"] == "rest: demand or memory is not finite"


def test_a_memory_that_changes_its_type():
    def control(gains, memory, setpoint, measurement, dt):
        demand, after = _control(gains, memory, setpoint, measurement, dt)
        return demand, Memory(error=after.error.astype(jnp.float32))

    assert "control changes the kind" in failing(control=control)["memory keeps its kind"]


def test_a_wrong_derivative():
    @jax.custom_jvp
    def crooked(x):
        return x * x

    crooked.defjvp(lambda primals, tangents: (crooked(*primals), 3 * tangents[0]))

    def control(gains, memory, setpoint, measurement, dt):
        demand, after = _control(gains, memory, setpoint, measurement, dt)
        return crooked(demand), after

    assert "gradients agree" in failing(control=control)


def test_double_precision_is_asked_for():
    with jax.enable_x64(False), pytest.raises(ValueError, match="double precision"):
        check_controller(per_axis(SOUND), GAINS)
