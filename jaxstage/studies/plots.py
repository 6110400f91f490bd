"""What is plotted of a study beside its verdicts: panels of its evidence, and recorded runs."""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxstage.model.fields import definition
from jaxstage.studies.case import Case
from jaxstage.studies.evidence import Evidence


class Line(NamedTuple):
    """One line of a chart; x may hold names, for bars."""

    label: str
    x: Any
    y: Any


class Chart(NamedTuple):
    """One panel. x, y: axis labels with units. text: how to read it. bars: x holds names. equal:
    one scale for both axes, for paths."""

    title: str
    x: str
    y: str
    lines: tuple[Line, ...]
    text: str = ""
    bars: bool = False
    log_x: bool = False
    log_y: bool = False
    equal: bool = False


@definition
class ChartPlot:
    """A picture of panels computed from the evidence. name: of the file. title: with its place in
    the paper. text: how to read it, one or two sentences."""

    name: str
    title: str
    text: str
    charts: Callable[[Evidence], tuple[Chart, ...]]


@definition
class RunPlot:
    """Pictures of one recorded run. name: of the files, before the name of each view. text: what
    figure of the paper it stands for. case: builds it. views: names of `jaxstage.plot` pictures."""

    name: str
    text: str
    case: Callable[[], Case]
    views: tuple[str, ...]
