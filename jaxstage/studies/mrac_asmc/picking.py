"""How the claims of the MRAC / ASMC paper pick their metrics out of the evidence."""

import itertools
from collections.abc import Callable

import numpy as np

from jaxstage.studies import evidence
from jaxstage.studies.claim import paper_claims
from jaxstage.studies.evidence import Evidence, Pick
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.mrac_asmc.experiments import STARTS, STEP_GAINS
from jaxstage.studies.mrac_asmc.traces import SETTLED
from jaxstage.studies.packaged import packaged_toml

PUBLISHED = packaged_toml("mrac-asmc", "published.toml")


def _sampled_limit() -> float:
    """2 J1 / J, what eps a T/2 + c T may reach."""
    plant = values.plant()
    motor, load = (float(np.asarray(j)[0]) for j in (plant.motor_inertia, plant.load_inertia))
    return 2 * motor / (motor + load)


paper = paper_claims(
    "mrac-asmc",
    settled=SETTLED,
    sampled_limit=_sampled_limit(),
    step_gains=", ".join(map(str, STEP_GAINS)),
)


def of(case: str, metric: str) -> Pick:
    """A metric of a case, the mean over its starts where it has several."""
    names = [case, *(f"{case}/start{number}" for number in range(1, len(STARTS)))]

    def pick(evidence: Evidence) -> float | None:
        known = [evidence[name][metric] for name in names if name in evidence]
        return None if None in known else float(np.mean(known))

    return pick


def over(first: str, second: str, metric: str, other: str = "") -> Pick:
    """A metric of the first case over one of the second."""
    return evidence.over(of(first, metric), of(second, other or metric))


def saved(better: str, worse: str, metric: str) -> Pick:
    """1 - better / worse."""
    return evidence.saved(of(better, metric), of(worse, metric))


def growth(case: str, metric: str, since: str) -> Pick:
    """How much an adapted value changed from a moment to the end, over its value there."""
    return evidence.added(
        evidence.of(case, f"{metric}_end"), evidence.of(case, f"{metric}_{since}")
    )


def neighbours(cases: list[str], metric: str, pick: Callable[[list[float]], float]) -> Pick:
    """The smallest or largest ratio of a metric of neighbours in a row of cases."""

    def extreme(evidence: Evidence) -> float | None:
        row = [evidence[case][metric] for case in cases]
        if None in row:
            return None
        return pick([b / a for a, b in itertools.pairwise(row)])

    return extreme
