"""What a study is made of: a published system, its loops and what is claimed about them."""

from collections.abc import Callable, Mapping
from typing import Any

from jaxstage.model.blocks import Metric
from jaxstage.model.fields import definition
from jaxstage.studies.case import Case, Timing
from jaxstage.studies.claim import Claim
from jaxstage.studies.experiment import Experiment
from jaxstage.studies.plots import ChartPlot, RunPlot


def no_notes(case: Case, metrics: Mapping[str, Any]) -> tuple[str, ...]:
    """Nothing the user should know about the run."""
    return ()


@definition
class RecordedMetric:
    """A metric that needs every tick, such as a spectrum: for single runs only.

    Attributes:
        metric: Stores what it needs.
        evaluate: Its report, of any part of the rows that were stored, and of the control period.
    """

    metric: Metric
    evaluate: Callable[[Any, float], Any]


@definition
class NamedLoop:
    """An entry of a study: name, one line on it, how to build it, its own timing, what the user
    should know about a run of it (a limit that its gains pass, one line each, from the case and
    the scored columns), and the recorded metrics of a single run."""

    name: str
    summary: str
    build: Callable[[Timing], Case]
    timing: Timing = Timing()
    notes: Callable[[Case, Mapping[str, Any]], tuple[str, ...]] = no_notes
    recorded: tuple[RecordedMetric, ...] = ()


@definition
class Spread:
    """How uncertain a value is: factors low..high on what stands at ``path`` of the scenario.

    path: as in ``--set``, e.g. ``plant.mass``. reason: published, or chosen and why.
    """

    path: str
    low: float
    high: float
    reason: str


@definition
class Box:
    """Where a gain is searched when its loop is tuned: low..high, SI.

    path: end of its path among the gains, e.g. ``slope`` or ``extra.scales.rate``; laws without it
    are not concerned. tied: one number moves all axes. reason: why these ends.
    """

    path: str
    low: float
    high: float
    reason: str
    tied: bool = False


@definition
class Study:
    """A system: its source, loops, references, spreads, boxes of its gains; what a paper claims of
    it, the experiments that decide that, and plots."""

    name: str
    title: str
    source: str
    loops: tuple[NamedLoop, ...]
    references: tuple[str, ...] = ()
    spreads: tuple[Spread, ...] = ()
    boxes: tuple[Box, ...] = ()
    experiments: tuple[Experiment, ...] = ()
    claims: tuple[Claim, ...] = ()
    plots: tuple[ChartPlot | RunPlot, ...] = ()
