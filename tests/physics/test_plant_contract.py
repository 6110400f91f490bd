"""A plant of another kind: between the samples, a load inside the step, one axis, no state."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.controllers import disturbance_observer, per_axis, plus, sliding
from jaxstage.hardware.drives import ideal_drive
from jaxstage.hardware.loads import SineLoad, no_load, sine_load
from jaxstage.hardware.sensors import ideal_sensor
from jaxstage.metrics import together, tracking
from jaxstage.model.blocks import Controller, Loop, Metric, Plant
from jaxstage.model.fields import replace
from jaxstage.model.signals import Output, Power, Scenario, Start
from jaxstage.numerics.smooth import smooth
from jaxstage.plants import PmlsmStage, pmlsm_stage
from jaxstage.references import analytic
from jaxstage.simulate.rollout import simulate
from tests.helpers.batteries import turning
from tests.helpers.three_axes import DT, gains, loop, scenario

# --- between the samples ---------------------------------------------------------------------


def peak_between(dt, substeps):
    """max |r - x| (axes,) at the samples and at the substeps, r carried on by r' and r''."""

    def update(acc, sample, _):
        wanted = sample.setpoint

        def missed(j, position):
            tau = (j + 1) * dt / substeps
            carried = wanted.position + wanted.velocity * tau + wanted.acceleration * tau**2 / 2
            return jnp.abs(carried - position)

        fine = jnp.max(jax.vmap(missed)(jnp.arange(substeps), sample.between.position), axis=0)
        at = jnp.abs(wanted.position - sample.output.position)
        return (jnp.maximum(acc[0], at), jnp.maximum(acc[1], jnp.maximum(at, fine))), None

    return Metric(
        name="peak",
        init=lambda wanted: (jnp.zeros_like(wanted.position),) * 2,
        update=update,
        finish=lambda acc: {"at": acc[0], "between": acc[1]},
    )


def test_error_between_the_samples():
    """A load in step with the sampling: at rest at the samples, 2 A/(M w^2) apart between them."""
    dt, substeps = 5e-3, 20
    rate, amplitude = 2 * np.pi / dt, 200.0
    reference, path = turning(period=2.0, dt=dt)
    still = Controller(
        name="follow",
        init=lambda g, wanted, seen: (),
        control=lambda g, memory, wanted, seen, dt: (wanted.acceleration, memory),
    )
    bench = Loop(
        plant=pmlsm_stage(("x", "y")), controller=still, reference=reference, load=sine_load,
        sensor=ideal_sensor, drive=ideal_drive, metric=peak_between(dt, substeps), dt=dt,
        substeps=substeps,
    )  # fmt: skip
    two = np.ones(2)
    ripple = amplitude / rate**2
    scene = Scenario(
        plant=PmlsmStage(mass=two, damping=0 * two, force_constant=two, resistance=0 * two),
        # F = A cos(w t): x - r = ripple (cos(w t) - 1)
        load=SineLoad(
            amplitude=amplitude * two, frequency=rate * two, phase=two * np.pi / 2, bias=0 * two
        ),
        sensor=(), drive=(), start=Start(offset=0 * two, velocity=two), key=jax.random.key(0),
    )  # fmt: skip
    still_path = path | {"radius": jnp.asarray(0.0)}
    report = simulate(bench, (), scene, still_path, 40).report
    assert (report["at"] < 0.02 * ripple).all()
    np.testing.assert_allclose(report["between"], 2 * ripple, rtol=0.01)
    # on the circle, without load, the reference carried over a period is the motion to r''' tau^3/6
    quiet = replace(scene, load=jax.tree.map(np.zeros_like, scene.load))
    one = simulate(bench, (), quiet, path, 1).report
    np.testing.assert_allclose(one["between"], 0, atol=1e-15)
    assert np.abs(report["between"]).max() > 50 * np.abs(report["at"]).max()


# --- a load that varies inside the step ------------------------------------------------------


def _frozen_step(params, state, applied, force, dt):
    return pmlsm_stage().step(params, state, applied, lambda fraction: force(0.0), dt)


FROZEN = replace(pmlsm_stage(("x",)), step=_frozen_step)


