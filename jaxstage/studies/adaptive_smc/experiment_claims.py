"""Claims on the experiment: Tables 4 and 5, Figures 6 to 13, and what the same accuracy costs."""

from statistics import mean

import numpy as np

from jaxstage.studies.adaptive_smc.experiments import SLOPES
from jaxstage.studies.adaptive_smc.reading import (
    ARITHMETIC,
    CELLS,
    LAWS,
    SMOOTH,
    SWITCHED,
    TABLE4,
    TABLE5,
    TEXT,
    energy,
    rise,
    total,
    trial_mean,
)
from jaxstage.studies.claim import (
    Claim,
    Evidence,
    Picked,
    at_least,
    claim,
    printed,
    unchecked,
    within,
)
from jaxstage.studies.figures import ratio, saving

FIELD = "measured on the authors' machine, whose pitch, motor, path and friction are not printed"
NOISE = "encoder of 25 nm, differenced, noise of 25 nm (chosen)"


# --- the experiment: Tables 4 and 5 ----------------------------------------------------------


def experiment() -> list[Claim]:
    """Tables 4 and 5, their arithmetic, and the five trials."""
    claims = [
        unchecked(
            f"table4-{name}-{cell.replace('_', '-')}", "Table 4", f"{label}, measured: {meaning}",
            TABLE4[name][cell], "um", FIELD,
        )
        for name, label in LAWS.items()
        for cell, meaning in CELLS.items()
    ]  # fmt: skip
    claims += [
        unchecked(
            f"table5-variance-{name}-{axis}", "Table 5", f"{label}: input variance of {axis}",
            TABLE5[f"variance_{name}"][axis], "V2", f"{FIELD}; amplifier gain not printed",
        )
        for name, label in LAWS.items()
        for axis in ("x", "y")
    ]  # fmt: skip
    claims += [
        unchecked(
            f"table5-energy-{name}", "Table 5", f"{label}: energy",
            TABLE5[f"energy_{name}_mWh"], "mWh", f"{FIELD}; the resistance was chosen to match it",
        )
        for name, label in LAWS.items()
    ]  # fmt: skip
    return [*claims, *_printed_arithmetic(), *_trials()]


def _printed_arithmetic() -> list[Claim]:
    smc, asmc = TABLE4["smc"], TABLE4["asmc"]
    peaks = mean(1 - asmc[c] / smc[c] for c in ("max_x", "max_y"))
    before, after = TABLE5["variance_smc"], TABLE5["variance_asmc"]
    told = TEXT["smc_variance"]
    rise = sum(TEXT["smc_star_variance"].values()) - sum(told.values())
    claims = [
        (
            "table4-max-reduction", "Abstract, conclusions", "largest errors fall by this share",
            peaks, printed(0.01), TEXT["max_reduction"],
        ),
        (
            "table4-max-reduction-introduction", "Introduction", "errors fall by this share",
            peaks, printed(0.005), TEXT["max_reduction_introduction"],
        ),
        *(
            (
                f"table4-mean-reduction-{axis}", "Section IV.C", f"mean error of {axis} falls",
                1 - asmc[f"mean_{axis}"] / smc[f"mean_{axis}"], printed(0.001),
                TEXT["mean_reduction"][axis],
            )
            for axis in ("x", "y")
        ),
        (
            "table5-energy-reduction", "Abstract", "energy falls by this share",
            1 - TABLE5["energy_asmc_mWh"] / TABLE5["energy_smc_mWh"], printed(0.001),
            TEXT["energy_reduction"],
        ),
        (
            "table5-variance-reduction", "Abstract, conclusions", "the variances of Table 5 fall",
            1 - sum(after.values()) / sum(before.values()), printed(0.001),
            TEXT["variance_reduction"],
        ),
        (
            "text-variance-reduction", "Section IV.C", "the variances of the text fall",
            1 - sum(after.values()) / sum(told.values()), printed(0.001),
            TEXT["variance_reduction"],
        ),
        *(
            (
                f"table5-variance-text-{axis}", "Table 5, section IV.C",
                f"SMC variance of {axis}: table against text", told[axis], printed(0.01),
                before[axis],
            )
            for axis in ("x", "y")
        ),
        (
            "table5-energy-from-variance", "Section IV.C",
            "SMC* draws this much more in mWh: what its variances give at Table 5's J per V2",
            rise * (TABLE5["energy_smc_mWh"] - TABLE5["energy_asmc_mWh"])
            / (sum(before.values()) - sum(after.values())),
            within(0.25), TEXT["smc_star_energy_mWh"] - TEXT["smc_star_energy_from_mWh"],
        ),
    ]  # fmt: skip
    reasons = {
        "table5-energy-from-variance": "on one path dE = R (g_a)^2 T d(variance): the ratio is a "
        "property of the motor, and it cannot differ between two comparisons",
    }
    return [
        claim(
            id, where, text, lambda e, value=value: value, bound, reasons.get(id, ARITHMETIC),
            figure, "mWh" if id in reasons else "V2" if "-text-" in id else "",
        )
        for id, where, text, value, bound, figure in claims
    ]  # fmt: skip


