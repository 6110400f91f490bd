"""The frequency view of a loop that is ready to run: operating point, margins, what to know.

import jaxstage as js
js.frequency.margins(js.build("cascade-circle"), at=0.05)["axes"]["x"]["pm_deg"]
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.frequency.linear import (
    CUTS,
    Cut,
    LinearModel,
    linearise_at,
    operating_carry,
    unsteadiness,
)
from jaxstage.frequency.margins import (
    ROUNDING,
    SILENT,
    LoopMargins,
    Response,
    bandwidth,
    decibels,
    grid,
    largest_singular_value,
    loop_margins,
    peak,
)
from jaxstage.frequency.response import compliance, sensitivity, tracking
from jaxstage.frequency.sweep import SineResponse, sine_sweep, whole_turns
from jaxstage.frequency.wrappers import Straight, straight
from jaxstage.model.blocks import scan
from jaxstage.model.fields import replace
from jaxstage.simulate.gradients import kinks
from jaxstage.simulate.rollout import simulate
from jaxstage.simulate.stability import spectral_radius
from jaxstage.studies.case import Case

#: control periods on the operating motion before the loop is linearised
AFTER = 2000
#: largest relative change of A in a period of a loop that counts as steady
STEADY = 1e-6
#: an eigenvalue beyond 1 by this many times the change of A in a period is an instability; below
#: it is the adaptation of a frozen picture
DRIFT = 10.0
#: frequencies of a sine sweep
SINES = 16


class FrequencyView(NamedTuple):
    """A linearised loop with its responses.

    Attributes:
        case: the case on its operating motion.
        at: (axes,) m/s, speed of that motion.
        cut: where the loop was opened.
        model: the linear model.
        omega: (w,) rad/s, where the responses are drawn.
        radius: spectral radius of a control period.
        unsteadiness: relative change of A from one period to the next.
        sines: sine sweeps, by axis name.
        simplified: what the linear view leaves out of the case.
    """

    case: Case
    at: np.ndarray
    cut: Cut
    model: LinearModel
    omega: np.ndarray
    radius: float
    unsteadiness: float
    sines: dict[str, SineResponse]
    simplified: tuple[str, ...]

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""
        return self.case.loop.plant.axes

    @property
    def stable(self) -> bool:
        """Whether no disturbance grows faster than the model itself changes with time."""
        return self.radius < 1 + max(ROUNDING, DRIFT * self.unsteadiness)

    def element(self, matrix: Response, axis: int) -> Response:
        """One axis of a matrix response, the other axes closed."""
        return lambda omega: matrix(omega)[..., axis, axis]


def feed_per_axis(case: Case) -> float:
    """Mean commanded speed of a case over sqrt(axes), m/s: its default operating point."""
    ticks = jnp.arange(min(case.window.lap, case.window.ticks))
    velocity = jax.vmap(case.loop.reference.sample, (None, 0))(case.path, ticks).velocity
    speed = float(jnp.mean(jnp.linalg.norm(velocity, axis=-1)))
    return speed / math.sqrt(len(case.loop.plant.axes))


def operating(case: Case, at: float | Sequence[float] | None = None) -> Case:
    """The case on a straight motion at constant speed, started matched.

    Args:
        case: any case.
        at: m/s, of every axis or one each; 0 is standstill; None: `feed_per_axis`.

    Raises:
        ValueError: for a wrong number of speeds, or one that is not finite.
    """
    axes = len(case.loop.plant.axes)
    speeds = np.atleast_1d(np.asarray(feed_per_axis(case) if at is None else at, float))
    if speeds.size not in (1, axes) or speeds.ndim != 1:
        names = ", ".join(case.loop.plant.axes)
        raise ValueError(f"at: {speeds.size} speeds for {axes} axes ({names}): give one, or each")
    if not np.isfinite(speeds).all():
        raise ValueError(f"at = {speeds.tolist()} m/s: must be finite")
    velocity = jnp.asarray(np.broadcast_to(speeds, axes).copy())
    scenario = replace(
        case.scenario,
        start=replace(case.scenario.start, offset=jnp.zeros(axes), velocity=jnp.ones(axes)),
    )
    loop = replace(case.loop, reference=straight(case.loop.dt), engine=scan, segment=0)
    path = Straight(begin=jnp.zeros(axes), velocity=velocity)
    return case._replace(loop=loop, scenario=scenario, path=path)


def _exact_encoder(case: Case) -> tuple[Case, tuple[str, ...]]:
    """A quantised position has slope 0: the linear view reads it exactly, and says so."""
    sensor = case.scenario.sensor
    resolution = getattr(sensor, "resolution", None)
    if resolution is None or not np.any(np.asarray(resolution) > 0):
        return case, ()
    exact = replace(sensor, resolution=jnp.zeros_like(resolution))
    note = "the encoder's resolution is 0 in the linear view: a quantised signal has slope 0"
    return case._replace(scenario=replace(case.scenario, sensor=exact)), (note,)


def view(
    case: Case,
    at: float | Sequence[float] | None = None,
    cut: Cut = "input",
    after: int = AFTER,
    band: tuple[float | None, float | None] = (None, None),
) -> FrequencyView:
    """Linearise a case at an operating point.

    Args:
        case: any case; its own motion is replaced by a straight one.
        at: m/s, of every axis or one each; 0 is standstill; None: `feed_per_axis`.
        cut: where the loop is opened: ``"input"`` or ``"position"``.
        after: control periods before, at least the dead time and two.
        band: lowest and highest frequency in Hz; None: from the sampling rate.

    Raises:
        ValueError: for a wrong argument, or a loop that is lost on the operating motion.
    """
    if cut not in CUTS:
        raise ValueError(f"cut = {cut}: must be one of {', '.join(CUTS)}")
    moved = operating(case, at)
    exact, simplified = _exact_encoder(moved)
    after = max(after, case.loop.drive.max_delay + 2)
    gone = simulate(exact.loop, exact.gains, exact.scenario, exact.path, after).final
    for tick, what in ((gone.left_path_at, "left the path"), (gone.non_finite_at, "diverged")):
        if int(tick) >= 0:
            raise ValueError(
                f"{case.name} {what} at tick {int(tick)} of the operating motion "
                f"({np.asarray(exact.path.velocity).tolist()} m/s): no operating point there"
            )
    parts = exact.loop, exact.gains, exact.scenario, exact.path
    carry = operating_carry(*parts, after, cut)
    model = linearise_at(*parts, carry, cut)
    drift = unsteadiness(*parts, carry, cut)
    radius = float(spectral_radius(model.a))
    speeds = np.asarray(exact.path.velocity)
    if not math.isfinite(radius):
        raise ValueError(f"{case.name}: the derivative of a control period is not finite there")
    omega = grid(model, *band)
    return FrequencyView(moved, speeds, cut, model, omega, radius, float(drift), {}, simplified)


def with_sines(
    seen: FrequencyView, amplitudes: Sequence[float], axes: Sequence[str] | None = None
) -> FrequencyView:
    """The view with sine sweeps of the full loop beside it, one an axis.

    Args:
        seen: the view.
        amplitudes: of the sine, in the unit of the command.
        axes: names; None: all.
    """
    case, dt = seen.case, seen.case.loop.dt
    low = max(seen.omega[0] / (2 * math.pi), 0.0)
    turns = whole_turns(low, seen.omega[-1] / (2 * math.pi), SINES, dt)
    names = seen.axes if axes is None else axes
    sines = {
        name: sine_sweep(
            case.loop,
            case.gains,
            case.scenario,
            case.path,
            seen.axes.index(name),
            amplitudes,
            turns,
        )
        for name in names
    }
    return seen._replace(sines=sines)


class _Responses(NamedTuple):
    """The responses of a view, each decomposed into modes once."""

    sensitivity: Response
    feedforward: Response
    feedback: Response
    compliance: Response


def _responses(model: LinearModel) -> _Responses:
    return _Responses(
        sensitivity(model), tracking(model), tracking(model, False), compliance(model)
    )


def _notes(seen: FrequencyView, responses: _Responses) -> list[str]:
    """What a reader of the linear view must know: where it does not hold."""
    case = seen.case
    said = list(seen.simplified)
    if not seen.stable:
        said.append(
            f"unstable: the spectral radius of a control period is {seen.radius:.6g}; an unstable "
            "loop has no margins"
        )
    if seen.unsteadiness > STEADY:
        said.append(
            f"not steady: the linear model changes by {seen.unsteadiness:.2g} of itself in one "
            "control period (a law that adapts): a frozen picture"
        )
    hidden = [k for k in kinks(case.loop, case.gains, case.scenario, case.path) if "sign" in k]
    if any(k.startswith("control") for k in hidden):
        said.append(
            f"the switching of {case.loop.controller.name} is invisible to a linearisation (the "
            "slope of a sign is 0): use --sine"
        )
    matrix = responses.sensitivity(seen.omega)
    for axis, name in enumerate(seen.axes):
        if np.abs(matrix[:, axis, axis] - 1).max() < SILENT:
            said.append(f"axis {name} sticks: L = 0; use --at SPEED or --sine AMPLITUDE")
    return said


def _axis(seen: FrequencyView, responses: _Responses, axis: int) -> dict[str, float | None]:
    hertz = 1 / (2 * math.pi)
    response = seen.element(responses.sensitivity, axis)
    soft = peak(seen.element(responses.compliance, axis), seen.omega)
    found: LoopMargins | None = loop_margins(response, seen.omega) if seen.stable else None
    up = found and found.gain_up
    down = found and found.gain_down
    phase = found and found.phase
    ahead, alone = (
        bandwidth(seen.element(matrix, axis), seen.omega) if seen.stable else None
        for matrix in (responses.feedforward, responses.feedback)
    )
    return {
        "gm_up_db": decibels(up.value) if up else None,
        "gm_up_Hz": up.omega * hertz if up else None,
        "gm_down_db": decibels(down.value) if down else None,
        "gm_down_Hz": down.omega * hertz if down else None,
        "pm_deg": phase.value if phase else None,
        "pm_Hz": phase.omega * hertz if phase else None,
        "delay_margin_us": found.delay * 1e6 if found and found.delay is not None else None,
        "ms": found.ms.value if found else None,
        "ms_Hz": found.ms.omega * hertz if found else None,
        "mt": found.mt.value if found else None,
        "bandwidth_Hz": ahead * hertz if ahead is not None else None,
        "bandwidth_feedback_Hz": alone * hertz if alone is not None else None,
        "stiffness_min_N_um": 1e-6 / soft.value if seen.stable and soft.value > 0 else None,
        "stiffness_Hz": soft.omega * hertz if seen.stable and soft.value > 0 else None,
    }


def _sines(seen: FrequencyView, responses: _Responses) -> list[dict[str, Any]]:
    rows = []
    for name, swept in seen.sines.items():
        axis = seen.axes.index(name)
        linear = responses.sensitivity(swept.omega)[:, axis, axis]
        for i, amplitude in enumerate(swept.amplitude):
            for k, omega in enumerate(swept.omega):
                gone = bool(swept.lost[i, k])
                measured = complex(swept.sensitivity[i, k])
                rows.append(
                    {
                        "axis": name,
                        "amplitude": float(amplitude),
                        "f_Hz": float(omega) / (2 * math.pi),
                        "s": None if gone else abs(measured),
                        "s_deg": None if gone else math.degrees(np.angle(measured)),
                        "s_linear": abs(complex(linear[k])),
                        "harmonics": None if gone else float(swept.harmonics[i, k]),
                        "lost": gone,
                    }
                )
    return rows


def answer(seen: FrequencyView, extra: Sequence[str] = ()) -> dict[str, Any]:
    """The view as one dictionary: what ``jaxstage frequency LOOP --json`` prints.

    Args:
        seen: the view.
        extra: further notes.

    Returns:
        The keys of the JSON object; a margin that does not exist is None.
    """
    responses = _responses(seen.model)
    stable = seen.stable
    coupled = largest_singular_value(responses.sensitivity, seen.omega) if stable else None
    return {
        "loop": seen.case.name,
        "at_m_s": {name: float(v) for name, v in zip(seen.axes, seen.at, strict=True)},
        "cut": seen.cut,
        "steady": seen.unsteadiness <= STEADY,
        "spectral_radius": seen.radius,
        "axes": {name: _axis(seen, responses, i) for i, name in enumerate(seen.axes)},
        "coupled": {
            "ms": coupled.value if coupled else None,
            "ms_Hz": coupled.omega / (2 * math.pi) if coupled else None,
        },
        "sine": _sines(seen, responses),
        "notes": [*_notes(seen, responses), *extra],
    }


def margins(
    case: Case,
    at: float | Sequence[float] | None = None,
    cut: Cut = "input",
    sine: Sequence[float] = (),
) -> dict[str, Any]:
    """Margins, bandwidth and stiffness of a case, per axis.

    Args:
        case: any case, of the library or the user's own.
        at: m/s, speed of every axis at the operating point, or one each; 0: standstill; None: mean
            feed of the case over sqrt(axes).
        cut: where the loop is opened: ``"input"``, at what reaches the plant, or ``"position"``.
        sine: amplitudes of a sine sweep of the full loop, in the unit of the command.

    Returns:
        What ``jaxstage frequency LOOP --json`` prints: ``axes`` by name, each with gain, phase and
        delay margin, Ms, Mt, bandwidth with feed-forward and of the position command alone, lowest
        dynamic stiffness; ``coupled``; ``spectral_radius``; ``steady``; ``sine``; ``notes``.

    Raises:
        ValueError: for a wrong argument, or a loop that is lost on the operating motion.
    """
    seen = view(case, at, cut)
    return answer(with_sines(seen, sine) if len(sine) else seen)
