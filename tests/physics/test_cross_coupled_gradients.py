"""Derivatives of the mean square contour error over 10 s of continuous time, both modes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.controllers import sliding
from jaxstage.model.fields import replace
from jaxstage.numerics.smooth import smooth
from jaxstage.studies.fuzzy_ccc import values
from tests.helpers.continuous import Continuous, run
from tests.helpers.coupling import STEPS, learning, path, pid, scene, stacked

pytestmark = pytest.mark.long

BENCH = Continuous(sliding(smooth))
PARAMETERS = ("K_P0", "K_D0", "c of x", "eta", "k1", "assumed mass of x")
#: J in um2, and dJ/d ln(parameter) by central differences of an independent model
EXPECTED = {
    "pid": (73.464516, (-39.3164, 3.23906, -34.9097, -10.5629, -59.7605, -41.4142)),
    "adaptive": (54.055573, (-16.8057, 1.84468, -14.2632, -0.032890, -28.7821, -19.2019)),
}


def gains(coupling, logs):
    """The published gains times exp(logs), in the order of `PARAMETERS`."""
    first = jnp.eye(3)[0]
    factor = jnp.exp(logs)
    rules = replace(
        coupling.rules,
        proportional=coupling.rules.proportional + values.BASE[0] * (factor[0] - 1),
        derivative=coupling.rules.derivative + values.BASE[2] * (factor[1] - 1),
    )
    axis = values.nominal(1 + first * (factor[5] - 1))
    law = values.sliding_gains(axis, 0.5 * factor[3])
    observed = values.observed(replace(law, slope=law.slope * (1 + first * (factor[2] - 1))), axis)
    watcher = observed.extra
    observed = replace(
        observed, extra=replace(watcher, disturbance_gain=watcher.disturbance_gain * factor[4])
    )
    return values.coupled(observed, replace(coupling, rules=rules), axis)


@pytest.fixture(scope="module")
def slopes():
    """J, forward and reverse derivatives of each loop."""
    begun = scene()

    @jax.jit  # so that the program is traced once for both modes
    def objective(logs, coupling):
        size = run(BENCH, gains(coupling, logs), begun, path(), STEPS, lambda row: row.estimate)
        square = (1e6 * size) ** 2
        return (jnp.sum(square) - (square[0] + square[-1]) / 2) / STEPS

    @jax.jit
    @jax.vmap
    def both(coupling):
        zero = jnp.zeros(len(PARAMETERS))
        value, reverse = jax.value_and_grad(objective)(zero, coupling)
        return value, jax.jacfwd(objective)(zero, coupling), reverse

    found = jax.tree.map(np.asarray, both(stacked([pid(), learning()])))
    return {name: [x[i] for x in found] for i, name in enumerate(EXPECTED)}


@pytest.mark.parametrize("name", EXPECTED)
def test_gradients(slopes, name):
    value, forward, reverse = slopes[name]
    expected_value, expected = EXPECTED[name]
    np.testing.assert_allclose(value, expected_value, rtol=1e-7)
    np.testing.assert_allclose(forward, expected, rtol=1e-4)
    np.testing.assert_allclose(reverse, forward, rtol=1e-8)
