"""Claims on the simulation of the paper: Table 3, Figures 4 and 5, and machines drawn at random."""

from collections.abc import Callable

from jaxstage.studies.adaptive_smc.experiments import MACHINES
from jaxstage.studies.adaptive_smc.reading import (
    CELLS,
    LAWS,
    TABLE3,
    cell,
    paper,
    total,
)
from jaxstage.studies.claim import Claim
from jaxstage.studies.evidence import Evidence, Pick, always, applied, of, over, saved


def table3() -> list[Claim]:
    """The cells of Table 3, and what is said about them."""
    claims = []
    for which, meaning in CELLS.items():
        told = paper.about(which=which, meaning=meaning)
        claims += [
            told.claim("table3-smc-{which}", cell("smc-s1", which)),
            told.claim("table3-asmc-{which}", cell("asmc-s1", which)),
            told.claim("table3-asmc-as-k120-{which}", cell("smc-k120-s1", which)),
        ]
    means = {law: TABLE3[law]["mean_x"] + TABLE3[law]["mean_y"] for law in LAWS}
    return [
        *claims,
        paper.claim("table3-mean-reduction-printed", always(1 - means["asmc"] / means["smc"])),
        paper.claim("table3-mean-reduction", saved(total("asmc-s1"), total("smc-s1"))),
        paper.claim(
            "table3-any-dead-zone", over(cell("asmc-s1-wide", "mean_y"), cell("smc-s1", "mean_y"))
        ),
        paper.claim(
            "table3-peaks",
            over(cell("smc-s1/coulomb", "max_x"), cell("smc-s1/coulomb", "mean_x")),
            published=TABLE3["smc"]["max_x"] / TABLE3["smc"]["mean_x"],
        ),
    ]


def integral() -> list[Claim]:
    """Figures 4 and 5: the laws in comparison, from the start on."""
    gain = of("smc-star-star-s1/literal/late", "reaching_gain_max_1_per_s", "x")
    return [
        paper.claim(
            "figure04-start",
            over(of("smc-s1/whole", "following_max_um", "y"), cell("smc-s1", "max_y")),
        ),
        paper.claim(
            "figure04-better-than-integral", over(total("asmc-s1"), total("smc-star-star-s1"))
        ),
        paper.claim(
            "figure05-integral-at-its-cap",
            of("smc-star-star-s1/late", "reaching_gain_mean_1_per_s", "x"),
        ),
        paper.claim("figure05-integral-in-si", applied(lambda value: value - 80.0, gain)),
    ]


#: whether a machine, by its name, agrees
Test = Callable[[Evidence, str], bool]


def _below(top: str, bottom: str, metric: str, limit: float) -> Test:
    """Whether a metric of one law on a machine is less than ``limit`` times that of another."""
    window = "whole" if metric == "energy_J" else "late"

    def test(evidence: Evidence, machine: str) -> bool:
        pick = over(*(total(f"{machine}/{law}", metric, window) for law in (top, bottom)))
        share = pick(evidence)
        return share is not None and share < limit

    return test


def _share(*tests: Test) -> Pick:
    """Share of the drawn machines on which all tests agree."""
    names = [f"machine-{number}" for number in range(MACHINES)]
    return lambda e: sum(all(test(e, name) for test in tests) for name in names) / MACHINES


def machines() -> list[Claim]:
    """The orderings of the experiment, on machines drawn at random."""
    accurate = _below("asmc", "smc", "following_mean_um", 1)
    saves = _below("asmc", "smc", "energy_J", 0.99)
    star_dear = _below("smc", "smc-star", "energy_J", 1 / 1.05)
    quiet = _below("asmc", "smc", "command_variance_V2", 1)
    return [
        paper.claim("machines-accurate", _share(accurate)),
        paper.claim("machines-saves", _share(saves, accurate)),
        paper.claim("machines-star-dear", _share(star_dear)),
        paper.claim("machines-all", _share(quiet, saves, accurate, star_dear)),
    ]
