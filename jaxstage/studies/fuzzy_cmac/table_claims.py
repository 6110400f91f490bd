"""What Tables 2 and 3 of the fuzzy-CMAC paper claim, cell by cell and taken together."""

import math
from itertools import product
from statistics import mean

from jaxstage.studies.claim import Claim, at_least, paper_claims, printed
from jaxstage.studies.evidence import (
    Evidence,
    Pick,
    always,
    largest_of,
    of,
    over,
    saved,
)
from jaxstage.studies.fuzzy_cmac.experiments import DRAWS
from jaxstage.studies.fuzzy_cmac.loops import CONTOURS
from jaxstage.studies.packaged import packaged_toml

PUBLISHED = packaged_toml("fuzzy-cmac", "published.toml")
TABLE2, TABLE3 = PUBLISHED["table2"], PUBLISHED["table3"]
LAWS = {"cmac": "conventional CMAC", "dfcmac": "DFCMAC"}
METRICS = {"ate": "average tracking error", "tesd": "standard deviation of the tracking error"}

paper = paper_claims("fuzzy-cmac", draws=DRAWS)


def cell(law: str, metric: str, contour: str, lap: str = "second lap") -> Pick:
    """A metric of one law on one contour in one lap."""
    return of(f"{law}-{contour}/{lap}", f"{metric}_um")


def _mean(picks: list[Pick]) -> Pick:
    """The mean, None if one is missing."""

    def pick(evidence: Evidence) -> float | None:
        values = [one(evidence) for one in picks]
        return None if None in values else mean(values)  # type: ignore[type-var]

    return pick


def average(law: str, metric: str) -> Pick:
    """Mean of a metric of the second lap over the four contours."""
    return _mean([cell(law, metric, contour) for contour in CONTOURS])


def _usual(name: str) -> Pick:
    """Mean ATE over the four contours at the usual control period."""
    return _mean([of(f"{name}-{contour}", "ate_um") for contour in CONTOURS])


def _cells() -> list[tuple[dict[str, str], Pick]]:
    """The words and the simulated metric of every cell of a table, and of each row the average."""
    return [
        (
            {"metric": metric, "law": law, "column": column, "name": LAWS[law]}
            | {"meaning": METRICS[metric], "contour": contour},
            average(law, metric) if column == "average" else cell(law, metric, column),
        )
        for metric, law in product(METRICS, LAWS)
        for column, contour in (*((c, c) for c in CONTOURS), ("average", "all contours"))
    ]


def _table2() -> list[Claim]:
    credit = {"cmac": f"; {paper.terms['credit']}", "dfcmac": ""}
    return [
        paper.about(**words, reading=credit[words["law"]]).claim(
            "table2-{metric}-{law}-{column}", pick
        )
        for words, pick in _cells()
    ]


def _averages(number: int, step: float) -> list[Claim]:
    """The printed averages against the printed cells."""
    return [
        paper.about(
            number=number, metric=metric, law=law, name=name, capitals=metric.upper()
        ).claim(
            "table{number}-arithmetic-{metric}-{law}",
            always(mean(PUBLISHED[f"table{number}"][f"{metric}_{law}"][c] for c in CONTOURS)),
            bound=printed(step),
        )
        for metric in METRICS
        for law, name in LAWS.items()
    ]


def pattern(evidence: Evidence) -> float | None:
    """RMS log error of the 16 cells of Table 2 over that of one constant per column."""
    ours, null = [], []
    for metric, law in product(METRICS, LAWS):
        row = TABLE2[f"{metric}_{law}"]
        column = mean(row[contour] for contour in CONTOURS)
        for contour in CONTOURS:
            value = cell(law, metric, contour)(evidence)
            if value is None:
                return None
            ours.append(math.log(value / row[contour]) ** 2)
            null.append(math.log(column / row[contour]) ** 2)
    return math.sqrt(mean(ours) / mean(null))


def _comparison() -> list[Claim]:
    claims = []
    for metric in METRICS:
        told = paper.about(metric=metric, capitals=metric.upper())
        fuzzy, plain = TABLE2[f"{metric}_dfcmac"], TABLE2[f"{metric}_cmac"]
        ratios = [over(cell("dfcmac", metric, c), cell("cmac", metric, c)) for c in CONTOURS]
        claims += [
            told.claim(
                "table2-{metric}-better",
                largest_of(ratios),
                published=max(fuzzy[c] / plain[c] for c in CONTOURS),
            ),
            told.claim(
                "table2-{metric}-reduction",
                saved(average("dfcmac", metric), average("cmac", metric)),
                published=1 - fuzzy["average"] / plain["average"],
            ),
        ]
    half = 0.5 * (1 - TABLE2["ate_dfcmac"]["average"] / TABLE2["ate_cmac"]["average"])
    spread = mean(TABLE2[f"tesd_{w}"][c] / TABLE2[f"ate_{w}"][c] for w in LAWS for c in CONTOURS)
    return [
        *claims,
        paper.claim(
            "table2-spread",
            _mean([over(average(law, "tesd"), average(law, "ate")) for law in LAWS]),
            published=spread,
        ),
        paper.claim("table2-pattern", pattern),
        paper.claim(
            "fuzzy-cause", saved(_usual("dfcmac"), _usual("cmac-equal-rate")), bound=at_least(half)
        ),
        paper.claim("fuzzy-cause-full-credit", over(_usual("dfcmac"), _usual("cmac-full-credit"))),
    ]


def _table3() -> list[Claim]:
    cells = [
        paper.about(**words).unchecked("table3-{metric}-{law}-{column}")
        for words, _ in _cells()
        if words["column"] != "average"
    ]
    improvements = [
        paper.about(metric=metric, capitals=metric.upper()).claim(
            "table3-{metric}-improvement",
            always(1 - TABLE3[f"{metric}_dfcmac"]["average"] / TABLE3[f"{metric}_cmac"]["average"]),
        )
        for metric in METRICS
    ]
    return cells + improvements


table_claims: tuple[Claim, ...] = (
    *_table2(),
    *_averages(2, 0.01),
    *_comparison(),
    *_table3(),
    *_averages(3, 0.001),
)
