"""The signatures carry other machines: three axes, an encoder, dead time, lag, limits, an observer
beside a contour law, a load inside the integrator, a motion computed in the tick."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from batteries import (
    Lead,
    ahead,
    tracing,
    turning,
)

from jaxstage.blocks import Controller, Loop, Metric, Plant
from jaxstage.controllers import (
    Both,
    Coupled,
    DisturbanceObserver,
    Offset,
    PidContour,
    RigidAxis,
    Sliding,
    cross_coupled,
    disturbance_observer,
    offset_setpoint,
    per_axis,
    pid_contour,
    plus,
    sliding,
)
from jaxstage.drives import CurrentDrive, current_drive, ideal_drive
from jaxstage.fields import replace
from jaxstage.loads import SineLoad, no_load, sine_load
from jaxstage.metrics import following, together, tracking
from jaxstage.numerics.smooth import SmoothWidth, smooth
from jaxstage.plants import PmlsmStage, pmlsm_stage
from jaxstage.references import analytic, make_path, nurbs, sampled, uniform_parameter
from jaxstage.rollout import _simulate, simulate
from jaxstage.sensors import Encoder, encoder, ideal_sensor
from jaxstage.signals import Output, Power, Scenario, Start

DT = 2e-4
XYZ = ("x", "y", "z")


# --- the stage with its load frozen over a step ------------------------------------------------


def _frozen_step(params, state, applied, force, dt):
    return pmlsm_stage().step(params, state, applied, lambda fraction: force(0.0), dt)


FROZEN = replace(pmlsm_stage(("x",)), step=_frozen_step)


# --- the loop --------------------------------------------------------------------------------


def _helix(params, time):
    angle = params["rate"] * time
    r = params["radius"]
    return jnp.stack([r * jnp.cos(angle), r * jnp.sin(angle), params["climb"] * time])


HELIX = analytic("helix", _helix, DT)
PATH = {"radius": jnp.asarray(0.05), "rate": jnp.asarray(4 * np.pi), "climb": jnp.asarray(0.01)}
MASS, DAMPING, FORCE = np.array([12.0, 8, 5]), np.array([10.0, 8, 12]), np.array([50.0, 50, 40])
LOAD = np.array([20.0, -15.0, 10.0])


def plant_params():
    return PmlsmStage(mass=MASS, damping=DAMPING, force_constant=FORCE, resistance=np.zeros(3))


def gains(stiffness=1000.0):
    nominal = RigidAxis(
        force_constant=FORCE, mass=MASS, damping=DAMPING, coulomb=np.zeros(3), load=np.zeros(3)
    )
    law = Sliding(
        slope=np.array([10.0, 12, 15]),
        switching_gain=np.full(3, 0.5),
        disturbance_bound=np.zeros(3),
        switch=SmoothWidth(width=np.full(3, 5e-3)),
        nominal=nominal,
    )
    watch = DisturbanceObserver(
        disturbance_gain=np.full(3, 250e3), velocity_gain=np.full(3, 1e3), nominal=nominal
    )
    contour = PidContour(
        proportional_gain=stiffness, integral_gain=0.0, derivative_gain=0.0, rest_speed=1e-6,
        form=(),
    )  # fmt: skip
    return Coupled(
        law=Both(law=law, extra=watch),
        extra=contour,
        command_per_acceleration=MASS / FORCE,
    )


LAW = cross_coupled(plus(per_axis(sliding(smooth)), per_axis(disturbance_observer)), pid_contour())


def scenario(limit=10.0, delay=0.0, lag=0.0, amplitude=0.0, resolution=1e-8):
    return Scenario(
        plant=plant_params(),
        load=SineLoad(
            amplitude=np.full(3, amplitude), frequency=np.array([3.0, 2, 1.5]),
            phase=np.zeros(3), bias=LOAD,
        ),
        sensor=Encoder(resolution=resolution, bandwidth=np.inf),
        drive=CurrentDrive(limit=np.full(3, limit), delay=delay, lag=lag),
        start=Start(offset=np.array([-1e-4, 0, -5e-5]), velocity=np.ones(3)),
        key=jax.random.key(3),
    )  # fmt: skip


def loop(metric=tracking, controller=LAW, **changes):
    base = Loop(
        plant=pmlsm_stage(),
        controller=controller,
        reference=HELIX,
        load=sine_load,
        sensor=encoder,
        drive=current_drive(3),
        metric=metric,
        dt=DT,
        substeps=2,
    )
    return replace(base, **changes)


def currents(sample):
    return sample.demand, sample.command, sample.applied


def test_everything_at_once_is_finite_and_on_the_path():
    run = simulate(loop(together(tracking, following)), gains(), scenario(), PATH, 1500)
    assert run.final.left_path_at == run.final.non_finite_at == -1
    assert run.report["following"].following_rms.shape == (3,)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(run.report))
    assert run.report["tracking"].ate < 2e-4


# --- (b) delay, lag, saturation --------------------------------------------------------------


def test_delay_is_data():
    """Four delays in one compilation; the command reaches the plant that many periods later."""
    traced = []
    fixed = loop(tracing(currents))

    @jax.jit
    def run(delay):
        traced.append(1)
        one = scenario()
        one = replace(one, drive=replace(one.drive, delay=delay))
        return simulate(fixed, gains(), one, PATH, 100).rows

    _, command, applied = jax.vmap(run)(jnp.arange(4.0))
    assert len(traced) == 1
    for delay in range(4):
        np.testing.assert_array_equal(applied[delay, :delay], 0)
        np.testing.assert_array_equal(applied[delay, delay:], command[delay, : 100 - delay])
        alone = run(jnp.asarray(float(delay)))
        np.testing.assert_allclose(alone[2], applied[delay], rtol=1e-7, atol=1e-9)
    assert np.abs(command[0] - command[3]).max() > 1e-3, "the loop never felt the delay"


def test_limit_then_delay_then_lag():
    limit, lag = 0.6, 1e-3
    rows = simulate(loop(tracing(currents)), gains(), scenario(limit, 2.0, lag), PATH, 200).rows
    demand, command, applied = map(np.asarray, rows)
    assert (np.abs(demand) > limit).any()
    np.testing.assert_array_equal(command, np.clip(demand, -limit, limit))
    late = np.concatenate([np.zeros((2, 3)), command[:-2]])
    lagged, left = np.zeros(3), np.exp(-DT / lag)
    for k in range(200):
        expected = late[k] + (1 - left) * lag / DT * (lagged - late[k])
        np.testing.assert_allclose(applied[k], expected, atol=1e-13)
        lagged = late[k] + left * (lagged - late[k])


# --- (c) what hears the command --------------------------------------------------------------


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


# --- (d) between the samples ------------------------------------------------------------------


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


# --- (e) a load that varies inside the step -----------------------------------------------------


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


# --- (f) start, (g) offset, (h) paths ---------------------------------------------------------


def _beginning(sample):
    return sample.output, sample.measurement


@pytest.mark.fast
def test_start_offset_and_matched_velocity():
    scene = scenario(resolution=0.0)
    scene = replace(scene, start=replace(scene.start, velocity=np.array([0.0, 1.0, 0.5])))
    output, seen = simulate(loop(tracing(_beginning)), gains(), scene, PATH, 3).rows
    r = np.array([0.05, 0, 0]) + np.array([-1e-4, 0, -5e-5])
    v = np.array([0, 0.05 * 4 * np.pi, 0.01]) * [0, 1, 0.5]
    np.testing.assert_allclose(output.position[0], r, atol=1e-15)
    np.testing.assert_allclose(output.velocity[0], v, atol=1e-15)
    # the encoder knows the velocity at the start; from then on it differences
    np.testing.assert_allclose(seen.velocity[0], v, atol=1e-15)
    np.testing.assert_allclose(seen.velocity[1:], np.diff(output.position, axis=0) / DT, atol=1e-11)


def _distance(sample):
    return sample.setpoint.position, sample.output.position


def test_offset_setpoint_moves_the_tool_not_the_metric():
    """A law that leads by tau r' puts the tool there; the sliding surface lets it in with 1/c."""
    law = offset_setpoint(LAW, "lead", ahead)
    base = loop(tracing(_distance), law, substeps=1)
    slow, time, count = PATH | {"rate": jnp.asarray(1.0)}, 5e-3, 4000
    (r0, x0), (r1, x1) = (
        simulate(base, Offset(law=gains(0.0), offset=Lead(time=t)), scenario(), slow, count).rows
        for t in (0.0, time)
    )
    np.testing.assert_array_equal(r0, r1)
    velocity = np.gradient(np.asarray(r0), DT, axis=0)
    moved, expected = np.asarray(x1 - x0), np.zeros((count, 3))
    slope = np.asarray(gains().law.law.slope)
    for k in range(1, count):  # (x - r)' = c (tau r' - (x - r))
        pull = slope * (time * velocity[k - 1] - expected[k - 1])
        expected[k] = expected[k - 1] + DT * pull
    np.testing.assert_allclose(moved[2000:], expected[2000:], atol=0.02 * np.abs(expected).max())
    assert np.abs(moved[-1] - time * velocity[-1]).max() < 0.1 * time * np.abs(velocity).max()


