"""Claims on the experiment: Tables 4 and 5, Figures 6 to 13, and what the same accuracy costs."""

from statistics import mean

import numpy as np

from jaxstage.studies.adaptive_smc.experiments import SLOPES
from jaxstage.studies.adaptive_smc.reading import (
    CELLS,
    LAWS,
    TABLE4,
    TABLE5,
    TEXT,
    energy,
    paper,
    total,
    trial_mean,
)
from jaxstage.studies.claim import Claim
from jaxstage.studies.evidence import Evidence, Pick, added, always, over, saved


def experiment() -> list[Claim]:
    """Tables 4 and 5, their arithmetic, and the five trials."""
    return [
        *(
            paper.about(law=law, cell=cell, label=label, meaning=meaning).unchecked(
                "table4-{law}-{cell}"
            )
            for law, label in LAWS.items()
            for cell, meaning in CELLS.items()
        ),
        *(
            paper.about(law=law, axis=axis, label=label).unchecked("table5-variance-{law}-{axis}")
            for law, label in LAWS.items()
            for axis in "xy"
        ),
        *(
            paper.about(law=law, label=label).unchecked("table5-energy-{law}")
            for law, label in LAWS.items()
        ),
        *_printed_arithmetic(),
        *_trials(),
    ]


def _printed_arithmetic() -> list[Claim]:
    """The printed shares against the printed numbers."""
    smc, asmc = TABLE4["smc"], TABLE4["asmc"]
    peaks = always(mean(1 - asmc[c] / smc[c] for c in ("max_x", "max_y")))
    variances = [TABLE5["variance_smc"], TABLE5["variance_asmc"], TEXT["smc_variance"]]
    before, after, told = (sum(variance.values()) for variance in variances)
    drawn, saving = TABLE5["energy_smc_mWh"], TABLE5["energy_smc_mWh"] - TABLE5["energy_asmc_mWh"]
    star = sum(TEXT["smc_star_variance"].values()) - told
    return [
        paper.claim("table4-max-reduction", peaks),
        paper.claim("table4-max-reduction-introduction", peaks),
        *(
            paper.about(axis=axis).claim(
                "table4-mean-reduction-{axis}",
                always(1 - asmc[f"mean_{axis}"] / smc[f"mean_{axis}"]),
            )
            for axis in "xy"
        ),
        paper.claim("table5-energy-reduction", always(1 - TABLE5["energy_asmc_mWh"] / drawn)),
        paper.claim("table5-variance-reduction", always(1 - after / before)),
        paper.claim("text-variance-reduction", always(1 - after / told)),
        *(
            paper.about(axis=axis).claim(
                "table5-variance-text-{axis}", always(TEXT["smc_variance"][axis])
            )
            for axis in "xy"
        ),
        paper.claim(
            "table5-energy-from-variance",
            always(star * saving / (before - after)),
            published=TEXT["smc_star_energy_mWh"] - TEXT["smc_star_energy_from_mWh"],
        ),
    ]


def _trials() -> list[Claim]:
    claims = []
    for regime, short in (("s3", "smooth"), ("s7", "switching")):
        smc, asmc, star = (f"{law}-{regime}" for law in ("smc", "asmc", "smc-star"))
        told = paper.about(short=short, meaning=paper.terms[short])

        def saves(metric: str, window: str = "late", asmc: str = asmc, smc: str = smc) -> Pick:
            return saved(trial_mean(asmc, metric, window), trial_mean(smc, metric, window))

        claims += [
            told.claim("figure06-energy-{short}", saves("energy_J", "whole")),
            told.claim("figure08-max-{short}", saves("following_max_um")),
            told.claim("figure10-variance-{short}", saves("command_variance_V2")),
            told.claim("figure09-smoother-{short}", saves("command_high_variance_V2")),
            told.claim("figure12-star-accuracy-{short}", over(trial_mean(star), trial_mean(asmc))),
            told.claim(
                "figure11-star-energy-{short}",
                added(*(trial_mean(name, "energy_J", "whole") for name in (star, smc))),
                published=TEXT["smc_star_energy_mWh"] / TEXT["smc_star_energy_from_mWh"] - 1,
            ),
        ]
    return claims


# --- energy at matched accuracy --------------------------------------------------------------


def matched(evidence: Evidence, regime: str) -> tuple[float, float] | None:
    """Slope in 1/s and energy in J of the SMC with the mean error of ASMC; None without one."""
    target = total(f"asmc-{regime}")(evidence)
    runs = [f"smc-{regime}/slope-{slope:g}" for slope in SLOPES[regime]]
    errors = [total(run)(evidence) for run in runs]
    energies = [energy(run)(evidence) for run in runs]
    if target is None or None in errors or None in energies:
        return None
    falling = np.array(errors[::-1], float)
    if not falling[0] <= target <= falling[-1]:
        return None
    slope = float(np.interp(target, falling, SLOPES[regime][::-1]))
    return slope, float(np.interp(slope, SLOPES[regime], np.array(energies, float)))


def _energy_at_the_same_accuracy(regime: str) -> Pick:
    """Energy in J of the SMC with the mean error of ASMC."""

    def pick(evidence: Evidence) -> float | None:
        point = matched(evidence, regime)
        return None if point is None else point[1]

    return pick


def same_accuracy() -> list[Claim]:
    """The energy of SMC tuned to the accuracy of ASMC."""
    return [
        paper.about(short=short, meaning=paper.terms[short]).claim(
            "matched-energy-{short}",
            added(_energy_at_the_same_accuracy(regime), energy(f"asmc-{regime}")),
            published=TEXT["smc_star_energy_mWh"] / TABLE5["energy_asmc_mWh"] - 1,
        )
        for regime, short in (("s1", "smooth"), ("s7", "switching"))
    ]
