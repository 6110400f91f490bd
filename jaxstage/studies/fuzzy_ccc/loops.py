"""The loops of the fuzzy cross-coupling study: five laws on the helix."""

import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.controllers import (
    cross_coupled,
    disturbance_observer,
    fuzzy_pid_contour,
    pd,
    per_axis,
    pid_contour,
    plus,
    sliding,
)
from jaxstage.hardware.drives import current_drive
from jaxstage.hardware.loads import sine_load
from jaxstage.hardware.sensors import ideal_sensor
from jaxstage.metrics import command_change, contour_gains, standard
from jaxstage.model.blocks import Controller, Loop
from jaxstage.model.signals import Scenario
from jaxstage.numerics.smooth import Switch, smooth
from jaxstage.plants import pmlsm_stage
from jaxstage.references import Helix, helical
from jaxstage.studies.case import Case, Timing, check_timing, scored, window
from jaxstage.studies.fuzzy_ccc import values
from jaxstage.studies.law import StudyLaw, named
from jaxstage.studies.study import Box, NamedLoop, Spread, no_notes

#: two turns in 10 s, judged as a whole as the paper does; the period is chosen
TIMING = Timing(lap_time=10.0, laps=1, scored=0, dt=2e-4)
#: following error beyond which a run counts as lost: the diameter of the helix (chosen)
PATH_LIMIT = 0.1

_COMMISSIONED = "chosen: what is left after commissioning a drive"

#: how uncertain the stage is
SPREADS = (
    Spread(path="plant.mass", low=0.8, high=1.2, reason="chosen: workpieces"),
    Spread(path="plant.force_constant", low=0.95, high=1.05, reason=_COMMISSIONED),
    Spread(path="plant.damping", low=0.5, high=1.5, reason=_COMMISSIONED),
    Spread(path="load.amplitude", low=0.5, high=1.5, reason='chosen: "randomly chosen" there'),
)

_POLES = "chosen: up to a tenth of the sampling rate"
_AROUND = "chosen: a factor 10 around the value here"
_BOUNDS = "chosen: the bounds of the adaptation"

#: where the gains are searched
BOXES = (
    Box(path="rules.proportional", low=1.0, high=4000.0, reason=_BOUNDS),
    Box(path="rules.integral", low=1.0, high=20000.0, reason=_BOUNDS),
    Box(path="rules.derivative", low=0.01, high=40.0, reason=_BOUNDS),
    Box(path="scales.deviation", low=5e-6, high=5e-4, reason=_AROUND),
    Box(path="scales.rate", low=2e-4, high=2e-2, reason=_AROUND),
    Box(path="scales.integral", low=5e-7, high=5e-5, reason=_AROUND),
    Box(path="adaptation.slope", low=3.0, high=300.0, reason=_AROUND),
    Box(path="adaptation.proportional_rate", low=40.0, high=4e5, reason="chosen: still to fast"),
    Box(path="adaptation.integral_rate", low=20.0, high=2e5, reason="chosen: still to fast"),
    Box(path="adaptation.derivative_rate", low=0.4, high=4e3, reason="chosen: still to fast"),
    Box(path="slope", low=1.0, high=300.0, reason=_POLES),
    Box(path="switch.width", low=2e-4, high=5e-2, reason="chosen: sharp to next to none"),
    Box(path="disturbance_gain", low=2.5e4, high=2.5e6, reason=_AROUND),
    Box(path="velocity_gain", low=100.0, high=3000.0, reason=_POLES),
    Box(path="proportional_gain", low=100.0, high=1e5, reason="chosen: weak to stiff"),
    Box(path="integral_gain", low=50.0, high=5e5, reason="chosen: weak to stiff"),
    Box(path="derivative_gain", low=1.0, high=1000.0, reason=_POLES),
)


def observing(switch: Switch = smooth) -> Controller:
    """Sliding mode on each axis with the observer beside it."""
    return plus(per_axis(sliding(switch)), per_axis(disturbance_observer))


def coupling(contour: Controller, switch: Switch = smooth) -> Controller:
    """A contour law on top of `observing`."""
    return cross_coupled(observing(switch), contour)


def observing_gains(axis: Any) -> Any:
    """Gains of `observing`."""
    return values.observed(values.sliding_gains(axis), axis)


def coupling_gains(contour: Any, axis: Any) -> Any:
    """Gains of `coupling`; contour: those of its contour law."""
    return values.coupled(observing_gains(axis), contour, axis)


def _fuzzy_gains(adapting: bool, axis: Any) -> Any:
    return coupling_gains(values.fuzzy_gains(adapting), axis)


def _inner(tree: Any) -> Any:
    return tree.law


def _bare_surface(memory: Any) -> Array:
    return memory.law.surface


def _surface(memory: Any) -> Array:
    return memory.law.law.surface


def _schedule(memory: Any) -> tuple[Array, Array, Array]:
    shown = memory.extra
    return shown.proportional_gain, shown.integral_gain, shown.derivative_gain


