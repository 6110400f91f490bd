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
from jaxstage.studies.plots import Chart, ChartPlot, Line, RunPlot

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
        return (Chart(title="motor side", x="time in s", y="error in µm", lines=lines),)

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
    return (Chart(title="fixed slope", x="time in s", y=unit, lines=lines),)


def _steps(evidence: Evidence) -> tuple[Chart, ...]:
    lines = [_line(evidence, f"eps = {gain}", f"step{gain}") for gain in STEP_GAINS]
    close = [Line(line.label, line.x[-60:], line.y[-60:]) for line in lines]
    return (
        Chart(title="whole", x="time in s", y="error in µm", lines=tuple(lines)),
        Chart(title="steady", x="time in s", y="error in µm", lines=tuple(close)),
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
        charts.append(
            Chart(title=f"{time:g} s", x="time in s", y="error in µm", lines=tuple(lines))
        )
    return tuple(charts)


def _means(evidence: Evidence) -> tuple[Chart, ...]:
    names = ["1 s", "2 s", "4 s", "8 s"]
    suffixes = ["/1s", "/2s", "", "/8s"]
    lines = tuple(
        Line(label, names, [evidence[f"{case}{s}"]["mean_um"] for s in suffixes])
        for label, case in (("scenario R", "asmc-mrac-caps-r"), ("ideal", "asmc-mrac-caps"))
    )
    return (
        Chart(title="second half of a period", x="", y="mean of |e| in µm", lines=lines, bars=True),
    )


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
        found = [evidence[f"{key}{suffix}"]["variance_um2"] for key in keys]
        lines.append(Line(label, names, found))
    return (Chart(title="scenario R", x="", y="variance in µm²", lines=tuple(lines), bars=True),)


def _gains(evidence: Evidence) -> tuple[Chart, ...]:
    def over(figure: str, label: str) -> tuple[Line, ...]:
        found = [evidence[f"smc{gain}-r"][figure] for gain in GAINS]
        asmc = evidence["asmc-mrac-caps-r"][figure]
        level = Line("ASMC+MRAC, capped", list(GAINS), [asmc] * len(GAINS))
        return Line("SMC", list(GAINS), found), level

    return tuple(
        Chart(title=title, x="eps in rad/s²", y=unit, lines=over(figure, title), log_y=True)
        for title, figure, unit in (
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
        Chart(
            title=title,
            x="",
            y=unit,
            bars=True,
            log_y=True,
            lines=(Line(title, list(cases), [evidence[c][figure] for c in cases.values()]),),
        )
        for title, figure, unit in (
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
        Chart(
            title="change of the command a period",
            x="",
            y="mean in N m",
            bars=True,
            log_y=True,
            lines=(Line("command", list(cases), steps),),
        ),
    )


def _contours(evidence: Evidence) -> tuple[Chart, ...]:
    charts = []
    for title, case in (("PID", "xy-cascade"), ("ASMC+MRAC, capped", "xy-asmc-mrac-caps")):
        traces = evidence[case]["trace"]
        lines = [
            Line(side, np.arange(len(error)) * TIMING.dt, error) for side, error in traces.items()
        ]
        charts.append(
            Chart(title=title, x="time in s", y="contour error in µm", lines=tuple(lines))
        )
    return tuple(charts)


plots: tuple[ChartPlot | RunPlot, ...] = (
    ChartPlot(
        name="figure04",
        title="Figure 4: the bipolar function",
        charts=_bipolar,
        text="It approaches the sign as a grows.",
    ),
    _errors(5, "first simulation", ("fixed slope", "sim1")),
    ChartPlot(
        name="figure06",
        title="Figure 6: switching gain",
        charts=partial(_adapted, "gain", "eps in rad/s²"),
        text="Read how fast it rises at first, and whether it comes to rest.",
    ),
    ChartPlot(
        name="figure07",
        title="Figure 7: sharpness",
        charts=partial(_adapted, "sharpness", "a"),
        text="Read where it settles; printed is 50.",
    ),
    _errors(8, "second simulation", ("adaptive slope", "sim2")),
    ChartPlot(
        name="figure10",
        title="Figures 10 and 11: steps of 0.5 mm",
        charts=_steps,
        text="The reaching phase should take 0.5 c/eps. Compare arrival and steady chattering.",
    ),
    _errors(12, "SMC and PID", ("SMC", "smc1500-r"), ("PID", "cascade-r")),
    _errors(
        13,
        "three laws",
        ("SMC", "smc1500-r"),
        ("SMC+MRAC", "smc500-mrac-r"),
        ("ASMC+MRAC, capped", "asmc-mrac-caps-r"),
    ),
    ChartPlot(
        name="figure14",
        title="Figure 14: run times",
        charts=_run_times,
        text="ASMC+MRAC, capped, over one period each: compare the errors, each on its own scale.",
    ),
    ChartPlot(
        name="figure15",
        title="Figure 15: mean error and run time",
        charts=_means,
        text="ASMC+MRAC, capped. Bars of one height: the mean error is free of the run time.",
    ),
    _errors(
        16,
        "feed-forward of 2 um",
        ("PID", "cascade-r"),
        ("ASMC+MRAC, capped, 2 um ahead", "asmc-mrac-caps-ahead-r"),
        ("ASMC+MRAC, capped", "asmc-mrac-caps-r"),
    ),
    ChartPlot(
        name="figure17",
        title="Figure 17: spectra of PID and ASMC",
        charts=_spectra(("PID", "cascade-r"), ("ASMC+MRAC, capped", "asmc-mrac-caps-r")),
        text="The paper compares the levels of 1 to 50, 50 to 150 and 150 to 340 Hz.",
    ),
    ChartPlot(
        name="figure18",
        title="Figure 18: spectra of SMC and ASMC",
        charts=_spectra(
            ("SMC", "smc1500-r"),
            ("ASMC+MRAC, capped", "asmc-mrac-caps-r"),
            ("fixed sigmoid", "sigmoid-r"),
        ),
        text="Chattering counts from 50 Hz. The fixed sigmoid has neither adaptation nor MRAC.",
    ),
    ChartPlot(
        name="table4",
        title="Table 4: variance of the following error",
        charts=_table4,
        text="The filter of scenario R was picked for the first printed level; compare the order.",
    ),
    ChartPlot(
        name="gains",
        title="Chattering, variance and heat over the switching gain",
        charts=_gains,
        text="Scenario R. The level line is ASMC+MRAC, capped, whose switching gain adapts.",
    ),
    ChartPlot(
        name="switches",
        title="Ways to switch",
        charts=_switches,
        text="Scenario R. Implicit switching with eps = 1500 and layers of 1, 4 and 8 times the "
        "change of s in a period, beside sgn and a sigmoid with eps = 230.",
    ),
    ChartPlot(
        name="limit",
        title="Published sharpness and control period",
        charts=_limit,
        text="Ideal measurement, eps = 230 and MRAC for all three. A zigzag is an oscillation at "
        "half the sampling rate. The implicit switch has one layer, the change of s in a period.",
    ),
    ChartPlot(
        name="xy",
        title="Circle of two axes: load and motor",
        charts=_contours,
        text="The encoders sit on the motors. The load adds the twist of the shafts, which no law "
        "here sees.",
    ),
    RunPlot(
        name="asmc-mrac-caps-r",
        text="ASMC+MRAC, capped, scenario R: the tool lags the motor by the twist of the shaft",
        case=lambda: build(law("asmc-mrac-caps"), version("-r"), TIMING),
        views=("axes", "command", "surface"),
    ),
)
