"""What `jaxstage compare fuzzy-cmac` draws beside the verdicts."""

from functools import partial

import numpy as np

from jaxstage.references.nurbs import points
from jaxstage.studies.case import Timing
from jaxstage.studies.evidence import Evidence
from jaxstage.studies.fuzzy_cmac.experiments import CREDITS, DRAWS, machines
from jaxstage.studies.fuzzy_cmac.loops import CONTOURS, build, law
from jaxstage.studies.fuzzy_cmac.table_claims import TABLE2
from jaxstage.studies.plots import Chart, ChartPlot, Line, RunPlot, bars, paper_plots

paper = paper_plots("fuzzy-cmac")

NAMES = tuple(CONTOURS)


def _lap(evidence: Evidence, name: str, metric: str) -> list[float | None]:
    return [evidence[f"{name}-{c}/second lap"][metric] for c in NAMES]


def _table2(evidence: Evidence) -> tuple[Chart, ...]:
    charts = []
    for metric, meaning in (("ate", "average tracking error"), ("tesd", "its deviation")):
        lines = [
            Line(f"{label}, {who}", NAMES, values)
            for key, label in (("cmac", "CMAC"), ("dfcmac", "DFCMAC"))
            for who, values in (
                ("published", [TABLE2[f"{metric}_{key}"][c] for c in NAMES]),
                ("here", _lap(evidence, key, f"{metric}_um")),
            )
        ]
        charts.append(bars(meaning, "µm", lines))
    return tuple(charts)


def _laws(evidence: Evidence) -> tuple[Chart, ...]:
    lines = tuple(
        Line(label, NAMES, [evidence[f"{name}-{c}"]["contour_rms_um"] for c in NAMES])
        for name, label in (
            ("sliding", "ideal sliding mode"),
            ("cmac", "CMAC"),
            ("dfcmac", "DFCMAC"),
            ("cascade", "industrial cascade"),
        )
    )
    return (
        bars("as published", "contour error RMS in µm", lines, log_y=True),
        Chart(
            title=f"{DRAWS} uncertain machines, circle",
            x="machines, best first",
            y="contour error RMS in µm",
            log_y=True,
            lines=tuple(
                Line(
                    label,
                    list(range(1, DRAWS + 1)),
                    sorted(
                        filter(None, (evidence[case]["contour_rms_um"] for case in machines(name)))
                    ),
                )
                for name, label in (
                    ("cmac", "CMAC"),
                    ("dfcmac", "DFCMAC"),
                    ("cascade", "industrial cascade"),
                )
            ),
        ),
    )


def _credits(evidence: Evidence) -> tuple[Chart, ...]:
    names = [*(f"CMAC, credit {credit:g}" for credit in CREDITS.values()), "DFCMAC"]
    keys = [*(f"cmac{suffix}" for suffix in CREDITS), "dfcmac"]
    lines = tuple(Line(c, names, [evidence[f"{key}-{c}"]["ate_um"] for key in keys]) for c in NAMES)
    return (bars("ATE of the second lap", "µm", lines),)


def _contours(evidence: Evidence) -> tuple[Chart, ...]:
    u = np.linspace(0.0, 1.0, 801)
    charts = []
    for name, curve in CONTOURS.items():
        shape = curve()
        path, polygon = points(shape, u) * 1e3, np.asarray(shape.control_points) * 1e3
        lines = (
            Line("control polygon", polygon[:, 0], polygon[:, 1]),
            Line("contour", path[:, 0], path[:, 1]),
        )
        charts.append(Chart(title=name, x="x in mm", y="y in mm", lines=lines, equal=True))
    return tuple(charts)


plots: tuple[ChartPlot | RunPlot, ...] = (
    paper.chart("figure06", _contours),
    paper.chart("table2", _table2),
    paper.chart("laws", _laws),
    paper.chart("credits", _credits),
    *(
        RunPlot(
            name=f"figure{number:02d}-{contour}",
            text=f"Figure {number}: {contour}, DFCMAC, first lap",
            case=partial(build, law("dfcmac"), contour, Timing(laps=1)),
            views=("axes", "contour", "weights"),
        )
        for number, contour in zip((7, 8, 9, 10), NAMES, strict=True)
    ),
)
