"""Loops of the model-reference and adaptive sliding-mode study.

Each law runs on four versions of the drive: friction on the load or on the motor (suffix
``-motor``), ideal measurement or scenario R (suffix ``-r``). All laws act on the motor side.
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxstage.controllers import (
    AdaptiveSliding,
    ModelReference,
    adaptive_sliding,
    cascade,
    model_reference,
    per_axis,
    sliding,
)
from jaxstage.controllers.adaptive_sliding import sampled_gain
from jaxstage.hardware.drives import current_drive
from jaxstage.hardware.loads import no_load
from jaxstage.hardware.sensors import encoder, ideal_sensor, motor_side
from jaxstage.metrics import (
    adapted,
    drive,
    drive_chattering,
    drive_following,
    quadrant_glitch,
    recorded_drive_error,
    standard,
)
from jaxstage.model.blocks import Controller, Loop, Metric
from jaxstage.plants import on_load, on_motor, two_inertia
from jaxstage.plants.two_inertia import FrictionSide
from jaxstage.references import swing, swinging
from jaxstage.studies.case import Case, Timing, check_timing, scored, window
from jaxstage.studies.law import StudyLaw, named
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.study import Box, NamedLoop, RecordedMetric, Spread

#: following error beyond which a run counts as lost: five strokes (chosen)
PATH_LIMIT = 0.01
#: the adaptation counts as run away beyond so many times the limit of the sampled loop (chosen)
RUNAWAY = 10.0
#: the one axis
AXIS = "x"

TIMING = Timing(
    lap_time=values.PERIOD,
    dt=values.DT,
    substeps=values.SUBSTEPS,
    duration=values.DURATION,
    skip=values.SKIP,
)

_COMMISSIONED = "chosen: what is left after commissioning a drive"
_DRY = "chosen: dry friction moves with temperature and lubrication; F_s stays above F_c"

#: how uncertain the drive is
SPREADS = (
    Spread(path="plant.motor_inertia", low=0.95, high=1.05, reason=_COMMISSIONED),
    Spread(path="plant.load_inertia", low=0.7, high=1.5, reason="chosen: workpieces"),
    Spread(path="plant.stiffness", low=0.8, high=1.2, reason=_COMMISSIONED),
    Spread(path="plant.damping", low=0.1, high=1.5, reason="chosen: rarely identified"),
    Spread(path="plant.friction.coulomb", low=0.7, high=1.3, reason=_DRY),
    Spread(path="plant.friction.static", low=0.9, high=1.3, reason=_DRY),
    Spread(path="plant.friction.viscous", low=0.5, high=1.5, reason=_DRY),
)

_POLES = "chosen: up to a tenth of the sampling rate"
_AROUND = "chosen: a factor 10 around the value here"

#: where the gains are searched
BOXES = (
    Box(path="slope", low=10.0, high=1000.0, reason="chosen: c T stays below one half"),
    Box(path="switching_gain", low=1e-3, high=5.0, reason="chosen: far below and above friction"),
    Box(path="sharpness", low=5e2, high=5e5, reason=_AROUND),
    Box(path="switch.width", low=1e-5, high=1e-1, reason="chosen: sharp to next to none"),
    Box(path="switch.layer", low=0.5, high=50.0, reason="chosen: dead-beat to next to none"),
    Box(path="position_gain", low=6.0, high=200.0, reason=_POLES),
    Box(path="velocity_gain", low=40.0, high=1000.0, reason=_POLES),
    Box(path="integral_gain", low=800.0, high=8e4, reason=_AROUND),
    Box(path="velocity_feedforward", low=0.5, high=1.5, reason="chosen: around full"),
)


def _surface(memory: Any) -> Array:
    return memory.surface


def _adapting(memory: Any, dt: float) -> tuple[Array, Array, Array, Array]:
    values = memory.slope, memory.switching_gain, memory.sharpness
    return *values, sampled_gain(*values, dt)


def _inner_surface(memory: Any) -> Array:
    return memory.law.surface


def _inner_adapting(memory: Any, dt: float) -> tuple[Array, Array, Array, Array]:
    return _adapting(memory.law, dt)


def _law(
    name: str,
    summary: str,
    controller: Controller,
    gains: Callable[[], Any],
    shown: tuple[Any, Any] = (_surface, None),
) -> StudyLaw:
    """shown: picks the sliding variable, and what adapts, out of the memory."""
    return StudyLaw(name, summary, controller, gains, surface=shown[0], adapting=shown[1])


_ADAPTIVE = (_surface, _adapting)
_INNER = (_inner_surface, _inner_adapting)
_MRAC = model_reference(adaptive_sliding())

LAWS = (
    _law("sim1", "adaptive sliding mode, fixed slope", adaptive_sliding(), values.sim1, _ADAPTIVE),
    _law(
        "sim2", "adaptive sliding mode, adaptive slope", adaptive_sliding(), values.sim2, _ADAPTIVE
    ),
    _law("smc1500", "sliding mode, eps = 1500", sliding(), lambda: values.sliding_mode(1500)),
    _law(
        "smc500-mrac",
        "sliding mode, eps = 500, MRAC inner loop",
        model_reference(sliding()),
        lambda: values.inner(values.sliding_mode(500)),
        (_inner_surface, None),
    ),
    _law(
        "asmc-mrac",
        "adaptive sliding mode, MRAC inner loop",
        _MRAC,
        lambda: values.inner(values.asmc()),
        _INNER,
    ),
    _law(
        "asmc-mrac-caps",
        "adaptive sliding mode with caps, MRAC inner loop",
        _MRAC,
        lambda: values.inner(values.asmc(True)),
        _INNER,
    ),
    _law("cascade", "PID with rate feed-forward", cascade, values.cascade_gains, (None, None)),
)


class Version(NamedTuple):
    """Which drive: the side of the friction, and whether it is scenario R."""

    suffix: str
    summary: str
    side: FrictionSide
    rough: bool


VERSIONS = (
    Version("", "ideal measurement, friction on the load", on_load, False),
    Version("-r", "scenario R, friction on the load", on_load, True),
    Version("-motor", "ideal measurement, friction on the motor", on_motor, False),
    Version("-r-motor", "scenario R, friction on the motor", on_motor, True),
)


def law(name: str) -> StudyLaw:
    """The law called ``name``."""
    return named(LAWS, name)


def version(suffix: str) -> Version:
    """The version with that suffix."""
    return next(version for version in VERSIONS if version.suffix == suffix)


def make_loop(controller: Controller, version: Version, metric: Metric, timing: Timing) -> Loop:
    """The drive under a law for one axis, or a composition of such laws, to and fro."""
    return Loop(
        plant=two_inertia((AXIS,), version.side),
        controller=controller,
        reference=swinging(timing.dt),
        load=no_load,
        sensor=motor_side(encoder if version.rough else ideal_sensor),
        drive=current_drive(1),
        metric=metric,
        dt=timing.dt,
        substeps=timing.substeps,
        path_limit=PATH_LIMIT,
    )


def build(law: StudyLaw, version: Version, timing: Timing) -> Case:
    """One law of the study on one version of the drive."""
    check_timing(timing)
    if timing.feed is not None:
        raise ValueError(f"feed = {timing.feed:g} mm/min: a motion to and fro has none; lap_time")
    ticks = window(timing, round(timing.lap_time / timing.dt))
    extra = (drive_following, quadrant_glitch(values.REVERSAL, drive))
    extra += (adapted(law.adapting),) if law.adapting else ()
    metric = standard(law.surface, contours=(), extra=extra, reversal=values.REVERSAL)
    return Case(
        name=law.name + version.suffix,
        loop=make_loop(per_axis(law.controller), version, scored(metric, ticks), timing),
        metric=metric,
        gains=jax.tree.map(jnp.asarray, law.gains()),
        scenario=jax.tree.map(jnp.asarray, values.scenario(version.rough)),
        path=jax.tree.map(jnp.asarray, swing(values.AMPLITUDE, timing.lap_time)),
        timing=timing,
        window=ticks,
    )


def oscillation(case: Case, metrics: Mapping[str, Any]) -> tuple[str, ...]:
    """Whether the switch is too stiff for the control period, at the start or the end of a run, and
    whether the law has run away. metrics: of the run's end; None where it was lost."""
    gains = case.gains.law if isinstance(case.gains, ModelReference) else case.gains
    if not isinstance(gains, AdaptiveSliding):
        return ()
    plant, dt = case.scenario.plant, case.loop.dt
    start = float(sampled_gain(gains.slope, gains.switching_gain, gains.sharpness, dt)[0])
    end = _of_the_axis(metrics, "sampled_gain_end")
    limit = float((2 * plant.motor_inertia / (plant.motor_inertia + plant.load_inertia))[0])
    lines = []
    if max(start, end or 0.0) > limit:
        at_the_end = "" if end is None else f" and {end:.3g} at the end"
        lines.append(
            f"eps a T/2 + c T = {start:.3g} at the start{at_the_end}; above 2 J_1/J = {limit:.4g} "
            f"the command oscillates at half the sampling rate, {0.5 / dt:.4g} Hz"
        )
    if end is not None and end > RUNAWAY * limit:
        lines.append(_run_away(gains, metrics))
    return tuple(lines)


