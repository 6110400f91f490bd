"""Exact linearisation of a loop: the derivative of one control period at an operating point.

    z+ = A z + B w,    y = C z + D w

z: every real number that a control period hands to the next: plant, drive, sensor, controller.
w: (d, F, r, r', r''), each (axes,): d added at the cut, F the external force, and the setpoint.
y: (cut, tool, drive, demand), each (axes,): the signal behind the cut with d in it, positions of
tool and motor, and what the law asks for.

Nothing is approximated but the nonlinearity. The slope of a sign, or beyond a clip, is 0: what a
hard switch does is invisible here (`sine_sweep` shows it).
"""

from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.frequency.wrappers import (
    Displaced,
    Injected,
    Pushed,
    Shifted,
    displaced,
    injected,
    pushed,
    shifted,
)
from jaxstage.model.blocks import Loop, Metric, scan
from jaxstage.model.fields import replace
from jaxstage.model.signals import Carry, Sample, Scenario
from jaxstage.simulate.rollout import scan_ticks, start
from jaxstage.simulate.stability import as_vector, vector_of
from jaxstage.simulate.tick import tick

Cut = Literal["input", "position"]
CUTS: tuple[Cut, ...] = ("input", "position")

#: inputs and outputs of the model, in order; each has one element an axis
INPUTS = ("cut", "force", "position", "velocity", "acceleration")
OUTPUTS = ("cut", "tool", "drive", "demand")


class LinearModel(NamedTuple):
    """A sampled linear model of a loop.

    Attributes:
        a: (n, n), state to next state.
        b: (n, 5 axes), input to next state; inputs in the order of `INPUTS`.
        c: (4 axes, n), state to output; outputs in the order of `OUTPUTS`.
        d: (4 axes, 5 axes), input to output.
        dt: control period in s.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    dt: float | Array

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self.b.shape[-1] // len(INPUTS)

    def between(self, output: str, source: str) -> "LinearModel":
        """The part from one group of inputs to one of outputs, both (axes,)."""
        n = self.axes
        rows = slice(OUTPUTS.index(output) * n, (OUTPUTS.index(output) + 1) * n)
        columns = slice(INPUTS.index(source) * n, (INPUTS.index(source) + 1) * n)
        return self._replace(
            b=self.b[..., columns], c=self.c[..., rows, :], d=self.d[..., rows, columns]
        )


def opened(loop: Loop, cut: Cut) -> Loop:
    """The loop with a place for every input of the model, and the outputs as its row."""

    def update(acc: tuple[()], sample: Sample, dt: float) -> tuple[tuple[()], tuple[Array, ...]]:
        behind = sample.applied if cut == "input" else sample.measurement.position
        out = sample.output
        return (), (behind, out.position, out.drive_position, sample.demand)

    outputs = Metric(name="outputs", init=lambda first: (), update=update, finish=lambda acc: ())
    return replace(
        loop,
        drive=injected(loop.drive),
        load=pushed(loop.load),
        sensor=displaced(loop.sensor),
        reference=shifted(loop.reference),
        metric=outputs,
        engine=scan,
        segment=0,
    )


def _with_inputs(scenario: Scenario, path: Any, w: Array, cut: Cut) -> tuple[Scenario, Shifted]:
    d, force, r, v, a = w.reshape(len(INPUTS), -1)
    none = jnp.zeros_like(d)
    changed = replace(
        scenario,
        drive=Injected(added=d if cut == "input" else none, drive=scenario.drive),
        load=Pushed(added=force, load=scenario.load),
        sensor=Displaced(added=d if cut == "position" else none, sensor=scenario.sensor),
    )
    return changed, Shifted(position=r, velocity=v, acceleration=a, path=path)


@partial(jax.jit, static_argnums=(0, 4, 5))
def operating_carry(
    loop: Loop, gains: Any, scenario: Scenario, path: Any, after: int, cut: Cut = "input"
) -> Carry:
    """The carry of the opened loop after ``after`` control periods without a disturbance."""
    open_loop = opened(loop, cut)
    none = jnp.zeros(len(INPUTS) * len(loop.plant.axes))
    scenario, path = _with_inputs(scenario, path, none, cut)
    first = start(open_loop, gains, scenario, path)

    def advance(carry: Carry) -> tuple[Carry, None]:
        return tick(open_loop, gains, scenario, path, carry)[0], None

    return scan_ticks(open_loop, after, advance, first)[0]


@partial(jax.jit, static_argnums=(0, 5))
def linearise_at(
    loop: Loop, gains: Any, scenario: Scenario, path: Any, carry: Carry, cut: Cut = "input"
) -> LinearModel:
    """The model of the control period that follows a carry of `operating_carry`.

    Args:
        loop: the loop, as it is simulated.
        gains: of its controller.
        scenario: its uncertain part.
        path: parameters of ``loop.reference``.
        carry: the operating point.
        cut: where the loop is opened: ``"input"``, at what reaches the plant, or ``"position"``, at
            the measured position (the outer loop of a cascade).

    Returns:
        The model. Pure and differentiable: ``vmap`` over gains or scenarios is a batch.
    """
    open_loop = opened(loop, cut)
    z, rebuild = as_vector(carry)
    none = jnp.zeros(len(INPUTS) * len(loop.plant.axes), z.dtype)

    def period(z: Array, w: Array) -> tuple[Array, Array]:
        changed, moved = _with_inputs(scenario, path, w, cut)
        after, outputs = tick(open_loop, gains, changed, moved, rebuild(z))
        return vector_of(after), jnp.concatenate(outputs)

    a, c = jax.jacfwd(period, 0)(z, none)
    b, d = jax.jacfwd(period, 1)(z, none)
    return LinearModel(a, b, c, d, loop.dt)


@partial(jax.jit, static_argnums=(0, 4, 5))
def linearise(
    loop: Loop,
    gains: Any,
    scenario: Scenario,
    path: Any,
    after: int = 2000,
    cut: Cut = "input",
) -> LinearModel:
    """The model of the control period that follows the first ``after`` ones of a run.

    Args:
        loop: the loop, as it is simulated.
        gains: of its controller.
        scenario: its uncertain part.
        path: parameters of ``loop.reference``: the motion whose operating point is meant.
        after: control periods before; more than the dead time, and as many as the loop needs to
            be steady.
        cut: where the loop is opened, see `linearise_at`.

    Returns:
        The model. Pure and differentiable, the way to the operating point included.
    """
    carry = operating_carry(loop, gains, scenario, path, after, cut)
    return linearise_at(loop, gains, scenario, path, carry, cut)


@partial(jax.jit, static_argnums=(0, 5))
def unsteadiness(
    loop: Loop, gains: Any, scenario: Scenario, path: Any, carry: Carry, cut: Cut = "input"
) -> Array:
    """max |A(k+1) - A(k)| / max |A(k)|: 0 where the model does not change with time."""
    none = jnp.zeros(len(INPUTS) * len(loop.plant.axes))
    changed, moved = _with_inputs(scenario, path, none, cut)
    later = tick(opened(loop, cut), gains, changed, moved, carry)[0]
    first, second = (linearise_at(loop, gains, scenario, path, c, cut).a for c in (carry, later))
    return jnp.max(jnp.abs(second - first)) / jnp.max(jnp.abs(first))
