"""Laws of the study as compositions that share a loop, and the metrics of a run of one.

Each composition holds all that is varied; parts are switched off by their gains: adaptation and
MRAC by zero rates, position feed-forward by a zero amplitude. So all variants of a law run as one
batch. Every run stores the few signals that its metrics need.
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.controllers import (
    adaptive_sliding,
    cascade,
    model_reference,
    per_axis,
    position_feedforward,
    sliding,
)
from jaxstage.controllers.parts.input_sign import InputSign, forward
from jaxstage.metrics import (
    amplitude_spectrum,
    drive,
    drive_error,
    drive_following,
    quadrant_glitch,
    together,
    windowed,
)
from jaxstage.model.blocks import Controller, Metric
from jaxstage.model.fields import replace
from jaxstage.model.signals import Sample
from jaxstage.numerics.smooth import Switch, exact
from jaxstage.references import step, stepping, swing
from jaxstage.studies.case import Case, window
from jaxstage.studies.experiment import simulate_all, stored
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.mrac_asmc.loops import TIMING, Version, make_loop

#: the start from rest that is searched for the peak of breaking away, in s
START = 0.5
#: frequency bands of Figure 17, in Hz, and the lowest frequency that counts as chattering
BANDS = {
    "1_50": (1.0, 50.0),
    "50_150": (50.0, 150.0),
    "150_340": (150.0, 340.0),
    "50_340": (50.0, 340.0),
}
CHATTERING = 50.0
#: an error that stays below this is a steady state, in um (chosen: a fifth of the largest)
SETTLED = 10.0
#: when the paper reads off a final error, and when it looks at what adapts, in s
LATE = 11.9
MOMENTS = (1.7, 8.0)


class Composed(NamedTuple):
    """A composition and what it shows of its memory."""

    controller: Controller
    shown: Callable[[Any], dict[str, Array]]


def _nothing(memory: Any) -> dict[str, Array]:
    return {}


def _adapting(memory: Any) -> dict[str, Array]:
    inner = memory.law
    return {"slope": inner.slope, "gain": inner.switching_gain, "sharpness": inner.sharpness}


@functools.cache
def adaptive_law(input_sign: InputSign = forward) -> Composed:
    """The adaptive law; gains `values.ahead(values.inner(...))`."""
    law = per_axis(model_reference(adaptive_sliding(input_sign)))
    return Composed(position_feedforward(law), _adapting)


@functools.cache
def switched_law(switch: Switch = exact) -> Composed:
    """Sliding mode with a switch; gains `values.ahead(values.inner(...))`."""
    return Composed(position_feedforward(per_axis(model_reference(sliding(switch)))), _nothing)


#: The cascade; gains `values.ahead(...)`.
CASCADE = Composed(position_feedforward(per_axis(cascade)), _nothing)


def gains_of(law: Any, mrac: bool = False, feedforward: float = 0.0) -> Any:
    """Gains of `adaptive_law` and `switched_law`."""
    return values.ahead(values.inner(law, mrac), feedforward)


def _row(shown: Callable[[Any], dict[str, Array]], sample: Sample) -> dict[str, Array]:
    row = {
        "error": drive_error(sample),
        "velocity": sample.setpoint.velocity,
        "command": sample.command,
    }
    return row | shown(sample.memory)


@functools.cache
def trace(shown: Callable[[Any], dict[str, Array]]) -> Metric:
    """Stores the drive's error, the commanded velocity, the command and what the law shows."""
    return stored("trace", functools.partial(_row, shown))


def traced(law: Composed, gains: Any, drives: Version, period: float = values.PERIOD) -> Case:
    """A composition on one version of the drive, to and fro for the published 12 s."""
    ticks = window(TIMING, round(TIMING.lap_time / TIMING.dt))
    begin, span = (round(time / TIMING.dt) for time in (START, values.REVERSAL))
    peak = quadrant_glitch(values.REVERSAL, drive)
    metric = together(
        trace(law.shown),
        windowed(drive_following, 0, span + 1, name="start"),
        windowed(peak, begin, ticks.stop, name="reversals"),
    )
    return Case(
        name=law.controller.name,
        loop=make_loop(law.controller, drives, metric, TIMING),
        metric=metric,
        gains=jax.tree.map(jnp.asarray, gains),
        scenario=jax.tree.map(jnp.asarray, values.scenario(drives.rough)),
        path=jax.tree.map(jnp.asarray, swing(values.AMPLITUDE, period)),
        timing=TIMING,
        window=ticks,
    )


