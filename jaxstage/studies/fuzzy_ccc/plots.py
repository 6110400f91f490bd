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

paper = paper_plots("fuzzy-ccc", mass_error=", ".join(map(str, MASS_ERROR)))

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
    signals, metrics = evidence[f"{case}/signals"], evidence[case]
    time, current = signals["time_s"], signals["command_A"]
    close = (time >= CLOSE[0]) & (time <= CLOSE[1])
    varied = metrics["command_variation_A_per_s"]
    parts = {": total variation {:.3g} A/s": slice(None), ", closer": close}
    return tuple(
        over_time(
            axis + what.format(varied[axis]),
            "current in A",
            (Line(axis, time[part], current[part, i]),),
        )
        for what, part in parts.items()
        for i, axis in enumerate(AXES)
    )


def _disturbance(evidence: Evidence) -> tuple[Chart, ...]:
    signals, mass = evidence[f"{OBSERVED}/signals"], np.asarray(values.plant().mass)
    time, true, estimate = signals["time_s"], signals["load_N"] / mass, signals["estimate_m_per_s2"]
    return tuple(
        over_time(
            axis,
            "acceleration in m/s2",
            (
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
        bars(
            "RMS following error",
            "µm",
            lines,
            text="PD with the same observer ties with sliding mode: the observer does the work",
            log_y=True,
        ),
    )


def _saving(row: dict[str, float]) -> float:
    return 100 * (1 - row["fuzzy"] / row["pid"])


def _savings(evidence: Evidence) -> tuple[Chart, ...]:
    fuzzy, pid = evidence["af-pid-ccc"], evidence["pid-ccc"]
    names, keys = ("MAX", "MEAN", "RMS"), ("max", "mean", "rms")
    ours = {
        "following error of y (Table 4)": [
            100 * (1 - fuzzy[f"following_{k}_um"]["y"] / pid[f"following_{k}_um"]["y"])
            for k in keys
        ],
        "contour error (Table 5)": [
            100 * (1 - fuzzy[f"contour_{k}_um"] / pid[f"contour_{k}_um"]) for k in keys
        ],
    }
    printed = (
        [_saving(TABLE4[f"y_{k}"]) for k in keys],
        [_saving(TABLE5[f"contour_{k}"]) for k in keys],
    )
    return tuple(
        bars(
            title,
            "saved by adaptive fuzzy coupling in %",
            [Line("published", names, published), Line("here", names, here)],
        )
        for (title, here), published in zip(ours.items(), printed, strict=True)
    )


def _rms(evidence: Evidence, cases: dict[str, str], label: str = "RMS") -> Line:
    return of_cases(label, evidence, "contour_rms_um", cases)


RATE_CASES = {f"× {factor:g}": f"af-pid-ccc/rates-{factor:g}" for factor in RATES}


def _causes(evidence: Evidence) -> tuple[Chart, ...]:
    cases = {
        "none": "none",
        "PID": "pid-ccc",
        "frozen": "fuzzy-frozen",
        "adaptive": "af-pid-ccc",
        **RATE_CASES,
        "mean": "pid-ccc/mean-gains",
    }
    text = (
        "frozen: rules that do not learn; ×: learning rates; mean: PID with constant gains at the "
        "mean of the adapted ones"
    )
    return (bars("contour error RMS", "µm", [_rms(evidence, cases)], text),)


def _variants(evidence: Evidence) -> tuple[Chart, ...]:
    laws = {"no coupling": "none", "PID": "pid-ccc", "adaptive fuzzy PID": "af-pid-ccc"}
    starts = [
        _rms(
            evidence,
            {"as it is": law, "wrong masses": f"{law}/mass", "from rest": f"{law}/rest"},
            label,
        )
        for label, law in laws.items()
    ]
    forms = {
        "none": "none",
        "no observer": "none/blind",
        "PID": "pid-ccc",
        "PID, scalar": "pid-ccc/scalar",
        "fuzzy": "af-pid-ccc",
        "fuzzy, scalar": "af-pid-ccc/scalar",
    }
    pid = {"as it is": "pid-ccc", "K_I = 0": "pid-ccc/no-integral"}
    pid |= {f"K_P = {gain:g}": f"pid-ccc/K_P-{gain:g}" for gain in PROPORTIONAL}
    fuzzy = {"as it is": "af-pid-ccc", "frozen": "fuzzy-frozen", "leak": "af-pid-ccc/leak"}
    blind = "no observer: no coupling either, and five times the switching gain"
    leak = f"leak: {LEAK:g} 1/s; ×: learning rates"
    return (
        bars("masses in the laws and start", "µm", starts),
        bars("observer and form of the contour error", "µm", [_rms(evidence, forms)], blind, True),
        bars("PID coupling", "µm", [_rms(evidence, pid)]),
        bars("adaptive fuzzy PID coupling", "µm", [_rms(evidence, fuzzy | RATE_CASES)], leak),
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
    paper.chart("figure03-membership", _memberships),
    paper.chart("table1-rules", _rules),
    paper.chart("figure05-control", partial(_control, BLIND)),
    paper.chart("figure06-control", partial(_control, OBSERVED)),
    paper.chart("figure06d-disturbance", _disturbance),
    paper.chart("figure07-laws", _errors),
    _run("07", "pd", "PD without observer", ("axes",)),
    _run("07", "none", "sliding mode with observer", ("axes",)),
    _run("08", "pid-ccc", "PID cross-coupling", ("axes", "error")),
    _run("08", "af-pid-ccc", "adaptive fuzzy PID cross-coupling", ("axes", "error", "schedule")),
    _run("08e", "pid-ccc", "PID cross-coupling", ("space",), LATER),
    _run("08e", "af-pid-ccc", "adaptive fuzzy PID cross-coupling", ("space",), LATER),
    paper.chart("tables", _savings),
    paper.chart("causes", _causes),
    paper.chart("variants", _variants),
)
