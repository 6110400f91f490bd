"""The claims of the fuzzy-CMAC paper: what each is judged by."""

import numpy as np

from jaxstage.controllers.parts.cmac import INTERVALS, association_matrix
from jaxstage.studies.claim import Claim, at_most
from jaxstage.studies.evidence import Pick, always, largest_of, of, over
from jaxstage.studies.fuzzy_cmac.experiments import machines
from jaxstage.studies.fuzzy_cmac.loops import CONTOURS, dfcmac_gains, plant
from jaxstage.studies.fuzzy_cmac.table_claims import PUBLISHED, cell, paper, table_claims


def _structure() -> list[Claim]:
    # the paper counts states and hypercubes from 1
    example = np.flatnonzero(association_matrix()[2 * INTERVALS + 2]) + 1
    eta = PUBLISHED["section33"]["switching_gain_cm_per_s2"] / 100
    unknown = float(np.max(np.asarray(plant().static) / np.asarray(plant().mass)))
    return [
        paper.claim("figure3-example", always(float(len({*example.tolist()} & {5, 14, 19, 28})))),
        paper.claim("table1-star", always(float(PUBLISHED["table1"]["star_weights"]))),
        paper.claim("equation28", always(unknown), bound=at_most(eta), published=eta),
        paper.unchecked("equation2"),
        paper.about(norm=_norm()).unchecked("section33-width"),
    ]


def _norm() -> float:
    gains = dfcmac_gains()
    spacing = float(np.asarray(gains.receptive.spacing)[0])
    width = float(np.asarray(gains.receptive.width)[0])
    offsets = spacing * np.array([-1.5, -0.5, 0.5, 1.5])
    return float(np.sum(np.exp(-2 * 2 * offsets**2 / width**2)))


def _settling(contour: str) -> Pick:
    """ATE of the second lap over the first."""
    return over(cell("dfcmac", "ate", contour), cell("dfcmac", "ate", contour, "first lap"))


def _contours() -> list[Claim]:
    settling = (
        (9, "heart", "position errors fall significantly during tracking"),
        (10, "star", "the error has decreased at steady state"),
    )
    return [
        *(
            paper.about(number=number, contour=c).claim(
                "figure{number}-path", cell("dfcmac", "contour_max", c)
            )
            for number, c in enumerate(CONTOURS, 7)
        ),
        *(
            paper.about(number=number, contour=c, words=words).claim(
                "figure{number}-settles", _settling(c)
            )
            for number, c, words in settling
        ),
        *(
            paper.about(number=number + 4, contour=c).unchecked("figure{number}")
            for number, c in enumerate(CONTOURS, 7)
        ),
    ]


def _worst_axis(case: str, metric: str) -> Pick:
    return largest_of([of(case, metric, axis) for axis in "xy"])


def _sliding() -> list[Claim]:
    before, after = "dfcmac-circle/third half", "dfcmac-circle/fourth half"
    fuzzy, relay, plain = (
        _worst_axis(f"{name}-circle", "chattering_A") for name in ("dfcmac", "sliding", "cmac")
    )
    return [
        paper.claim(
            "equation30",
            over(
                _worst_axis(after, "sliding_integral_m"),
                _worst_axis(before, "sliding_integral_m"),
            ),
        ),
        paper.claim("equation31", _settling("circle")),
        paper.claim(
            "equation16",
            lambda evidence: min(evidence[after]["reaching_share"].values(), default=None),
        ),
        paper.claim("chattering-sliding", over(fuzzy, relay)),
        paper.claim("chattering-cmac", over(fuzzy, plain)),
    ]


def _robustness() -> list[Claim]:
    nominal = of("dfcmac-circle", "ate_um")
    drawn = {
        (law, metric): [of(case, f"{metric}_um") for case in machines(law)]
        for law in ("dfcmac", "cmac", "cascade")
        for metric in ("ate", "contour_rms")
    }
    beside = [
        over(of(f"dfcmac-{c}", "contour_rms_um"), of(f"cascade-{c}", "contour_rms_um"))
        for c in CONTOURS
    ]
    return [
        paper.claim("robust-parameters", over(largest_of(drawn["dfcmac", "ate"]), nominal)),
        paper.claim("robust-load", over(of("dfcmac-circle/load", "ate_um"), nominal)),
        paper.claim("robust-coupling", over(of("dfcmac-circle/coupling", "ate_um"), nominal)),
        paper.claim(
            "robust-better",
            largest_of(list(map(over, drawn["dfcmac", "ate"], drawn["cmac", "ate"]))),
        ),
        paper.claim("better-than-cascade", largest_of(beside)),
        paper.claim(
            "better-than-cascade-uncertain",
            over(
                largest_of(drawn["dfcmac", "contour_rms"]),
                largest_of(drawn["cascade", "contour_rms"]),
            ),
        ),
    ]


claims: tuple[Claim, ...] = (
    *table_claims,
    *_structure(),
    *_contours(),
    *_sliding(),
    *_robustness(),
)