def stepped(law: Composed, gains: Any, drives: Version, height: float, duration: float) -> Case:
    """A composition on one version of the drive, asked for a step from rest."""
    case = traced(law, gains, drives)
    start = replace(case.scenario.start, offset=jnp.full(1, -height))
    ticks = window(replace(TIMING, duration=duration, skip=0.0), 1)
    loop = replace(case.loop, reference=stepping(TIMING.dt), metric=trace(law.shown))
    return case._replace(
        loop=loop,
        metric=loop.metric,
        scenario=replace(case.scenario, start=start),
        path=jax.tree.map(jnp.asarray, step(height)),
        window=ticks,
    )


# --- metrics ---------------------------------------------------------------------------------


def spectrum(error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz and amplitudes in the unit of the error, (ticks,)."""
    frequency, amplitude = amplitude_spectrum(jnp.asarray(error), TIMING.dt)
    return np.asarray(frequency), np.asarray(amplitude)


def _within(frequency: np.ndarray, band: tuple[float, float]) -> np.ndarray:
    return (frequency >= band[0]) & (frequency < band[1])


def window_metrics(error: np.ndarray, command: np.ndarray) -> dict[str, float]:
    """Metrics of the drive's error in um and of the command in N m, (ticks,) each.

    The level of a band is the root mean square of the amplitudes in it.
    """
    frequency, amplitude = spectrum(error)
    bands = {
        f"level_{name}_Hz_um": float(np.sqrt(np.mean(amplitude[_within(frequency, band)] ** 2)))
        for name, band in BANDS.items()
    }
    loss = float(values.plant().copper_loss[0])
    return bands | {
        "max_um": float(np.abs(error).max()),
        "mean_um": float(np.abs(error).mean()),
        "variance_um2": float(error.var()),
        "chattering_um": float(amplitude[frequency >= CHATTERING].max()),
        "command_step_Nm": float(np.abs(np.diff(command)).mean()),
        "motor_loss_W": loss * float((command**2).mean()),
    }


def settling(error: np.ndarray) -> float | None:
    """Time in s after which |e| stays below `SETTLED` um; None if it never does."""
    outside = np.flatnonzero(np.abs(error) >= SETTLED)
    after = 0 if len(outside) == 0 else int(outside[-1]) + 1
    return None if after == len(error) else after * TIMING.dt


def metrics(rows: Mapping[str, np.ndarray], start: int, stop: int) -> dict[str, Any]:
    """All metrics of the ticks from start to stop; rows: one axis, (ticks,).

    With the time of settling, the share of |e| that points along the motion, the error when the
    run is all but over, and the adapted values in the rad units of the paper.
    """
    error = rows["error"] * 1e6
    part, velocity = error[start:stop], rows["velocity"][start:stop]
    measured: dict[str, Any] = window_metrics(part, rows["command"][start:stop])
    measured["settled_s"] = settling(error)
    measured["along_motion"] = float((part * np.sign(velocity)).sum() / np.abs(part).sum())
    measured["late_um"] = float(abs(error[round(LATE / TIMING.dt)]))
    units = {"slope": 1.0, "gain": values.RATIO, "sharpness": 1 / values.RATIO}
    adapted = {name: rows[name] * unit for name, unit in units.items() if name in rows}
    for name, values_of in adapted.items():
        measured |= {
            f"{name}_{moment:g}_s": float(values_of[round(moment / TIMING.dt)])
            for moment in MOMENTS
        }
        measured[f"{name}_end"] = float(values_of[-1])
    return measured | {"trace": {"error_um": error, "command_Nm": rows["command"]} | adapted}


def run_metrics(cases: Mapping[str, Case], periods: Mapping[str, float]) -> dict[str, Any]:
    """Metrics of every case by name, of t >= `SKIP`; those of a lost run are None.

    periods: cases judged over the second half of their first period, of that length in s.
    """
    evidence: dict[str, Any] = {}
    for name, run in simulate_all(cases).items():
        start, stop = cases[name].window.start, cases[name].window.stop
        if name in periods:
            stop = round(periods[name] / TIMING.dt)
            start = stop // 2
        rows = {key: np.asarray(row)[:, 0] for key, row in run.rows["trace"].items()}
        measured = metrics(rows, start, stop) | {
            "start_peak_um": float(run.report["start"].drive_following_max[0]) * 1e6,
            "reversals_peak_um": float(run.report["reversals"].drive_glitch_max[0]) * 1e6,
        }
        lost = not np.isfinite(rows["error"]).all()
        evidence[name] = dict.fromkeys(measured, None) if lost else measured
    return evidence
