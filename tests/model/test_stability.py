"""Sampled stability limits of the sliding law, by the eigenvalues of a tick."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.controllers import nonlinear_surface, per_axis
from jaxstage.controllers.parts.damping import FinalDamping, constant
from jaxstage.controllers.parts.reaching import FixedGain
from jaxstage.hardware.drives import CurrentDrive, current_drive
from jaxstage.hardware.loads import no_load
from jaxstage.hardware.sensors import Encoder, encoder, ideal_sensor
from jaxstage.metrics import following
from jaxstage.model.blocks import Loop
from jaxstage.model.fields import replace
from jaxstage.plants import screw_table
from jaxstage.references import trifolium
from jaxstage.simulate.stability import spectral_radius, stability_limit, transition
from jaxstage.studies.adaptive_smc import values

DT = values.DT
SLOPE = 58.0  # lam + gam beta: the surface at the commanded speed


def on_device(tree):
    return jax.tree.map(jnp.asarray, tree)


@functools.cache
def phi(differenced, substeps=1):
    """Compiled Phi of gains K (2,), damping of the true plant, and dead time in periods."""
    loop = Loop(
        plant=screw_table(),
        controller=per_axis(nonlinear_surface(damping=constant)),
        reference=trifolium(DT),
        load=no_load,
        sensor=encoder if differenced else ideal_sensor,
        drive=current_drive(1),
        metric=following,
        dt=DT,
        substeps=substeps,
    )
    sensor = Encoder(resolution=jnp.zeros(()), bandwidth=jnp.asarray(np.inf)) if differenced else ()
    table = on_device(values.frictionless())
    base = on_device(values.gains(FixedGain(start=np.zeros(2)), q=0.0))
    base = replace(base, damping=FinalDamping(final=jnp.full(2, 10.0)))

    def of(gain, viscous, delay):
        motor = replace(table.motor, damping=viscous * table.motor.damping)
        plant = replace(table, damping=viscous * table.damping, motor=motor)
        drive = CurrentDrive(limit=jnp.full(2, jnp.inf), delay=delay, lag=jnp.zeros(()))
        scenario = replace(values.scenario(plant, sensor), drive=drive)
        nominal = replace(base.nominal, damping=viscous * base.nominal.damping)
        gains = replace(base, reaching=FixedGain(start=gain), nominal=nominal)
        return transition(loop, gains, scenario, values.path())

    return jax.jit(jax.vmap(of, (0, None, None)))


def limit(axis, differenced, viscous, delay):
    """Largest stable K of one axis while the other stays at 1 1/s."""

    def radius(gains):
        both = np.ones((len(gains), 2))
        both[:, axis] = gains
        return spectral_radius(phi(differenced)(both, viscous, delay))

    return stability_limit(radius, 1.0, 1000.0, 1e-7)


#: largest stable whole K: axis 1 and axis 2, without damping (double integrator) and with it
LIMITS = {
    (False, 0.0): ((341, 341), (349, 349)),
    (False, 1.0): ((116, 116), (126, 127)),
    (True, 0.0): ((257, 257), (272, 273)),
    (True, 1.0): ((70, 70), (80, 81)),
}


@pytest.mark.parametrize(
    ("differenced", "delay"), LIMITS, ids=["true v", "true v, delay", "difference", "both"]
)
def test_largest_stable_gain(differenced, delay):
    for viscous, expected in zip((0.0, 1.0), LIMITS[differenced, delay], strict=True):
        for axis in (0, 1) if viscous else (0,):
            assert int(limit(axis, differenced, viscous, delay)) == expected[axis]


def test_double_integrator_in_closed_form():
    """u = J [(A + K) e' + A K e], held: z^2 - tr z + det with the Jury limit A + K = 2/Ts."""
    a, k = SLOPE, 200.0
    step = np.array([[1, DT], [0, 1]]) - np.outer([DT**2 / 2, DT], [a * k, a + k])
    expected = np.abs(np.linalg.eigvals(step)).max()
    got = spectral_radius(phi(False)(np.full((1, 2), k), 0.0, 0.0))
    np.testing.assert_allclose(got, expected, rtol=1e-9)
    np.testing.assert_allclose(limit(0, False, 0.0, 0.0), 2 / DT - SLOPE, rtol=1e-6)


def test_search():
    """The first crossing, inf when there is none, an error when there is nothing to start from."""

    def radius(x):
        return np.where((x > 3.7) & (x < 5), 1.2, 0.5)

    assert abs(stability_limit(radius, 0.0, 10.0) - 3.7) < 1e-7
    assert stability_limit(radius, 0.0, 3.0) == np.inf
    with pytest.raises(ValueError, match="not stable at 4"):
        stability_limit(radius, 4.0, 10.0)


def test_a_matrix_that_is_not_finite_is_not_stable():
    matrices = np.stack([0.5 * np.eye(3), np.full((3, 3), np.nan)])
    np.testing.assert_array_equal(spectral_radius(matrices), [0.5, np.inf])