def _of_the_axis(metrics: Mapping[str, Any], key: str) -> float | None:
    return (metrics.get(key) or {}).get(AXIS)


def _run_away(gains: AdaptiveSliding, metrics: Mapping[str, Any]) -> str:
    parts = []
    for name, key, unit, start in (
        ("c", "surface_slope_end_1_per_s", "1/s", gains.slope),
        ("eps", "switching_gain_end_m_per_s2", "m/s2", gains.switching_gain),
        ("a", "sharpness_end_s_per_m", "s/m", gains.sharpness),
    ):
        end = _of_the_axis(metrics, key)
        if end is not None:
            parts.append(f"{name} from {float(start[0]):.3g} to {end:.3g} {unit}")
    error = _of_the_axis(metrics, "drive_following_max_um")
    largest = "" if error is None else f"; largest error of the drive {error:.3g} um"
    return f"the adaptation has run away: {', '.join(parts)}{largest}; caps on c and a prevent it"


loops: tuple[NamedLoop, ...] = tuple(
    NamedLoop(
        name=law.name + version.suffix,
        summary=f"{law.summary}; {version.summary}",
        build=functools.partial(build, law, version),
        timing=TIMING,
        notes=oscillation,
        recorded=(RecordedMetric(metric=recorded_drive_error, evaluate=drive_chattering),),
    )
    for law in LAWS
    for version in VERSIONS
)
