"""How the claims of the MRAC / ASMC paper pick their figures, and what they rest on."""

import itertools
from collections.abc import Callable

import numpy as np

from jaxstage.studies.claim import Evidence, Picked
from jaxstage.studies.figures import ratio
from jaxstage.studies.mrac_asmc.experiments import STARTS
from jaxstage.studies.packaged import packaged_toml

PUBLISHED = packaged_toml("mrac-asmc", "published.toml")

#: a simulated figure agrees within this share, a chattering amplitude within twice that: runs that
#: switch are chaotic, and a start moved by 0.1 um moves it by up to 40 % (chosen)
LEVEL = 0.25
CHAOTIC = 0.5

LEAD = "rests on 1 rad per mm (chosen)"
SELECTED = (
    "scenario R (chosen): filter picked so that the variance of SMC is near the printed one, MRAC "
    "gains partly by their result in it"
)
#: what every claim on the capped law rests on
CAPS = (
    "c <= 300 and a <= 60 are caps (chosen), without which the law runs away on a quantised "
    "velocity"
)
CAPPED = f"{CAPS}; {SELECTED}"
OURS = "the paper's MRAC law is not printed; ours is another one"
ALONE = "follows from published values alone"
PRINTED_PAIR = "arithmetic of printed figures"


def mean_figure(evidence: Evidence, case: str, figure: str) -> float | None:
    """A figure of a case, the mean over its starts where it has several."""
    names = [case, *(f"{case}/start{number}" for number in range(1, len(STARTS)))]
    found = [evidence[name][figure] for name in names if name in evidence]
    return None if None in found else float(np.mean(found))


def of(case: str, figure: str) -> Picked:
    """A figure of a case."""
    return lambda evidence: mean_figure(evidence, case, figure)


def over(first: str, second: str, figure: str, other: str = "") -> Picked:
    """A figure of the first case over one of the second."""
    return lambda evidence: ratio(
        mean_figure(evidence, first, figure), mean_figure(evidence, second, other or figure)
    )


def saved(better: str, worse: str, figure: str) -> Picked:
    """1 - better / worse."""

    def share(evidence: Evidence) -> float | None:
        left = over(better, worse, figure)(evidence)
        return None if left is None else 1 - left

    return share


def growth(case: str, figure: str, since: str) -> Picked:
    """How much an adapted value changed from a moment to the end, over its value there."""

    def share(evidence: Evidence) -> float | None:
        found = ratio(evidence[case][f"{figure}_end"], evidence[case][f"{figure}_{since}"])
        return None if found is None else found - 1

    return share


def neighbours(cases: list[str], figure: str, pick: Callable[[list[float]], float]) -> Picked:
    """The smallest or largest ratio of a figure of neighbours in a row of cases."""

    def extreme(evidence: Evidence) -> float | None:
        found = [evidence[case][figure] for case in cases]
        if None in found:
            return None
        return pick([b / a for a, b in itertools.pairwise(found)])

    return extreme