def test_a_curve_in_space():
    """A stored 3-D NURBS lap: the same loop, another reference."""
    curve = nurbs(
        [(0, 0, 0), (0.02, 0, 0.01), (0.02, 0.02, 0), (0, 0.02, -0.01), (0, 0, 0)],
        (0, 0, 0, 1 / 3, 2 / 3, 1, 1, 1),
    )
    path = make_path(curve, uniform_parameter(0.2, DT))
    run = simulate(loop(reference=sampled), gains(), scenario(), path, 1000)
    assert run.final.left_path_at == -1
    assert 0 < run.report.ate < 5e-4


# --- end to end under the transforms ------------------------------------------------------------


def test_jit_vmap_grad_through_everything():
    """By gains, plant, lag, sensor and path at once: finite, forward equal to reverse, equal to
    differences along the gains."""
    base = loop(reference=HELIX, segment=20)

    def score(numbers, scene, path):
        run = simulate(base, numbers, scene, path, 60)
        return 1e6 * run.report.ate

    scene = scenario(delay=2.0, lag=5e-4, resolution=0.0, amplitude=2.0)
    numbers = jax.tree.map(jnp.asarray, gains())
    moving = (scene.plant, scene.load, scene.drive.lag, scene.sensor.bandwidth)

    def of(numbers, moving, path):
        plant, load, lag, bandwidth = moving
        changed = replace(
            scene, plant=plant, load=load, drive=replace(scene.drive, lag=lag),
            sensor=replace(scene.sensor, bandwidth=bandwidth),
        )  # fmt: skip
        return score(numbers, changed, path)

    moving = jax.tree.map(jnp.asarray, (*moving[:3], 2000.0))
    args = (numbers, moving, PATH)

    @jax.jit
    def both(args, direction):
        return jax.grad(lambda a: of(*a))(args), jax.jvp(lambda a: of(*a), (args,), (direction,))

    direction = jax.tree.map(lambda x: 0.01 * x, args)
    reverse, (_, forward) = both(args, direction)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(reverse))
    pairs = zip(jax.tree.leaves(reverse), jax.tree.leaves(direction), strict=True)
    np.testing.assert_allclose(sum(np.vdot(a, b) for a, b in pairs), forward, rtol=1e-8)
    h = 1e-4
    up, down = (
        both(jax.tree.map(lambda x, d, s=s: x + s * d, args, direction), direction)[1][0]
        for s in (h, -h)
    )
    np.testing.assert_allclose((up - down) / (2 * h), forward, rtol=1e-5)


def test_a_population_is_vmap_over_gains_and_loads():
    base = loop()
    stiff = jnp.asarray([500.0, 1000.0])
    loads = jnp.asarray([[20.0, 15, 10], [-5.0, 0, 5]])

    def score(k, bias):
        scene = scenario()
        scene = replace(scene, load=replace(scene.load, bias=bias))
        return simulate(base, gains(k), scene, PATH, 100).report.ate

    many = jax.jit(jax.vmap(score))(stiff, loads)
    single = [float(score(k, b)) for k, b in zip(stiff, loads, strict=True)]
    np.testing.assert_allclose(many, single, rtol=1e-8)
    assert many[0] != many[1]


def test_equal_loops_share_one_compilation():
    before = _simulate._cache_size()
    for _ in range(2):
        law = cross_coupled(
            plus(per_axis(sliding(smooth)), per_axis(disturbance_observer)), pid_contour()
        )
        again = loop(controller=law, drive=current_drive(3), plant=pmlsm_stage(), dt=DT)
        simulate(again, gains(), scenario(), PATH, 17)
    assert _simulate._cache_size() == before + 1


# --- small things ---------------------------------------------------------------------------------


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
