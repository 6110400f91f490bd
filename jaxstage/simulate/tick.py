"""One control period: observe, sense, control, drive, settle, plant, metric."""

# what JAX gives is partly untyped
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownLambdaType=false

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxstage.model.blocks import Loop
from jaxstage.model.fields import replace
from jaxstage.model.signals import Carry, Output, Power, Sample, Scenario


def tick(loop: Loop, gains: Any, scenario: Scenario, path: Any, carry: Carry) -> tuple[Carry, Any]:
    """Advance one run by one control period.

    The controller is called exactly once and its command held over the substeps (zero-order hold);
    sampling instants do not move when the number of substeps changes.

    Args:
        loop: What is fixed.
        gains: What is tuned.
        scenario: What is uncertain.
        path: Parameters of the reference.
        carry: Before the tick.

    Returns:
        The next carry, its flags untouched, and the row of the metric.
    """
    dtype = loop.plant.observe(scenario.plant, carry.state).position.dtype
    time = carry.step.astype(dtype) * loop.dt
    sensor_key, load_key = tick_keys(scenario, carry.step)

    with jax.named_scope("observe"):
        setpoint = loop.reference.sample(path, carry.step)
        output = loop.plant.observe(scenario.plant, carry.state)
        nearest = loop.reference.nearest(path, carry.step, output.position)
    with jax.named_scope("sense"):
        measurement, sensor = loop.sensor.read(
            scenario.sensor, carry.sensor, sensor_key, output, loop.dt
        )
    with jax.named_scope("control"):
        demand, memory = loop.controller.control(
            gains, carry.memory, setpoint, measurement, loop.dt
        )
    with jax.named_scope("drive"):
        command, applied, drive = loop.drive.apply(scenario.drive, carry.drive, demand, loop.dt)
    with jax.named_scope("settle"):
        settled = loop.controller.settle(gains, memory, demand, command, loop.dt)
    with jax.named_scope("plant"):
        state, between, power = substeps(loop, scenario, carry.state, applied, time, load_key)

    sample = Sample(
        step=carry.step,
        time=time,
        setpoint=setpoint,
        output=output,
        nearest=nearest,
        between=between,
        measurement=measurement,
        memory=memory,
        demand=demand,
        command=command,
        applied=applied,
        load=loop.load.force(scenario.load, time, load_key, output),
        power=power,
        storing=_storing(loop, scenario, carry.state, state),
    )
    with jax.named_scope("metric"):
        metric, row = loop.metric.update(carry.metric, sample, loop.dt)
    after = replace(
        carry,
        state=state,
        drive=drive,
        sensor=sensor,
        memory=settled,
        metric=metric,
        step=carry.step + 1,
    )
    return after, row


def _storing(loop: Loop, scenario: Scenario, before: Any, after: Any) -> Array:
    """Mean rate of the stored energy over a period, (axes,) W."""
    stored = loop.plant.stored
    return (stored(scenario.plant, after) - stored(scenario.plant, before)) / loop.dt


def tick_keys(scenario: Scenario, step: Array) -> Array:
    """The random keys of sensor and load at a tick, (2,)."""
    return jax.random.split(jax.random.fold_in(scenario.key, step))


def substeps(
    loop: Loop, scenario: Scenario, state: Any, applied: Array, time: Array, key: Array
) -> tuple[Any, Output, Power]:
    """Integrate the plant over one period with the applied command held.

    The load is evaluated at the time that the integrator asks for, its output at the start of
    the substep.

    Args:
        loop: What is fixed.
        scenario: What is uncertain.
        state: Of the plant at the start of the period.
        applied: Command that acts, (axes,) in the plant's unit.
        time: Start of the period in s.
        key: Random key of the load.

    Returns:
        The state at the end, outputs at the end of each substep (substeps, axes), mean power W.
    """
    h = loop.dt / loop.substeps

    def substep(before: Any, index: Array) -> tuple[Any, tuple[Output, Power]]:
        begin = time + index.astype(time.dtype) * h
        output = loop.plant.observe(scenario.plant, before)

        def force(fraction: Array | float) -> Array:
            return loop.load.force(scenario.load, begin + fraction * h, key, output)

        after = loop.plant.step(scenario.plant, before, applied, force, h)
        with jax.named_scope("ledger"):
            power = loop.plant.power(scenario.plant, before, after, applied, force, h)
        return after, (loop.plant.observe(scenario.plant, after), power)

    state, (between, powers) = lax.scan(
        substep, state, jnp.arange(loop.substeps, dtype=jnp.int32), unroll=loop.substeps == 1
    )
    return state, between, jax.tree.map(lambda p: jnp.mean(p, axis=0), powers)
