"""What `jaxstage compare mrac-asmc` draws beside the verdicts."""

from collections.abc import Callable
from functools import partial

import numpy as np

from jaxstage.studies.evidence import Evidence
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.mrac_asmc.experiments import GAINS, LAYERS, RUN_TIMES, STEP_GAINS
from jaxstage.studies.mrac_asmc.loops import TIMING, build, law, version
from jaxstage.studies.mrac_asmc.picking import PUBLISHED
from jaxstage.studies.mrac_asmc.traces import spectrum
from jaxstage.studies.plots import (
    Chart,
    ChartPlot,
    Line,
    RunPlot,
    bars,
    of_cases,
    over_time,
    paper_plots,
)

paper = paper_plots("mrac-asmc")

#: every so many ticks of a trace are drawn
THIN = 5
#: so many bins of a spectrum are drawn, 8 a Hz, and of so many beside each other the largest
TOP, JOINED = 2800, 8


def _line(evidence: Evidence, label: str, case: str, signal: str = "error_um") -> Line:
    trace = evidence[case].get("trace")
    if trace is None:
        return Line(f"{label}: lost", [], [])
    drawn = np.asarray(trace[signal])[::THIN]
    return Line(label, np.arange(len(drawn)) * THIN * TIMING.dt, drawn)


def _errors(number: int, title: str, *cases: tuple[str, str]) -> ChartPlot:
    """Following errors over time, for a figure of the paper."""

    def charts(evidence: Evidence) -> tuple[Chart, ...]:
        lines = tuple(_line(evidence, label, case) for label, case in cases)
        return (over_time("motor side", "error in µm", lines),)

    return ChartPlot(
        name=f"figure{number:02d}",
        title=f"Figure {number}: {title}",
        charts=charts,
        text="Following error of the motor; the reversals are at 2, 4, 6, ... s.",
    )


def _bipolar(evidence: Evidence) -> tuple[Chart, ...]:
    s = np.linspace(-1, 1, 401)
    lines = tuple(Line(f"a = {a:g}", s, np.tanh(a * s / 2)) for a in (5, 50, 1000))
    return (Chart(title="equation (11)", x="s in rad/s", y="phi", lines=lines),)


def _adapted(signal: str, unit: str, evidence: Evidence) -> tuple[Chart, ...]:
    lines = (_line(evidence, "first simulation", "sim1", signal),)
    return (over_time("fixed slope", unit, lines),)


def _steps(evidence: Evidence) -> tuple[Chart, ...]:
    lines = [_line(evidence, f"eps = {gain}", f"step{gain}") for gain in STEP_GAINS]
    close = [Line(line.label, line.x[-60:], line.y[-60:]) for line in lines]
    return (
        over_time("whole", "error in µm", lines),
        over_time("steady", "error in µm", close),
    )


def _run_times(evidence: Evidence) -> tuple[Chart, ...]:
    charts = []
    for time in (1.0, 2.0, 4.0, 8.0):
        suffix = f"/{time:g}s" if time in RUN_TIMES else ""
        lines = []
        for label, case in (("scenario R", "asmc-mrac-caps-r"), ("ideal", "asmc-mrac-caps")):
            line = _line(evidence, label, case + suffix)
            shown = np.asarray(line.x) < time
            lines.append(Line(label, np.asarray(line.x)[shown], np.asarray(line.y)[shown]))
        charts.append(over_time(f"{time:g} s", "error in µm", lines))
    return tuple(charts)


def _means(evidence: Evidence) -> tuple[Chart, ...]:
    names = ["1 s", "2 s", "4 s", "8 s"]
    suffixes = ["/1s", "/2s", "", "/8s"]
    lines = tuple(
        Line(label, names, [evidence[f"{case}{s}"]["mean_um"] for s in suffixes])
        for label, case in (("scenario R", "asmc-mrac-caps-r"), ("ideal", "asmc-mrac-caps"))
    )
    return (bars("second half of a period", "mean of |e| in µm", lines),)


