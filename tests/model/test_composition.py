"""Laws composed of others: what each part hears, and that parts which do nothing change nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.controllers import (
    Both,
    Coupled,
    DisturbanceObserver,
    Offset,
    PidContour,
    cascade,
    cross_coupled,
    disturbance_observer,
    offset_setpoint,
    per_axis,
    pid_contour,
    plus,
)
from jaxstage.metrics import tracking
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import gain, pytree, replace, signal
from jaxstage.simulate.rollout import simulate
from jaxstage.studies import Timing, build, with_metric
from jaxstage.studies.fuzzy_cmac.loops import LAWS, cascade_gains
from tests.helpers.batteries import (
    DT,
    ENTRIES,
    Lead,
    ahead,
    cast,
    table_loop,
)
from tests.helpers.law_bench import MOVING, bench, close, compiled


@pytree
class Heard:
    """What a `spy` was told."""

    demand: jax.Array = signal("A", "", "demand", shape="(axes,)")
    command: jax.Array = signal("A", "", "command", shape="(axes,)")
    position: jax.Array = signal("m", "", "setpoint", shape="(axes,)")


def _spy_control(gains, memory, wanted, measured, dt):
    return gains["demand"], replace(memory, position=wanted.position)


#: demands what its gains say, and remembers what it hears
spy = Controller(
    name="spy",
    init=lambda gains, wanted, measured: Heard(
        demand=jnp.zeros(2), command=jnp.zeros(2), position=wanted.position
    ),
    control=_spy_control,
    settle=lambda gains, memory, demand, command, dt: replace(
        memory, demand=demand, command=command
    ),
)


def spoken(x, y):
    return {"demand": jnp.asarray([x, y])}


@pytest.mark.fast
def test_per_axis_is_the_law_on_each_axis():
    for entry in ENTRIES[:5]:
        (single,) = (law.controller for law in LAWS if law.name == entry.name)
        gains = cast(entry.gains)
        wanted, measured = bench(MOVING)
        demands, memory = compiled(entry.name)(gains, (wanted, measured), 0.3)
        for i in range(2):
            pick = lambda tree, i=i: jax.tree.map(lambda x: x[i] if x.ndim else x, tree)  # noqa: E731
            own, sp, m = pick(gains), pick(wanted), pick(measured)
            kept = single.init(own, sp, m)
            for k in range(2):
                demand, kept = single.control(own, kept, sp, m, DT)
                kept = single.settle(own, kept, demand, jnp.clip(demand, -0.3, 0.3), DT)
                np.testing.assert_allclose(demand, demands[k, i], rtol=1e-12)
            close(kept, pick(memory), rtol=1e-12)


@pytest.mark.fast
def test_plus_adds_and_forwards_the_totals():
    law = plus(spy, plus(spy, spy))
    gains = Both(law=spoken(1, 2), extra=Both(law=spoken(10, 20), extra=spoken(100, 200)))
    wanted, measured = bench(MOVING)
    memory = law.init(gains, wanted, measured)
    demand, memory = law.control(gains, memory, wanted, measured, DT)
    np.testing.assert_array_equal(demand, [111, 222])
    command = jnp.asarray([50.0, 60.0])
    memory = law.settle(gains, memory, demand, command, DT)
    for heard in (memory.law, memory.extra.law, memory.extra.extra):
        np.testing.assert_array_equal(heard.demand, demand)
        np.testing.assert_array_equal(heard.command, command)


@pytest.mark.fast
def test_cross_coupling_is_an_acceleration_and_forwards_the_totals():
    law = cross_coupled(spy, spy)
    gains = Coupled(
        law=spoken(1, 2),
        extra=spoken(10, 20),
        command_per_acceleration=jnp.asarray([0.5, 0.25]),
    )
    wanted, measured = bench(MOVING)
    memory = law.init(gains, wanted, measured)
    demand, memory = law.control(gains, memory, wanted, measured, DT)
    np.testing.assert_array_equal(demand, [1 + 5, 2 + 5])
    memory = law.settle(gains, memory, demand, 0.5 * demand, DT)
    for heard, unit in ((memory.law, 1), (memory.extra, np.array([0.5, 0.25]))):
        np.testing.assert_array_equal(heard.demand, np.array([6, 7]) / unit)
        np.testing.assert_array_equal(heard.command, np.array([3, 3.5]) / unit)


@pytest.mark.fast
def test_a_gain_given_once_holds_for_all_axes():
    case = with_metric(build("dfcmac-circle", Timing(lap_time=0.05, laps=1)), tracking)
    once = replace(case.gains, slope=2.0, weights=np.zeros((4, 3, 3)))
    each = replace(case.gains, slope=np.full(2, 2.0))
    a, b = (replace(case, gains=g).simulate().report.ate for g in (once, each))
    np.testing.assert_array_equal(a, b)


@pytest.mark.fast
def test_offset_moves_what_the_law_follows_only():
    law = offset_setpoint(spy, "lead", ahead)
    gains = Offset(law=spoken(1, 2), offset=Lead(time=jnp.asarray(1e-3)))
    wanted, measured = bench(MOVING)
    for memory in (
        law.init(gains, wanted, measured),
        law.control(gains, spy.init(None, wanted, measured), wanted, measured, DT)[1],
    ):
        np.testing.assert_allclose(
            memory.position - wanted.position, 1e-3 * wanted.velocity, atol=1e-17
        )
    settled = law.settle(gains, memory, jnp.ones(2), jnp.zeros(2), DT)
    np.testing.assert_array_equal(settled.demand, [1, 1])


def test_a_composition_runs_as_its_parts():
    """A coupling and an observer that do nothing leave a run as it is, to the last digit."""
    axis = per_axis(cascade)
    none = DisturbanceObserver(
        disturbance_gain=np.full(2, 1e-300),
        velocity_gain=np.ones(2),
        nominal=cascade_gains().nominal,
    )
    zero = np.zeros(())
    no_coupling = PidContour(
        proportional_gain=zero, integral_gain=zero, derivative_gain=zero, rest_speed=1e-6, form=()
    )
    composed = cross_coupled(plus(axis, per_axis(disturbance_observer)), pid_contour())
    gains = Coupled(
        law=Both(law=cascade_gains(), extra=none),
        extra=no_coupling,
        command_per_acceleration=np.full(2, 3e-3),
    )
    loop, scenario, path = table_loop(axis)
    plain = simulate(loop, cascade_gains(), scenario, path, 300)
    wrapped = simulate(replace(loop, controller=composed), gains, scenario, path, 300)
    np.testing.assert_allclose(wrapped.report.ate, plain.report.ate, rtol=1e-9)


@pytree
class Weighted:
    """A gain with three entries an axis, as a tuple of one size is written."""

    weights: jax.Array = gain("1/s", "w", "weights", shape="(3,)")


def test_a_gain_of_one_described_size_is_spread_over_the_axes():
    law = Controller(
        name="weighted",
        init=lambda gains, setpoint, measurement: (),
        control=lambda gains, memory, setpoint, measurement, dt: (
            jnp.sum(gains.weights) * setpoint.position,
            (),
        ),
    )
    setpoint, measured = bench(MOVING)
    gains = Weighted(weights=jnp.array([1.0, 2.0, 3.0]))
    demand, _ = per_axis(law).control(gains, (), setpoint, measured, 1e-3)
    np.testing.assert_allclose(demand, 6 * setpoint.position)
    own = Weighted(weights=jnp.array([[1.0, 2.0, 3.0], [0.0, 0.0, 1.0]]))
    demand, _ = per_axis(law).control(own, (), setpoint, measured, 1e-3)
    np.testing.assert_allclose(demand, np.array([6.0, 1.0]) * setpoint.position)
