"""Ideal sliding mode on the published table: its layer, its reaching, what it is held against."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from jaxstage.controllers import per_axis, sliding
from jaxstage.metrics import effort, following, together, windowed
from jaxstage.numerics.smooth import Layer, exact, implicit
from jaxstage.references import analytic
from jaxstage.simulate.rollout import simulate
from tests.helpers.batteries import tracing

pytestmark = pytest.mark.long


@functools.cache
def case():
    """The published circle, two laps of 5 s."""
    return js.build("sliding-circle")


def uniform_circle(params, time):
    angle = 2 * jnp.pi * time / 5.0
    return 0.025 * jnp.stack([jnp.cos(angle), jnp.sin(angle)])


def sliding_motion(sample):
    return sample.memory.surface, sample.output.velocity


@functools.cache
def ideal(switch):
    own = case()
    params = Layer(layer=jnp.ones(2)) if switch is implicit else ()
    loop = js.replace(
        own.loop,
        controller=per_axis(sliding(switch)),
        reference=analytic("uniform_circle", uniform_circle, 1e-4),
        metric=together(
            windowed(together(following, effort()), 50_000, 100_000, "lap 2"),
            tracing(sliding_motion),
        ),
    )
    gains = js.replace(own.gains, switch=params)
    return simulate(loop, gains, own.scenario, jnp.zeros(()), own.window.ticks)


def test_ideal_sliding_mode_stays_in_its_layer():
    """|s| <= (eta_D + D) dt with sgn, about eta_D dt with the implicit switch."""
    step = 1e-4
    plant = case().scenario.plant
    bound = np.asarray(plant.static / plant.mass)
    for switch, limit, observed in (
        (exact, (2 * bound + 0.01) * step, 0.01595),
        (implicit, (bound + 0.01) * step * 1.001, 0.00800),
    ):
        s = np.abs(ideal(switch).rows["tracing"][0])
        settled = s[50_000:].max(axis=0)
        assert (settled <= limit).all()
        np.testing.assert_allclose(settled[0], observed, atol=1e-5)


def test_ideal_sliding_mode_reaches_its_surface():
    """Outside the layer |s| falls at least as fast as eta.

    Less what sampling costs: the law compensates B v at the start of the period, the table feels
    it at the end.
    """
    plant = case().scenario.plant
    layer = np.asarray(2 * plant.static / plant.mass + 0.01) * 1e-4
    surface, velocity = ideal(exact).rows["tracing"]
    s = np.abs(surface)
    change = np.abs(np.diff(velocity, axis=0))
    sampling = np.asarray(plant.damping / plant.mass) * change * 1e-4
    outside = s[:-1] > layer
    assert outside[:, 1].any()
    fall = -np.diff(s, axis=0)
    assert (fall >= 0.01 * 1e-4 - 1.5 * sampling)[outside].all()
    assert (sampling[outside] < 0.05 * 0.01 * 1e-4).mean() > 0.9


def test_ideal_sliding_mode_is_a_baseline():
    sharp, soft = (ideal(s).report["lap 2"] for s in (exact, implicit))
    np.testing.assert_allclose(sharp["effort"].command_variation, [2.60, 2.17], atol=5e-3)
    np.testing.assert_allclose(soft["effort"].command_variation, [0.202, 0.169], atol=5e-4)
    # switching is chaotic: the RMS moves by some hundredths from lap to lap
    np.testing.assert_allclose(sharp["following"].following_rms * 1e3, [4.46, 4.23], atol=0.03)
