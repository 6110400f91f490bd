"""What `jaxstage compare fuzzy-ccc` draws beside the verdicts."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.controllers.parts.fuzzy import (
    REACH,
    FuzzySets,
    infer,
    membership,
    set_names,
    strengths,
)
from jaxstage.model.fields import replace
from jaxstage.studies.case import Timing
from jaxstage.studies.evidence import Evidence
from jaxstage.studies.fuzzy_ccc import values
from jaxstage.studies.fuzzy_ccc.claims import BLIND, OBSERVED, TABLE4, TABLE5
from jaxstage.studies.fuzzy_ccc.loops import TIMING, build, law
from jaxstage.studies.fuzzy_ccc.variants import LEAK, MASS_ERROR, PROPORTIONAL, RATES
from jaxstage.studies.plots import Chart, ChartPlot, Line, RunPlot

AXES = ("x", "y", "z")


def _sets() -> dict[str, FuzzySets]:
    """The sets of both inputs, from the gains of the adaptive loop."""
    extra = build(law("af-pid-ccc"), "af-pid-ccc", TIMING).gains.extra
    return {"X1, contour error": extra.error_sets, "X2, its rate": extra.rate_sets}


def _memberships(evidence: Evidence) -> tuple[Chart, ...]:
    x = np.linspace(-REACH, REACH, 601)
    charts = []
    for name, sets in _sets().items():
        degrees = np.asarray(jax.vmap(partial(membership, sets))(jnp.asarray(x))).T
        lines = tuple(
            Line(label, x, y) for label, y in zip(set_names(len(degrees)), degrees, strict=True)
        )
        charts.append(Chart(title=name, x="normalised input", y="membership", lines=lines))
    return tuple(charts)


RULES = {"proportional": "K_P in 1/s2", "integral": "K_I in 1/s3", "derivative": "K_D in 1/s"}


def _rules(evidence: Evidence) -> tuple[Chart, ...]:
    """What the rules infer at the centre of each row that a magnitude E >= 0 meets."""
    first, second = _sets().values()
    x = jnp.linspace(-REACH, REACH, 241)
    met = [k for k, centre in enumerate(np.asarray(first.centres)) if centre <= 0]
    labels = set_names(len(first.centres))

    def inferred(consequents: jax.Array, row: int) -> jax.Array:
        return jax.vmap(
            lambda rate: infer(consequents, strengths(first, second, first.centres[row], rate))
        )(x)

    return tuple(
        Chart(
            title=f"{name} {when} learning",
            x="X2, normalised rate",
            y=name,
            lines=tuple(
                Line(f"X1 = {labels[row]}", np.asarray(x), np.asarray(inferred(table, row)))
                for row in met
            ),
        )
        for when, rules in evidence["af-pid-ccc/rules"].items()
        for field, name in RULES.items()
        for table in [jnp.asarray(getattr(rules, field))]
    )


#: a look at single switchings, in s
CLOSE = (5.0, 5.05)
#: how much larger the error of the estimate is drawn
TIMES = 20


def _control(case: str, evidence: Evidence) -> tuple[Chart, ...]:
    signals, figures = evidence[f"{case}/signals"], evidence[case]
    time, current = signals["time_s"], signals["command_A"]
    close = (time >= CLOSE[0]) & (time <= CLOSE[1])
    varied = figures["command_variation_A_per_s"]
    parts = {": total variation {:.3g} A/s": slice(None), ", closer": close}
    return tuple(
        Chart(
            title=axis + what.format(varied[axis]),
            x="time in s",
            y="current in A",
            lines=(Line(axis, time[part], current[part, i]),),
        )
        for what, part in parts.items()
        for i, axis in enumerate(AXES)
    )


def _disturbance(evidence: Evidence) -> tuple[Chart, ...]:
    signals, mass = evidence[f"{OBSERVED}/signals"], np.asarray(values.plant().mass)
    time, true, estimate = signals["time_s"], signals["load_N"] / mass, signals["estimate_m_per_s2"]
    return tuple(
        Chart(
            title=axis,
            x="time in s",
            y="acceleration in m/s2",
            lines=(
                Line("disturbance", time, true[:, i]),
                Line("its estimate", time, estimate[:, i]),
                Line(f"their difference × {TIMES}", time, TIMES * (true - estimate)[:, i]),
            ),
        )
        for i, axis in enumerate(AXES)
    )


def _errors(evidence: Evidence) -> tuple[Chart, ...]:
    laws = {
        "PD": "pd",
        "PD with observer": "pd-observed",
        "sliding mode with observer": "none",
    }
    lines = tuple(
        Line(label, AXES, [evidence[name]["following_rms_um"][a] for a in AXES])
        for label, name in laws.items()
    )
    return (
        Chart(
            title="RMS following error",
            x="",
            y="µm",
            lines=lines,
            bars=True,
            log_y=True,
            text="PD with the same observer ties with sliding mode: the observer does the work",
        ),
    )


def _saving(row: dict[str, float]) -> float:
    return 100 * (1 - row["fuzzy"] / row["pid"])


def _savings(evidence: Evidence) -> tuple[Chart, ...]:
    fuzzy, pid = evidence["af-pid-ccc"], evidence["pid-ccc"]
    names = ("MAX", "MEAN", "RMS")
    keys = ("max", "mean", "rms")
    printed = {
        "following error of y (Table 4)": [_saving(TABLE4[f"y_{k}"]) for k in keys],
        "contour error (Table 5)": [_saving(TABLE5[f"contour_{k}"]) for k in keys],
    }
    ours = {
        "following error of y (Table 4)": [
            100 * (1 - fuzzy[f"following_{k}_um"]["y"] / pid[f"following_{k}_um"]["y"])
            for k in keys
        ],
        "contour error (Table 5)": [
            100 * (1 - fuzzy[f"contour_{k}_um"] / pid[f"contour_{k}_um"]) for k in keys
        ],
    }
    return tuple(
        Chart(
            title=title,
            x="",
            y="saved by adaptive fuzzy coupling in %",
            bars=True,
            lines=(Line("published", names, printed[title]), Line("here", names, ours[title])),
        )
        for title in printed
    )


def _causes(evidence: Evidence) -> tuple[Chart, ...]:
    cases = {
        "none": "none",
        "PID": "pid-ccc",
        "frozen": "fuzzy-frozen",
        "adaptive": "af-pid-ccc",
        **{f"× {factor:g}": f"af-pid-ccc/rates-{factor:g}" for factor in RATES},
        "mean": "pid-ccc/mean-gains",
    }
    rms = [evidence[name]["contour_rms_um"] for name in cases.values()]
    return (
        Chart(
            title="contour error RMS",
            x="",
            y="µm",
            bars=True,
            lines=(Line("RMS", tuple(cases), rms),),
            text="frozen: rules that do not learn; ×: learning rates; mean: PID with "
            "constant gains at the mean of the adapted ones",
        ),
    )


def _variants(evidence: Evidence) -> tuple[Chart, ...]:
    def bars(
        title: str, *lines: tuple[str, dict[str, str]], text: str = "", log: bool = False
    ) -> Chart:
        drawn = tuple(
            Line(label, tuple(cases), [evidence[case]["contour_rms_um"] for case in cases.values()])
            for label, cases in lines
        )
        return Chart(title=title, x="", y="µm", bars=True, log_y=log, lines=drawn, text=text)

    def starts(name: str) -> dict[str, str]:
        return {"as it is": name, "wrong masses": f"{name}/mass", "from rest": f"{name}/rest"}

    return (
        bars(
            "masses in the laws and start",
            ("no coupling", starts("none")),
            ("PID", starts("pid-ccc")),
            ("adaptive fuzzy PID", starts("af-pid-ccc")),
        ),
        bars(
            "observer and form of the contour error",
            (
                "RMS",
                {
                    "none": "none",
                    "no observer": "none/blind",
                    "PID": "pid-ccc",
                    "PID, scalar": "pid-ccc/scalar",
                    "fuzzy": "af-pid-ccc",
                    "fuzzy, scalar": "af-pid-ccc/scalar",
                },
            ),
            text="no observer: no coupling either, and five times the switching gain",
            log=True,
        ),
        bars(
            "PID coupling",
            (
                "RMS",
                {
                    "as it is": "pid-ccc",
                    "K_I = 0": "pid-ccc/no-integral",
                    **{f"K_P = {gain:g}": f"pid-ccc/K_P-{gain:g}" for gain in PROPORTIONAL},
                },
            ),
        ),
        bars(
            "adaptive fuzzy PID coupling",
            (
                "RMS",
                {
                    "as it is": "af-pid-ccc",
                    "frozen": "fuzzy-frozen",
                    "leak": "af-pid-ccc/leak",
                    **{f"× {factor:g}": f"af-pid-ccc/rates-{factor:g}" for factor in RATES},
                },
            ),
            text=f"leak: {LEAK:g} 1/s; ×: learning rates",
        ),
    )


#: without the start, whose error would hide all others
LATER = replace(TIMING, skip=1.0)


def _run(
    figure: str, name: str, label: str, views: tuple[str, ...], timing: Timing = TIMING
) -> RunPlot:
    return RunPlot(
        name=f"figure{figure}-{name}",
        text=f"Figure {figure.lstrip('0')}: {label}",
        case=partial(build, law(name), name, timing),
        views=views,
    )


plots: tuple[ChartPlot | RunPlot, ...] = (
    ChartPlot(
        name="figure03-membership",
        title="Figure 3: membership functions",
        charts=_memberships,
        text="Seven Gaussian sets whose neighbours cross at one half; number and shape are chosen.",
    ),
    ChartPlot(
        name="table1-rules",
        title="Table 1: the rules before and after learning",
        charts=_rules,
        text="Contour gain over the rate, one line for each row of the table at its centre: "
        "X1 = 3 tanh(-E / eps_sc) with E >= 0, so only the rows NB to ZO are met. The published "
        "rules are lost; the classical ones stand in.",
    ),
    ChartPlot(
        name="figure05-control",
        title="Figure 5: control without observer",
        charts=partial(_control, BLIND),
        text="Switching by the sign with a large gain.",
    ),
    ChartPlot(
        name="figure06-control",
        title="Figure 6: control with observer",
        charts=partial(_control, OBSERVED),
        text="Switching by the sign with a tenth of the gain: what the observer allows.",
    ),
    ChartPlot(
        name="figure06d-disturbance",
        title="Figure 6d: disturbance and estimate",
        charts=_disturbance,
        text="With the small switching gain.",
    ),
    ChartPlot(
        name="figure07-laws",
        title="Figure 7: PD and sliding mode",
        charts=_errors,
        text="The PD law has the poles of the sliding mode's boundary layer.",
    ),
    _run("07", "pd", "PD without observer", ("axes",)),
    _run("07", "none", "sliding mode with observer", ("axes",)),
    _run("08", "pid-ccc", "PID cross-coupling", ("axes", "error")),
    _run("08", "af-pid-ccc", "adaptive fuzzy PID cross-coupling", ("axes", "error", "schedule")),
    _run("08e", "pid-ccc", "PID cross-coupling", ("space",), LATER),
    _run("08e", "af-pid-ccc", "adaptive fuzzy PID cross-coupling", ("space",), LATER),
    ChartPlot(
        name="tables",
        title="Tables 4 and 5: what adaptive fuzzy coupling saves",
        charts=_savings,
        text="Shares only: the printed errors have no unit and their machine is not known.",
    ),
    ChartPlot(
        name="causes",
        title="What the improvement rests on",
        charts=_causes,
        text="Faster learning raises the gains and lowers the error; constant gains of the same "
        "level do as well.",
    ),
    ChartPlot(
        name="variants",
        title="Contour error RMS with other numbers",
        charts=_variants,
        text=f"Wrong masses: assumed {', '.join(map(str, MASS_ERROR))} times the true ones; from "
        "rest: on the path.",
    ),
)