def _spectra(*cases: tuple[str, str]) -> Callable[[Evidence], tuple[Chart, ...]]:
    def charts(evidence: Evidence) -> tuple[Chart, ...]:
        lines = []
        for label, case in cases:
            error = evidence[case]["trace"]["error_um"][round(values.SKIP / TIMING.dt) :]
            frequency, amplitude = spectrum(error)
            peaks = amplitude[1 : 1 + TOP // JOINED * JOINED].reshape(-1, JOINED).max(axis=1)
            lines.append(Line(label, frequency[1 + JOINED // 2 :: JOINED][: len(peaks)], peaks))
        return (
            Chart(
                title="t >= 4 s, Hann window, largest within 1 Hz",
                x="frequency in Hz",
                y="amplitude in µm",
                lines=tuple(lines),
                log_y=True,
            ),
        )

    return charts


def _table4(evidence: Evidence) -> tuple[Chart, ...]:
    names = ["SMC", "SMC+MRAC", "ASMC+MRAC, capped"]
    keys = ["smc1500-r", "smc500-mrac-r", "asmc-mrac-caps-r"]
    table = PUBLISHED["table4"]
    lines = [Line("published", names, [table[k] for k in ("smc", "smc_mrac", "asmc_mrac")])]
    for label, suffix in (("here, friction on the load", ""), ("on the motor", "-motor")):
        variances = [evidence[f"{key}{suffix}"]["variance_um2"] for key in keys]
        lines.append(Line(label, names, variances))
    return (bars("scenario R", "variance in µm²", lines),)


def _gains(evidence: Evidence) -> tuple[Chart, ...]:
    def over(metric: str, label: str) -> tuple[Line, ...]:
        row = [evidence[f"smc{gain}-r"][metric] for gain in GAINS]
        asmc = evidence["asmc-mrac-caps-r"][metric]
        level = Line("ASMC+MRAC, capped", list(GAINS), [asmc] * len(GAINS))
        return Line("SMC", list(GAINS), row), level

    return tuple(
        Chart(title=title, x="eps in rad/s²", y=unit, lines=over(metric, title), log_y=True)
        for title, metric, unit in (
            ("chattering", "chattering_um", "amplitude in µm"),
            ("variance", "variance_um2", "variance in µm²"),
            ("heat of the motor", "motor_loss_W", "loss in W"),
        )
    )


def _switches(evidence: Evidence) -> tuple[Chart, ...]:
    cases = {"sgn": "smc1500-r"}
    cases |= {f"implicit, {width}": f"smc1500-layer{width}-r" for width in LAYERS}
    cases |= {"sigmoid": "sigmoid-r", "ASMC+MRAC, capped": "asmc-mrac-caps-r"}
    return tuple(
        bars(
            title,
            unit,
            [of_cases(title, evidence, metric, cases)],
            log_y=True,
        )
        for title, metric, unit in (
            ("chattering of the error", "chattering_um", "amplitude in µm"),
            ("variance of the error", "variance_um2", "variance in µm²"),
            ("change of the command a period", "command_step_Nm", "mean in N m"),
        )
    )


def _limit(evidence: Evidence) -> tuple[Chart, ...]:
    lines = []
    cases = {
        "sigmoid, a = 50": "sigmoid-mrac",
        "sigmoid, a = 25": "sigmoid-mrac-soft",
        "implicit": "implicit-mrac",
    }
    for label, case in cases.items():
        command = evidence[case]["trace"]["command_Nm"][20_000:20_060]
        lines.append(Line(label, np.arange(len(command)) * TIMING.dt * 1e3, command))
    steps = [evidence[case]["command_step_Nm"] for case in cases.values()]
    return (
        Chart(title="60 periods", x="time in ms", y="command in N m", lines=tuple(lines)),
        bars(
            "change of the command a period",
            "mean in N m",
            (Line("command", list(cases), steps),),
            log_y=True,
        ),
    )


def _contours(evidence: Evidence) -> tuple[Chart, ...]:
    charts = []
    for title, case in (("PID", "xy-cascade"), ("ASMC+MRAC, capped", "xy-asmc-mrac-caps")):
        traces = evidence[case]["trace"]
        lines = [
            Line(side, np.arange(len(error)) * TIMING.dt, error) for side, error in traces.items()
        ]
        charts.append(over_time(title, "contour error in µm", lines))
    return tuple(charts)


plots: tuple[ChartPlot | RunPlot, ...] = (
    paper.chart("figure04", _bipolar),
    _errors(5, "first simulation", ("fixed slope", "sim1")),
    paper.chart("figure06", partial(_adapted, "gain", "eps in rad/s²")),
    paper.chart("figure07", partial(_adapted, "sharpness", "a")),
    _errors(8, "second simulation", ("adaptive slope", "sim2")),
    paper.chart("figure10", _steps),
    _errors(12, "SMC and PID", ("SMC", "smc1500-r"), ("PID", "cascade-r")),
    _errors(
        13,
        "three laws",
        ("SMC", "smc1500-r"),
        ("SMC+MRAC", "smc500-mrac-r"),
        ("ASMC+MRAC, capped", "asmc-mrac-caps-r"),
    ),
    paper.chart("figure14", _run_times),
    paper.chart("figure15", _means),
    _errors(
        16,
        "feed-forward of 2 um",
        ("PID", "cascade-r"),
        ("ASMC+MRAC, capped, 2 um ahead", "asmc-mrac-caps-ahead-r"),
        ("ASMC+MRAC, capped", "asmc-mrac-caps-r"),
    ),
    paper.chart(
        "figure17", _spectra(("PID", "cascade-r"), ("ASMC+MRAC, capped", "asmc-mrac-caps-r"))
    ),
    paper.chart(
        "figure18",
        _spectra(
            ("SMC", "smc1500-r"),
            ("ASMC+MRAC, capped", "asmc-mrac-caps-r"),
            ("fixed sigmoid", "sigmoid-r"),
        ),
    ),
    paper.chart("table4", _table4),
    paper.chart("gains", _gains),
    paper.chart("switches", _switches),
    paper.chart("limit", _limit),
    paper.chart("xy", _contours),
    RunPlot(
        name="asmc-mrac-caps-r",
        text="ASMC+MRAC, capped, scenario R: the tool lags the motor by the twist of the shaft",
        case=lambda: build(law("asmc-mrac-caps"), version("-r"), TIMING),
        views=("axes", "command", "surface"),
    ),
)
