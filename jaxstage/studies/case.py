"""A loop ready to run: what a study hands to a user."""

import math
from typing import Any, NamedTuple

from jaxstage.metrics import windowed
from jaxstage.model.blocks import Loop, Metric
from jaxstage.model.fields import definition, replace
from jaxstage.model.signals import Run, Scenario
from jaxstage.simulate.rollout import simulate


@definition
class Timing:
    """How a contour is driven.

    lap_time: s per lap. laps: laps in the run. scored: the lap that the metrics cover, 1 is the
    first; 0 the whole run; None the last lap. dt: control period in s. substeps: plant steps per
    period. feed: constant feed rate in mm/min in place of ``lap_time``, or None. duration: length
    of the run in s in place of ``laps``, or None. skip: s; the metrics cover all that comes later,
    in place of ``scored``, or None.
    """

    lap_time: float = 5.0
    laps: int = 2
    scored: int | None = None
    dt: float = 1e-4
    substeps: int = 1
    feed: float | None = None
    duration: float | None = None
    skip: float | None = None


def retimed(own: Timing, **changes: Any) -> Timing:
    """A loop's own timing with changes.

    What it leaves out at the start, and its duration, keep their share of a lap where the lap time
    changes, unless they are named too. Naming ``laps`` drops its duration, ``scored`` its skip.
    """
    follow: dict[str, Any] = {}
    if (lap_time := changes.get("lap_time")) is not None:
        share = lap_time / own.lap_time
        follow = {
            name: None if value is None else value * share
            for name, value in (("skip", own.skip), ("duration", own.duration))
        }
        follow["feed"] = None
    follow |= {"duration": None} if "laps" in changes else {}
    follow |= {"skip": None} if "scored" in changes else {}
    return replace(own, **(follow | changes))


class Window(NamedTuple):
    """What of a run is scored, in control periods.

    Attributes:
        ticks: Length of the run.
        start, stop: The scored part, from ``start`` to before ``stop``.
        laps: Laps in the run.
        scored: The scored lap, 1 is the first; 0 where the part is not one lap.
        lap: Length of a lap.
    """

    ticks: int
    start: int
    stop: int
    laps: float
    scored: int
    lap: int

    @property
    def scored_laps(self) -> float:
        """Laps in the scored part."""
        return (self.stop - self.start) / self.lap

    def refuse_part_of_a_lap(self, own: Timing) -> None:
        """Raise ValueError where less than a lap is scored, and less than with a loop's own timing.

        For timing that does not name what is scored.
        """
        duration = own.laps * own.lap_time if own.duration is None else own.duration
        least = min(1.0, (duration - (own.skip or 0.0)) / own.lap_time)
        # the ends of a part that is given in s are rounded to a control period each
        if self.stop - self.start < least * self.lap - 2:
            raise ValueError(
                f"only {self.scored_laps:.3g} lap of the run would be scored: must be >= "
                f"{least:.3g}; give more laps, or name the part with skip (s) or scored (lap)"
            )


#: ticks and substeps of a run are counted in 32 bits, and a lap is kept in memory
MOST_STEPS = 2**31 - 1
MOST_LAP_TICKS = 50_000_000


def check_timing(timing: Timing) -> None:
    """Raise ValueError for impossible timing, naming the value and its range."""
    positive = {"lap_time": timing.lap_time, "dt": timing.dt}
    positive |= {"feed": timing.feed} if timing.feed is not None else {}
    positive |= {"duration": timing.duration} if timing.duration is not None else {}
    for name, value in positive.items():
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} = {value}: must be > 0 {'mm/min' if name == 'feed' else 's'}")
    if timing.skip is not None and not (math.isfinite(timing.skip) and timing.skip >= 0):
        raise ValueError(f"skip = {timing.skip}: must be >= 0 s")
    for name in ("laps", "substeps"):
        value = getattr(timing, name)
        if not (value >= 1 and value % 1 == 0):
            raise ValueError(f"{name} = {value}: must be a whole number >= 1")
    if timing.feed is None and timing.lap_time / timing.dt > MOST_LAP_TICKS:
        raise ValueError(
            f"lap_time = {timing.lap_time} s at dt = {timing.dt} s: "
            f"must be <= {MOST_LAP_TICKS} control periods"
        )


def window(timing: Timing, lap_ticks: int) -> Window:
    """The ticks of a run and of its scored part. Raises ValueError when they do not fit."""
    ticks = timing.laps * lap_ticks
    if timing.duration is not None:
        ticks = round(timing.duration / timing.dt)
        if ticks < 1:
            raise ValueError(f"duration = {timing.duration} s: must be >= dt = {timing.dt} s")
    if ticks * timing.substeps > MOST_STEPS:
        raise ValueError(
            f"laps, duration, dt and substeps give {ticks * timing.substeps:.3g} plant steps: "
            f"must be <= {MOST_STEPS}"
        )
    whole_laps = ticks // lap_ticks
    scored = whole_laps if timing.scored is None else timing.scored
    laps = ticks / lap_ticks
    laps = int(laps) if laps == int(laps) else laps
    if timing.skip is not None:
        start = math.ceil(timing.skip / timing.dt * (1 - 1e-12))
        if start >= ticks:
            raise ValueError(
                f"skip = {timing.skip:g} s: must be < the run of {ticks * timing.dt:g} s: more "
                "laps, or less skip"
            )
        return Window(ticks, start, ticks, laps, 0, lap_ticks)
    if scored == 0:
        return Window(ticks, 0, ticks, laps, 0, lap_ticks)
    if scored % 1 != 0 or not 1 <= scored <= whole_laps:
        raise ValueError(
            f"scored = {scored}: must be 0 (whole run) or a whole lap of the run, 1..{whole_laps}"
        )
    return Window(ticks, (scored - 1) * lap_ticks, scored * lap_ticks, laps, scored, lap_ticks)


class Case(NamedTuple):
    """Everything `simulate` needs; ``loop.metric`` is ``metric`` over the scored window."""

    name: str
    loop: Loop
    metric: Metric
    gains: Any
    scenario: Scenario
    path: Any
    timing: Timing
    window: Window

    def simulate(self) -> Run:
        """Run the case."""
        return simulate(self.loop, self.gains, self.scenario, self.path, self.window.ticks)


def scored(metric: Metric, ticks: Window) -> Metric:
    """The metric over the scored ticks only."""
    return windowed(metric, ticks.start, ticks.stop, name="scored")


def with_metric(case: Case, metric: Metric) -> Case:
    """The case with another metric."""
    return case._replace(loop=replace(case.loop, metric=metric))


def with_scored_metric(case: Case, metric: Metric) -> Case:
    """The case whose scored ticks are judged by another metric, usually ``standard(extra=...)``."""
    return case._replace(metric=metric, loop=replace(case.loop, metric=scored(metric, case.window)))
