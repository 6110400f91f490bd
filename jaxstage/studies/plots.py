"""What is plotted of a study beside its verdicts: panels of its evidence, and recorded runs."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from jaxstage.model.fields import definition
from jaxstage.studies.case import Case
from jaxstage.studies.evidence import Evidence
from jaxstage.studies.packaged import packaged_toml


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


def over_time(title: str, y: str, lines: Iterable[Line]) -> Chart:
    """A panel of lines over time in s."""
    return Chart(title=title, x="time in s", y=y, lines=tuple(lines))


def bars(title: str, y: str, lines: Iterable[Line], text: str = "", log_y: bool = False) -> Chart:
    """A panel of groups of bars."""
    return Chart(title=title, x="", y=y, lines=tuple(lines), text=text, bars=True, log_y=log_y)


def of_cases(label: str, evidence: Evidence, metric: str, cases: Mapping[str, str]) -> Line:
    """One bar a case. cases: name below the bar -> case of the evidence."""
    return Line(label, tuple(cases), [evidence[case][metric] for case in cases.values()])


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


@definition
class PaperPlots:
    """The plots of one study: titles and texts of its ``plots.toml``."""

    entries: Mapping[str, Mapping[str, str]]
    words: Mapping[str, object]

    def chart(self, name: str, charts: Callable[[Evidence], tuple[Chart, ...]]) -> ChartPlot:
        """Panels of the evidence, under the name of an entry."""
        entry = self.entries[name]
        text = entry["text"].format(**self.words)
        return ChartPlot(name=name, title=entry["title"], text=text, charts=charts)


def paper_plots(study: str, **words: object) -> PaperPlots:
    """The plots of a study; words: what names in braces stand for."""
    return PaperPlots(entries=packaged_toml(study, "plots.toml"), words=words)
