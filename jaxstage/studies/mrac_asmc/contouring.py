"""Two axes on a circle: the contour error of the load against that of the motor.

Not in the paper, whose axis runs alone: with encoders on the motors a law sees the motors, but it
is the load that cuts.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.controllers import per_axis
from jaxstage.hardware.drives import current_drive
from jaxstage.model.blocks import Reference
from jaxstage.model.fields import param, pytree, replace
from jaxstage.plants import two_inertia
from jaxstage.references import analytic
from jaxstage.studies.case import Case, window
from jaxstage.studies.evidence import Evidence
from jaxstage.studies.experiment import simulate_all, stored
from jaxstage.studies.law import StudyLaw
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.mrac_asmc.loops import TIMING, law, make_loop, version

AXES = ("x", "y")
#: radius in m and time of a lap in s; metrics cover the last of 1.25 laps (all chosen)
RADIUS, LAP, LAPS = 2e-3, 2.0, 1.25


@pytree
class Circle:
    """A circle about the origin, run through at constant speed: r = R (cos, sin)(2 pi t/T)."""

    radius: Array = param("m", "R", "radius", above=0.0, shown="mm")
    lap_time: Array = param("s", "T", "time of a lap", above=0.0)


def _position(path: Circle, time: Array) -> Array:
    angle = 2 * jnp.pi * time / path.lap_time
    return path.radius * jnp.stack([jnp.cos(angle), jnp.sin(angle)])


@functools.cache
def circling(dt: float) -> Reference:
    """The motion along a `Circle`; axes x, y. dt: control period in s."""
    return analytic("circling", _position, dt)


#: stores the contour error of the load and the positions of the motors
both_sides = stored(
    "both_sides", lambda sample: (sample.nearest.distance, sample.output.drive_position)
)


def _each_axis(tree: Any) -> Any:
    """What holds for the one axis of the study, for both."""
    return jax.tree.map(lambda x: jnp.repeat(x, len(AXES)) if jnp.ndim(x) else jnp.asarray(x), tree)


def circled(law: StudyLaw) -> Case:
    """Two drives with friction on the load, ideally measured at the motors, moving at the start."""
    drives = version("")
    loop = replace(
        make_loop(per_axis(law.controller), drives, both_sides, TIMING),
        plant=two_inertia(AXES, drives.side),
        drive=current_drive(len(AXES)),
        reference=circling(TIMING.dt),
    )
    scenario = _each_axis(values.scenario())
    moving = replace(scenario.start, velocity=jnp.ones(len(AXES)))
    return Case(
        name=law.name,
        loop=loop,
        metric=both_sides,
        gains=_each_axis(law.gains()),
        scenario=replace(scenario, start=moving),
        path=Circle(radius=jnp.asarray(RADIUS), lap_time=jnp.asarray(LAP)),
        timing=TIMING,
        window=window(replace(TIMING, duration=LAPS * LAP, skip=(LAPS - 1) * LAP), 1),
    )


def contour_errors(case: Case, rows: tuple[Any, Any]) -> dict[str, np.ndarray]:
    """Distance from the circle in um, (ticks,), of the load and of the motor."""
    load, motors = rows
    find = jax.jit(jax.vmap(case.loop.reference.nearest, in_axes=(None, 0, 0)))
    motor = find(case.path, jnp.arange(len(motors)), jnp.asarray(motors)).distance
    return {"load": np.asarray(load) * 1e6, "motor": np.asarray(motor) * 1e6}


def circles() -> Evidence:
    """RMS of both contour errors in um under two laws, and the errors themselves."""
    laws = (law("cascade"), law("asmc-mrac-caps"))
    cases = {f"xy-{law.name}": circled(law) for law in laws}
    evidence: dict[str, Any] = {}
    for name, run in simulate_all(cases).items():
        errors = contour_errors(cases[name], run.rows)
        scored = slice(cases[name].window.start, None)
        evidence[name] = {
            f"{side}_contour_rms_um": float(np.sqrt(np.mean(error[scored] ** 2)))
            for side, error in errors.items()
        } | {"trace": errors}
    return evidence
