"""What `jaxstage compare adaptive-smc` draws beside the verdicts, by the figures of the paper."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from jaxstage.studies.adaptive_smc.experiment_claims import matched
from jaxstage.studies.adaptive_smc.experiments import REGIMES, SLOPES, TRIALS, over_trials
from jaxstage.studies.adaptive_smc.loops import TIMING, build, law, scene
from jaxstage.studies.adaptive_smc.reading import (
    TABLE3,
    TABLE5,
)
from jaxstage.studies.evidence import Evidence
from jaxstage.studies.plots import Chart, ChartPlot, Line, RunPlot, bars, over_time, paper_plots

paper = paper_plots("adaptive-smc")

NAMES = {"smc": "SMC", "asmc": "ASMC", "smc-star": "SMC*", "smc-star-star": "SMC**"}
MEANING = {"s3": "smooth (fitted friction)", "s7": "switching (0.01 m/s²)"}
AXES = {"x": "axis 1", "y": "axis 2"}
TRIAL_NAMES = tuple(f"trial {seed + 1}" for seed in range(TRIALS))


def _signals(
    evidence: Evidence,
    runs: dict[str, str],
    signal: str,
    axis: int,
    scale: float = 1.0,
    span: tuple[float, float] = (0.0, np.inf),
) -> tuple[Line, ...]:
    """A stored signal of several runs, label -> run, in a span of time in s."""
    lines = []
    for label, run in runs.items():
        trace = evidence[f"{run}/trace"]
        shown = (trace["time"] >= span[0]) & (trace["time"] <= span[1])
        lines.append(Line(label, trace["time"][shown], trace[signal][shown, axis] * scale))
    return tuple(lines)


class _Signal(NamedTuple):
    name: str
    label: str
    scale: float


ERROR = _Signal("error", "following error in µm", 1e6)
COMMAND = _Signal("command", "command in V", 1.0)
#: close-up of chattering signals, s
CLOSE = (5.0, 5.3)


def _both_axes(
    evidence: Evidence, runs: dict[str, str], title: str, signal: _Signal, begin: float = 0.0
) -> list[Chart]:
    return [
        over_time(
            f"{title}, axis {axis + 1}",
            signal.label,
            _signals(evidence, runs, signal.name, axis, signal.scale, (begin, np.inf)),
        )
        for axis in (0, 1)
    ]


def _difference(
    evidence: Evidence, runs: dict[str, str], title: str, signal: _Signal, begin: float = 0.0
) -> Chart:
    """What the later runs differ by from the first, which they would hide."""
    lines, base = [], next(iter(runs))
    for axis in (0, 1):
        first, *others = _signals(evidence, runs, signal.name, axis, signal.scale, (begin, np.inf))
        lines += [Line(f"{o.label}, axis {axis + 1}", o.x, o.y - first.y) for o in others]
    return over_time(f"{title}, less {base}", signal.label, lines)


def _close(evidence: Evidence, runs: dict[str, str], title: str, signal: _Signal) -> Chart:
    lines = _signals(evidence, runs, signal.name, 0, signal.scale, CLOSE)
    return over_time(f"{title}, axis 1, close up", signal.label, lines)


def _step(evidence: Evidence) -> tuple[Chart, ...]:
    trace = evidence["step/trace"]
    labels = {"high": "(a) high", "low": "(b) low", "nonlinear": "(c) nonlinear"}
    lines = tuple(Line(label, trace["time"], trace[name]) for name, label in labels.items())
    return (Chart(title="damping", x="time × ω", y="output over step", lines=lines),)


def _figure4(evidence: Evidence) -> tuple[Chart, ...]:
    runs = {NAMES[name]: f"{name}-s1" for name in ("smc", "smc-star-star", "asmc")}
    return (
        *_both_axes(evidence, runs, "from rest", ERROR),
        _difference(evidence, runs, "from rest", ERROR),
    )


def _figure5(evidence: Evidence) -> tuple[Chart, ...]:
    runs = {NAMES[name]: f"{name}-s1" for name in ("smc-star-star", "asmc")}
    collapse = {"ASMC": "asmc-s7"}
    return (
        *(
            over_time(f"axis {axis + 1}", "gain K in 1/s", _signals(evidence, runs, "gain", axis))
            for axis in (0, 1)
        ),
        over_time(
            "axis 1, where switching dominates",
            "gain K in 1/s",
            _signals(evidence, collapse, "gain", 0),
        ),
    )


def _bars(
    evidence: Evidence,
    laws: tuple[str, ...],
    window: str,
    metric: str,
    unit: str,
    scale: float = 1.0,
) -> tuple[Chart, ...]:
    """One panel a regime (and axis, where the metric has axes), one group of bars a trial."""
    charts = []
    for regime in REGIMES:
        values_of = {a: over_trials(evidence, f"{a}-{regime}", window, metric) for a in laws}
        axes: tuple[Any, ...] = tuple(AXES) if isinstance(values_of[laws[0]][0], dict) else (None,)
        for axis in axes:
            lines = tuple(
                Line(NAMES[a], TRIAL_NAMES, [(v[axis] if axis else v) * scale for v in values])
                for a, values in values_of.items()
            )
            title = MEANING[regime] + (f", {AXES[axis]}" if axis else "")
            charts.append(bars(title, unit, lines))
    return tuple(charts)


def _trials(laws: tuple[str, ...], signal: _Signal, evidence: Evidence) -> tuple[Chart, ...]:
    """A row of panels a regime: both axes, and what lines that cover each other hide."""
    smooth, switching = ({NAMES[a]: f"{a}-{r}/trial-0" for a in laws} for r in REGIMES)
    return (
        *_both_axes(evidence, smooth, "smooth", signal, 1.0),
        _difference(evidence, smooth, "smooth", signal, 1.0),
        *_both_axes(evidence, switching, "switching", signal, 1.0),
        _close(evidence, switching, "switching", signal),
    )


def _matched(evidence: Evidence) -> tuple[Chart, ...]:
    charts = []
    for regime, meaning in (("s1", "smooth"), ("s7", "switching")):
        runs = [f"smc-{regime}/slope-{slope:g}" for slope in SLOPES[regime]]
        lines = [
            _frontier("SMC, slope λ", evidence, runs),
            _frontier("ASMC", evidence, [f"asmc-{regime}"]),
        ]
        point = matched(evidence, regime)
        note = f"SMC matches at λ = {point[0]:.0f} 1/s" if point else ""
        charts.append(
            Chart(
                title=meaning,
                x="mean following error in µm",
                y="energy in mWh",
                lines=tuple(lines),
                text=note,
            )
        )
    return tuple(charts)


def _frontier(label: str, evidence: Evidence, runs: list[str]) -> Line:
    errors = [np.mean(list(evidence[f"{r}/late"]["following_mean_um"].values())) for r in runs]
    return Line(label, errors, [evidence[f"{r}/whole"]["energy_J"] / 3.6 for r in runs])


def _table3(evidence: Evidence) -> tuple[Chart, ...]:
    cells = ("max_x", "max_y", "mean_x", "mean_y")

    def ours(run: str) -> list[float | None]:
        late = evidence[f"{run}/late"]
        return [
            late[f"following_{metric}_um"][axis] for metric, axis in (c.split("_") for c in cells)
        ]

    lines = (
        Line("SMC, published", cells, [TABLE3["smc"][c] for c in cells]),
        Line("SMC, here", cells, ours("smc-s1")),
        Line("ASMC, published", cells, [TABLE3["asmc"][c] for c in cells]),
        Line("ASMC, here", cells, ours("asmc-s1")),
        Line("K = 120, here", cells, ours("smc-k120-s1")),
    )
    return (bars("following error", "µm", lines, log_y=True),)


def _table5(evidence: Evidence) -> tuple[Chart, ...]:
    printed = Line(
        "published", ("SMC", "ASMC"), [TABLE5["energy_smc_mWh"], TABLE5["energy_asmc_mWh"]]
    )
    lines = [printed]
    for regime in REGIMES:
        drawn = [
            np.mean(over_trials(evidence, f"{name}-{regime}", "whole", "energy_J")) / 3.6
            for name in ("smc", "asmc")
        ]
        lines.append(Line(MEANING[regime], ("SMC", "ASMC"), drawn))
    return (bars("energy", "mWh", lines),)


BOTH, STAR = ("smc", "asmc"), ("smc-star", "asmc")


plots: tuple[ChartPlot | RunPlot, ...] = (
    paper.chart("figure01-step", _step),
    RunPlot(
        name="figure02-trifolium",
        text="Figure 2: the trajectory, with the error of ASMC",
        case=partial(build, law("asmc"), scene("s1"), TIMING),
        views=("contour", "error"),
    ),
    paper.chart("figure04-tracking", _figure4),
    paper.chart("figure05-gain", _figure5),
    paper.chart(
        "figure06-energy",
        partial(_bars, laws=BOTH, window="whole", metric="energy_J", unit="mWh", scale=1 / 3.6),
    ),
    paper.chart("figure07-tracking", partial(_trials, BOTH, ERROR)),
    paper.chart(
        "figure08-max",
        partial(_bars, laws=BOTH, window="late", metric="following_max_um", unit="µm"),
    ),
    paper.chart("figure09-command", partial(_trials, BOTH, COMMAND)),
    paper.chart(
        "figure10-variance",
        partial(_bars, laws=BOTH, window="late", metric="command_variance_V2", unit="V²"),
    ),
    paper.chart(
        "figure11-star-energy",
        partial(_bars, laws=STAR, window="whole", metric="energy_J", unit="mWh", scale=1 / 3.6),
    ),
    paper.chart("figure12-star-tracking", partial(_trials, ("smc", "smc-star", "asmc"), ERROR)),
    paper.chart("figure13-star-command", partial(_trials, STAR, COMMAND)),
    paper.chart("table3", _table3),
    paper.chart("table5-energy", _table5),
    paper.chart("matched-accuracy", _matched),
)