def _trials() -> list[Claim]:
    claims = []
    for regime, meaning in (("s3", SMOOTH), ("s7", SWITCHED)):
        smc, asmc, star = (f"{name}-{regime}" for name in ("smc", "asmc", "smc-star"))
        reason = f"{meaning}; {NOISE}"
        short = "smooth" if regime == "s3" else "switching"

        def saved(window: str, figure: str, top: str = asmc, bottom: str = smc) -> Picked:
            return lambda e: saving(
                trial_mean(e, top, window, figure), trial_mean(e, bottom, window, figure)
            )

        claims += [
            claim(
                f"figure06-energy-{short}", "Figure 6, abstract",
                f"{short}: ASMC saves this share of the energy, mean of five trials",
                saved("whole", "energy_J"), at_least(TEXT["energy_reduction"] / 2),
                f"{reason}; holds if half the published share is saved", TEXT["energy_reduction"],
            ),
            claim(
                f"figure08-max-{short}", "Figure 8, abstract",
                f"{short}: ASMC lowers the largest error by this share, mean of five trials",
                saved("late", "following_max_um"), at_least(TEXT["max_reduction"] / 2), reason,
                TEXT["max_reduction"],
            ),
            claim(
                f"figure10-variance-{short}", "Figure 10, abstract",
                f"{short}: ASMC lowers the variance of the command by this share, mean of five "
                "trials",
                saved("late", "command_variance_V2"), at_least(TEXT["variance_reduction"] / 2),
                reason, TEXT["variance_reduction"],
            ),
            claim(
                f"figure09-smoother-{short}", "Figure 9",
                f"{short}: the command of ASMC chatters less: share of the variance above 20 Hz "
                "saved",
                saved("late", "command_high_variance_V2"), at_least(0.0), reason,
            ),
            claim(
                f"figure12-star-accuracy-{short}", "Figure 12",
                f"{short}: SMC* tracks as well as ASMC (ratio of mean errors)",
                lambda e, star=star, asmc=asmc: ratio(
                    trial_mean(e, star, "late", "following_mean_um"),
                    trial_mean(e, asmc, "late", "following_mean_um"),
                ),
                within(0.1), reason, 1.0,
            ),
            claim(
                f"figure11-star-energy-{short}", "Figure 11",
                f"{short}: SMC* draws this share more than SMC, mean of five trials",
                lambda e, star=star, smc=smc: rise(
                    trial_mean(e, star, "whole", "energy_J"),
                    trial_mean(e, smc, "whole", "energy_J"),
                ),
                within(0.25), reason,
                TEXT["smc_star_energy_mWh"] / TEXT["smc_star_energy_from_mWh"] - 1,
            ),
        ]  # fmt: skip
    return claims


# --- energy at matched accuracy --------------------------------------------------------------


def matched(evidence: Evidence, regime: str) -> tuple[float, float] | None:
    """Slope in 1/s and energy in J of the SMC with the mean error of ASMC; None without one."""
    wanted = total(evidence, f"asmc-{regime}", "following_mean_um")
    runs = [f"smc-{regime}/slope-{slope:g}" for slope in SLOPES[regime]]
    errors = [total(evidence, run, "following_mean_um") for run in runs]
    drawn = [energy(evidence, run) for run in runs]
    if wanted is None or None in errors or None in drawn:
        return None
    falling = np.array(errors[::-1], float)
    if not falling[0] <= wanted <= falling[-1]:
        return None
    slope = float(np.interp(wanted, falling, SLOPES[regime][::-1]))
    return slope, float(np.interp(slope, SLOPES[regime], np.array(drawn, float)))


def same_accuracy() -> list[Claim]:
    """The energy of SMC tuned to the accuracy of ASMC."""
    claims = []
    for regime, short, meaning in (("s1", "smooth", SMOOTH), ("s7", "switching", SWITCHED)):

        def cost(e: Evidence, regime: str = regime) -> float | None:
            found = matched(e, regime)
            return None if found is None else rise(found[1], energy(e, f"asmc-{regime}"))

        claims.append(
            claim(
                f"matched-energy-{short}", "Section IV.C",
                f"{short}: SMC tuned to the mean error of ASMC by its slope draws this share more",
                cost, within(0.25), f"{meaning}; slope found, not 80 1/s",
                TEXT["smc_star_energy_mWh"] / TABLE5["energy_asmc_mWh"] - 1,
            )
        )  # fmt: skip
    return claims
