"""What hears the command: an observer beside a contour law, behind a drive that saturates."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.controllers import (
    cross_coupled,
    disturbance_observer,
    per_axis,
    pid_contour,
    plus,
    sliding,
)
from jaxstage.hardware.sensors import ideal_sensor
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import replace
from jaxstage.numerics.smooth import smooth
from jaxstage.simulate.rollout import simulate
from tests.helpers.batteries import tracing
from tests.helpers.three_axes import LOAD, MASS, PATH, gains, loop, scenario


def deaf(law, hears):
    """The law, but its observer is told ``hears(own demand, demand, command)`` as the command."""

    def control(gains, memory, wanted, measured, dt):
        demand, inner = law.control(gains, memory["inner"], wanted, measured, dt)
        return demand, {"inner": inner, "own": demand}

    def settle(gains, memory, demand, command, dt):
        told = hears(memory["own"], demand, command)
        return memory | {"inner": law.settle(gains, memory["inner"], demand, told, dt)}

    return Controller(
        name="deaf",
        init=lambda g, wanted, measured: {
            "inner": law.init(g, wanted, measured),
            "own": jnp.zeros_like(measured.position),
        },
        control=control,
        settle=settle,
    )


def _estimate(sample):
    memory = sample.memory.law.extra
    memory = memory["inner"] if isinstance(memory, dict) else memory
    return memory.estimate.disturbance, sample.command != sample.demand


def estimates(watcher, limit=10.0, stiffness=1000.0):
    """d^ of every tick, (ticks, 3) m/s2, and the ticks at which the drive was at its limit."""
    law = cross_coupled(plus(per_axis(sliding(smooth)), watcher), pid_contour())
    scene = scenario(limit, resolution=0.0)
    rows = simulate(
        loop(tracing(_estimate), law, sensor=ideal_sensor), gains(stiffness),
        replace(scene, sensor=()), PATH, 500,
    ).rows  # fmt: skip
    return np.asarray(rows[0]), np.asarray(rows[1])


TRUE = LOAD / MASS


def test_observer_finds_the_load_behind_coupling_and_saturation():
    """d - d^ obeys its own equation: what the drive cuts and what the coupling adds is no load."""
    free, cut = estimates(per_axis(disturbance_observer))
    assert not cut.any()
    np.testing.assert_allclose(free[-1], TRUE, rtol=5e-3)
    tight, cut = estimates(per_axis(disturbance_observer), limit=1.3, stiffness=9000.0)
    assert cut[:100].any() and cut.any(axis=0).sum() >= 2
    np.testing.assert_allclose(tight[-1], TRUE, rtol=5e-3)
    np.testing.assert_allclose(tight, free, atol=0.02 * np.abs(TRUE).max())


@pytest.mark.parametrize(
    ("hears", "name"),
    [(lambda own, demand, command: own, "own"), (lambda own, demand, command: demand, "demand")],
    ids=["own law only", "demand, not command"],
)
def test_an_observer_that_hears_less_is_wrong(hears, name):
    wrong, _ = estimates(deaf(per_axis(disturbance_observer), hears), limit=1.3, stiffness=9000.0)
    right, _ = estimates(per_axis(disturbance_observer), limit=1.3, stiffness=9000.0)
    assert np.abs(wrong - right).max() > 0.2 * np.abs(TRUE).max()
    if name == "own":
        assert np.abs(wrong[-1] - TRUE).max() > 0.2 * np.abs(TRUE).max()