def distance_error(plant, substeps):
    """|x - x_exact| (m) after 1 s of M v' = -B v - A sin(w t) from rest, in periods of 50 ms."""
    mass, damping, amplitude, rate, end = 2.0, 3.0, 5.0, 9.0, 1.0
    one = np.ones(1)
    quiet = Controller(
        name="quiet",
        init=lambda g, wanted, seen: (),
        control=lambda g, memory, wanted, seen, dt: (jnp.zeros_like(seen.position), memory),
    )
    still = analytic("still", _still, 0.05)
    bench = Loop(
        plant=plant, controller=quiet, reference=still, load=sine_load,
        sensor=ideal_sensor, drive=ideal_drive, metric=tracking, dt=0.05, substeps=substeps,
        path_limit=np.inf,
    )  # fmt: skip
    scene = Scenario(
        plant=PmlsmStage(
            mass=mass * one, damping=damping * one, force_constant=one, resistance=0 * one
        ),
        load=SineLoad(amplitude=amplitude * one, frequency=rate * one, phase=0 * one, bias=0 * one),
        sensor=(), drive=(), start=Start(offset=0 * one, velocity=0 * one), key=jax.random.key(0),
    )  # fmt: skip
    run = simulate(bench, (), scene, jnp.zeros(1), 20)
    b, c = damping / mass, -(amplitude / mass) / (1j * rate + damping / mass)
    # v = Im(c e^(iwt)) - Im(c) e^(-bt)
    exact = (c * (np.exp(1j * rate * end) - 1) / (1j * rate)).imag - c.imag * (
        1 - np.exp(-b * end)
    ) / b
    return abs(float(run.final.state.position[0]) - exact)


def _still(params, time):
    return params + 0 * time


def test_fourth_order_with_a_load_inside_the_step():
    errors = [distance_error(pmlsm_stage(("x",)), n) for n in (1, 2, 4)]
    ratios = [errors[0] / errors[1], errors[1] / errors[2]]
    assert all(14 < r < 18 for r in ratios), ratios


def test_first_order_with_a_load_frozen_at_its_start():
    errors = [distance_error(FROZEN, n) for n in (2, 4, 8)]
    ratios = [errors[0] / errors[1], errors[1] / errors[2]]
    assert all(1.8 < r < 2.2 for r in ratios), ratios


# --- small things ----------------------------------------------------------------------------


def _no_power(params, before, after, applied, force, dt):
    zero = jnp.zeros_like(applied)
    return Power(copper=zero, mechanical=zero, dissipated=zero, load=zero, drawn=zero)


def _clamped(axes):
    """A plant without any state: the position is a parameter."""

    def observe(params, state):
        zero = jnp.zeros_like(params)
        return Output(position=params, velocity=zero, drive_position=params, drive_velocity=zero)

    return Plant(
        name="clamped", axes=axes, command_unit="A", init=lambda params, output: (),
        step=lambda params, state, applied, force, dt: (), observe=observe, power=_no_power,
        stored=lambda params, state: jnp.zeros_like(params),
    )  # fmt: skip


@pytest.mark.parametrize("report", ["none", "empty", "some"])
def test_one_axis_no_memory_no_report(report):
    """State, memory, sums, parameters and report may all be nothing."""
    nothing = Metric(
        name="nothing", init=lambda s: (), update=lambda a, s, dt: (a, None), finish=lambda a: None
    )
    metric = {"none": nothing, "empty": together(nothing), "some": tracking}[report]
    ask = Controller(
        name="ask",
        init=lambda g, wanted, seen: (),
        control=lambda g, memory, wanted, seen, dt: (wanted.position - seen.position, memory),
    )
    bench = Loop(
        plant=_clamped(("z",)), controller=ask, reference=analytic("still", _still, 0.05),
        load=no_load, sensor=ideal_sensor, drive=ideal_drive, metric=metric, dt=0.05,
    )  # fmt: skip
    scene = Scenario(
        plant=jnp.asarray([0.03]), load=(), sensor=(), drive=(),
        start=Start(offset=np.zeros(1), velocity=np.zeros(1)), key=jax.random.key(0),
    )  # fmt: skip
    run = simulate(bench, (), scene, jnp.asarray([0.05]), 5)
    assert run.final.step == 5 and run.final.left_path_at == -1
    assert run.rows is None
    assert report == "some" or run.report == {"none": None, "empty": {}}[report]
    if report == "some":

        def ate(position):
            there = replace(scene, plant=position)
            return simulate(bench, (), there, jnp.asarray([0.05]), 5).report.ate

        np.testing.assert_allclose(ate(scene.plant), 0.02)
        np.testing.assert_allclose(jax.grad(ate)(scene.plant), -1)


def test_one_axis_of_the_stage():
    """The same law, plant and drive with one axis, without a contour law."""
    one = jax.tree.map(lambda x: np.asarray(x)[:1], gains().law)
    scene = jax.tree.map(
        lambda x: np.asarray(x)[:1] if np.ndim(x) else x, replace(scenario(), key=())
    )
    line = analytic("line", _line, DT)
    bench = loop(
        controller=plus(per_axis(sliding(smooth)), per_axis(disturbance_observer)),
        plant=pmlsm_stage(("x",)), reference=line,
    )  # fmt: skip
    run = simulate(bench, one, replace(scene, key=jax.random.key(0)), jnp.asarray([0.05]), 500)
    assert run.final.left_path_at == -1 and run.report.ate < 2e-4


def _line(params, time):
    return params * jnp.sin(3 * time)