LAWS = (
    StudyLaw(
        name="none",
        summary="sliding mode with observer, no coupling",
        controller=observing(),
        gains=observing_gains,
        surface=_bare_surface,
        observed=lambda gains: gains,
    ),
    StudyLaw(
        name="pid-ccc",
        summary="the same with PID cross-coupling",
        controller=coupling(pid_contour()),
        gains=lambda axis: coupling_gains(values.pid_gains(), axis),
        surface=_surface,
        observed=_inner,
    ),
    *(
        StudyLaw(
            name=name,
            summary=summary,
            controller=coupling(fuzzy_pid_contour()),
            gains=functools.partial(_fuzzy_gains, adapting),
            surface=_surface,
            schedule=_schedule,
            observed=_inner,
        )
        for name, summary, adapting in (
            ("fuzzy-frozen", "the same, gains by fuzzy rules that do not learn", False),
            ("af-pid-ccc", "the same, adaptive fuzzy PID cross-coupling", True),
        )
    ),
    StudyLaw(
        name="pd",
        summary="PD with acceleration feed-forward, no observer",
        controller=per_axis(pd),
        gains=values.pd_gains,
    ),
)


def law(name: str) -> StudyLaw:
    """The law called ``name``."""
    return named(LAWS, name)


def _path(timing: Timing) -> Helix:
    """The helix of the study, its ten seconds stretched to a lap or driven at a feed in mm/min."""
    curve = values.path()
    length = TIMING.lap_time * np.hypot(curve.radius * curve.turn_rate, curve.climb_rate)
    lap = timing.lap_time if timing.feed is None else float(length / (timing.feed / 6e4))
    share = TIMING.lap_time / lap
    return Helix(
        radius=curve.radius,
        turn_rate=curve.turn_rate * share,
        climb_rate=curve.climb_rate * share,
    )


def build(law: StudyLaw, name: str, timing: Timing) -> Case:
    """One law of the study on its helix; a lap is two turns."""
    check_timing(timing)
    path = _path(timing)
    lap_time = TIMING.lap_time * float(values.path().turn_rate / path.turn_rate)
    shortest = lap_time if timing.duration is None else timing.duration
    if timing.dt > shortest:
        raise ValueError(f"dt = {timing.dt} s: must be <= {shortest:g} s, the length of the run")
    ticks = window(timing, round(lap_time / timing.dt))
    schedule = (contour_gains(law.schedule),) if law.schedule else ()
    metric = standard(law.surface, extra=(command_change, *schedule))
    loop = Loop(
        plant=pmlsm_stage(),
        controller=law.controller,
        reference=helical(timing.dt),
        load=sine_load,
        sensor=ideal_sensor,
        drive=current_drive(),
        metric=scored(metric, ticks),
        dt=timing.dt,
        substeps=timing.substeps,
        path_limit=PATH_LIMIT,
    )
    return Case(
        name=name,
        loop=loop,
        metric=metric,
        gains=jax.tree.map(jnp.asarray, law.gains(values.nominal())),
        scenario=jax.tree.map(jnp.asarray, values.scenario()),
        path=jax.tree.map(jnp.asarray, path),
        timing=timing,
        window=ticks,
    )


def left_over(gains: Any, scenario: Scenario) -> np.ndarray:
    """Amplitude of d - d^ in m/s2 of each axis: what the observer leaves of the sine load.

    |p (p + k2)| / |p^2 + k2 p + k1| at p = j omega. gains: of the observer.
    """
    load, mass = scenario.load, np.asarray(scenario.plant.mass)
    p = 1j * np.asarray(load.frequency)
    k1, k2 = np.asarray(gains.disturbance_gain), np.asarray(gains.velocity_gain)
    return np.abs(np.asarray(load.amplitude) / mass * p * (p + k2) / (p**2 + k2 * p + k1))


def _reaching(
    pick: Callable[[Any], Any], case: Case, metrics: Mapping[str, Any]
) -> tuple[str, ...]:
    """Says where the switching gain is below what the observer leaves of the load."""
    observed = pick(case.gains)
    rest = left_over(observed.extra, case.scenario)
    eta = np.broadcast_to(np.asarray(observed.law.switching_gain), rest.shape)
    return tuple(
        f"{axis}: switching gain {gain:g} m/s2 is below the {left:.3g} m/s2 that the observer "
        "leaves of the load; sliding is not guaranteed"
        for axis, gain, left in zip(case.loop.plant.axes, eta, rest, strict=True)
        if gain <= left
    )


#: each law under its short name and with the name of its path
loops: tuple[NamedLoop, ...] = tuple(
    NamedLoop(
        name=name,
        summary=f"{law.summary}, helix",
        build=functools.partial(build, law, name),
        timing=TIMING,
        notes=functools.partial(_reaching, law.observed) if law.observed else no_notes,
    )
    for law in LAWS
    for name in (law.name, f"{law.name}-helix")
)
