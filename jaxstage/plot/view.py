"""A recorded run as plain arrays, ready to draw, with the words that go on every figure."""

from typing import Any, NamedTuple

import jax
import numpy as np

from jaxstage import __version__
from jaxstage.metrics import columns
from jaxstage.metrics.words import time_text
from jaxstage.model.fields import leaves
from jaxstage.model.signals import Sample
from jaxstage.studies import Case
from jaxstage.studies.verdict import scored_text, verdict


class View(NamedTuple):
    """One run. Arrays cover the ticks before it was lost, and all of them if it was not.

    reference, velocity: commanded motion, (ticks, axes). error, rate: following error and its
    derivative. tool, nearest: the tool, and the curve point nearest to it. distance, arc: contour
    error and where on the lap. weights, surface, slope: of the law, None where it has none.
    schedule: K_P, K_I, K_D of a law that schedules them, (ticks, 3), or None.
    curve: one lap of the reference. laps: (start, stop) of each lap, ``scored`` that of the scored
    part. lost: tick at which the run was lost, or None.
    """

    name: str
    axes: tuple[str, ...]
    command_unit: str
    dt: float
    time: np.ndarray
    reference: np.ndarray
    velocity: np.ndarray
    tool: np.ndarray
    error: np.ndarray
    rate: np.ndarray
    nearest: np.ndarray
    distance: np.ndarray
    arc: np.ndarray
    command: np.ndarray
    demand: np.ndarray
    weights: np.ndarray | None
    surface: np.ndarray | None
    slope: np.ndarray | None
    schedule: np.ndarray | None
    curve: np.ndarray
    heading: np.ndarray
    laps: tuple[tuple[int, int], ...]
    scored: tuple[int, int]
    scored_text: str
    duration: float
    lost: int | None
    verdict: str
    footer: str

    def scored_ticks(self) -> slice:
        """The ticks to judge by: the scored ones, or all there are if none was reached."""
        return slice(*self.scored) if self.scored[1] > self.scored[0] else slice(None)

    def is_scored(self, lap: tuple[int, int]) -> bool:
        """True for one of ``laps`` that lies in the scored part."""
        return self.scored[0] <= lap[0] and lap[1] <= self.scored[1]


def view(case: Case, report: Any, rows: Sample, because: str = "the run was lost") -> View:
    """What the pictures draw.

    report: the metrics of the scored part. rows: what the metric `record` stored of the whole run.
    because: why the run was lost, if it was (only `Run.final` knows).
    """
    tool = np.asarray(rows.output.position)
    broken = ~np.isfinite(tool).all(axis=1)
    lost = int(broken.argmax()) if broken.any() else None
    kept = slice(lost)
    lap = case.window.lap
    curve = jax.vmap(case.loop.reference.sample, (None, 0))(
        case.path, jax.numpy.arange(min(lap, len(tool)) + 1)
    )
    count = len(tool[kept])
    setpoint, output, nearest = rows.setpoint, rows.output, rows.nearest
    return View(
        name=case.name,
        axes=case.loop.plant.axes,
        command_unit=case.loop.plant.command_unit,
        dt=case.loop.dt,
        time=np.arange(count) * case.loop.dt,
        reference=_array(setpoint.position, kept),
        velocity=_array(setpoint.velocity, kept),
        tool=tool[kept],
        error=_array(setpoint.position, kept) - tool[kept],
        rate=_array(setpoint.velocity, kept) - _array(output.velocity, kept),
        nearest=_array(nearest.point, kept),
        distance=_array(nearest.distance, kept),
        arc=_array(nearest.arc, kept),
        command=_array(rows.command, kept),
        demand=_array(rows.demand, kept),
        weights=_optional(rows.memory, "weights", kept),
        surface=_optional(rows.memory, "surface", kept),
        slope=_optional(case.gains, "slope", slice(None)),
        schedule=_schedule(rows.memory, kept),
        curve=np.asarray(curve.position),
        heading=np.asarray(curve.tangent[0]),
        laps=tuple((k, min(k + lap, count)) for k in range(0, count, lap)),
        scored=(min(case.window.start, count), min(case.window.stop, count)),
        scored_text=scored_text(case),
        duration=len(tool) * case.loop.dt,
        lost=lost,
        verdict=verdict(case, columns(report, case.loop.plant), lost, because),
        footer=_footer(case, str(tool.dtype)),
    )


def _array(values: Any, kept: slice) -> np.ndarray:
    return np.asarray(values)[kept].astype(float)


def _optional(tree: Any, name: str, kept: slice) -> np.ndarray | None:
    """The first field called ``name`` anywhere below ``tree``: laws may be nested."""
    named = (value for path, _, value in leaves(tree) if path.rsplit(".", 1)[-1] == name)
    value = next(named, None)
    return None if value is None else _array(value, kept)


def _schedule(memory: Any, kept: slice) -> np.ndarray | None:
    names = ("proportional_gain", "integral_gain", "derivative_gain")
    scheduled = [_optional(memory, name, kept) for name in names]
    gains = [values for values in scheduled if values is not None]
    return np.stack(gains, axis=1) if len(gains) == len(names) else None


def _footer(case: Case, dtype: str) -> str:
    lap = case.window.lap * case.loop.dt
    seed = int(jax.random.key_data(case.scenario.key)[-1])
    substeps = f"{case.loop.substeps} substep{'s' if case.loop.substeps > 1 else ''}"
    parts = (
        f"{case.window.laps:.4g} lap{'' if case.window.laps == 1 else 's'} of {time_text(lap)}",
        f"control period {time_text(case.loop.dt)}, {substeps}",
        f"{'double' if dtype == 'float64' else 'single'} precision",
        f"seed {seed}",
        f"jaxstage {__version__}",
    )
    return "   |   ".join(parts)
