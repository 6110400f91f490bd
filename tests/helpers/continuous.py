"""A closed loop in continuous time: plant, observer and contour law as one differential equation.

The classical Runge-Kutta method over everything that the loop integrates. All its right-hand sides
are functions of the library, those that the sampled loop steps by Euler; here nothing is held
between the stages, and what a law keeps for its ``settle`` is renewed at each.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.controllers import (
    cross_coupled,
    disturbance_observer,
    fuzzy_pid_contour,
    per_axis,
    plus,
)
from jaxstage.controllers.disturbance_observer import rate as observed
from jaxstage.controllers.fuzzy_pid_contour import kept
from jaxstage.controllers.fuzzy_pid_contour import rate as learned
from jaxstage.controllers.parts.contour_error import Form, vector
from jaxstage.hardware.drives import current_drive
from jaxstage.hardware.loads import sine_load
from jaxstage.hardware.sensors import ideal_sensor
from jaxstage.model.blocks import Controller, Reference
from jaxstage.model.fields import replace
from jaxstage.model.signals import Measurement, Output, Scenario, Setpoint
from jaxstage.numerics.geometry import norm
from jaxstage.numerics.integrate import shifted
from jaxstage.plants import pmlsm_stage
from jaxstage.plants.pmlsm_stage import slope
from jaxstage.references import helical

PLANT = pmlsm_stage()
DRIVE = current_drive()


class Continuous(NamedTuple):
    """What is fixed: law of one axis, form of the contour law, step in s, motion."""

    axis: Controller
    form: Form = vector
    dt: float = 1e-3
    reference: Callable[[float], Reference] = helical

    def controller(self) -> Controller:
        """The law with an observer beside and the adaptive fuzzy coupling on top."""
        observing = plus(per_axis(self.axis), per_axis(disturbance_observer))
        return cross_coupled(observing, fuzzy_pid_contour(self.form))


class State(NamedTuple):
    """Everything that has a derivative."""

    plant: Any
    estimate: Any
    learned: Any


class Row(NamedTuple):
    """The start of a step: following error, contour error true and estimated, demand, memory."""

    error: Array
    distance: Array
    estimate: Array
    demand: Array
    memory: Any


def _filled(memory: Any, state: State) -> Any:
    watching = replace(memory.law.extra, estimate=state.estimate)
    return replace(
        memory,
        law=replace(memory.law, extra=watching),
        extra=replace(memory.extra, learned=state.learned),
    )


def run(
    bench: Continuous,
    gains: Any,
    scene: Scenario,
    path: Any,
    steps: int,
    pick: Callable[[Row], Any] = lambda row: row,
) -> Any:
    """``pick`` of the rows of one run, at the starts of the steps and at the end: (steps + 1, ...).

    Its reverse mode keeps the state of every step and nothing else.
    """
    law, dt = bench.controller(), bench.dt
    reference = bench.reference(dt / 2)  # a Runge-Kutta step looks at its middle too

    def begin() -> State:
        first = reference.sample(path, jnp.zeros((), jnp.int32))
        x = first.position + scene.start.offset
        v = first.velocity * scene.start.velocity
        seen = Measurement(position=x, velocity=v, drive_position=x, drive_velocity=v)
        memory = law.init(gains, first, seen)
        plant = PLANT.init(scene.plant, seen)
        return State(plant, memory.law.extra.estimate, memory.extra.learned)

    def closed(state: State, half: Array) -> tuple[Setpoint, Output, Array, Array, Any]:
        setpoint = reference.sample(path, half)
        output = PLANT.observe(scene.plant, state.plant)
        seen, _ = ideal_sensor.read((), (), scene.key, output, dt)
        memory = _filled(law.init(gains, setpoint, seen), state)
        demand, memory = law.control(gains, memory, setpoint, seen, dt)
        drive = DRIVE.init(scene.drive, demand)
        command, _, _ = DRIVE.apply(scene.drive, drive, demand, dt)
        return setpoint, output, demand, command, memory

    def derivative(state: State, half: Array) -> State:
        _, output, _, command, memory = closed(state, half)
        force = sine_load.force(scene.load, half * (dt / 2), scene.key, output)
        return State(
            slope(scene.plant, state.plant, command, force),
            jax.vmap(observed)(gains.law.extra, memory.law.extra, command),
            learned(bench.form, gains.extra, memory.extra),
        )

    def step(state: State, half: Array) -> tuple[State, Any]:
        setpoint, output, demand, _, memory = closed(state, half)
        row = Row(
            setpoint.position - output.position,
            reference.nearest(path, half, output.position).distance,
            norm(memory.extra.error.deviation),
            demand,
            memory,
        )
        after = _runge_kutta(lambda at, halves: derivative(at, half + halves), state, dt)
        return after._replace(learned=kept(gains.extra.bounds, after.learned)), pick(row)

    light = jax.checkpoint(step, prevent_cse=False)
    return jax.lax.scan(light, begin(), 2 * jnp.arange(steps + 1, dtype=jnp.int32))[1]


def _runge_kutta(derivative: Callable[[State, Array], State], state: State, dt: float) -> State:
    """The classical method as a loop over its four stages: a quarter of the program to compile.

    derivative(state, halves): at 0, 1 or 2 halves of the step.
    """

    def stage(carry: tuple[State, State], how: tuple[Array, Array, Array]) -> Any:
        slope_before, total = carry
        reach, halves, weight = how
        k = derivative(shifted(state, slope_before, reach), halves)
        return (k, shifted(total, k, weight)), None

    zero = jax.tree.map(jnp.zeros_like, state)
    reach = jnp.array([0, dt / 2, dt / 2, dt])
    halves = jnp.array([0, 1, 1, 2], jnp.int32)
    weight = jnp.array([dt / 6, dt / 3, dt / 3, dt / 6])
    (_, after), _ = jax.lax.scan(stage, (zero, state), (reach, halves, weight))
    return after
