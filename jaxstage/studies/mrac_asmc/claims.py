"""The claims of the MRAC / ASMC paper, each with the threshold that decides it."""

import math

import numpy as np

from jaxstage.studies.claim import (
    Claim,
    Evidence,
    at_least,
    at_most,
    claim,
    printed,
    unchecked,
    within,
)
from jaxstage.studies.figures import ratio
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.mrac_asmc.experiments import GAINS, RUN_TIMES, STEP_GAINS
from jaxstage.studies.mrac_asmc.picking import (
    ALONE,
    CAPPED,
    CAPS,
    CHAOTIC,
    LEAD,
    LEVEL,
    OURS,
    PRINTED_PAIR,
    PUBLISHED,
    SELECTED,
    neighbours,
    of,
    over,
    saved,
)
from jaxstage.studies.mrac_asmc.simulation_claims import simulation_claims


def _damping_ratio() -> float:
    """Of the free-free mode of Table 1."""
    plant = values.plant()
    names = ("motor_inertia", "load_inertia", "stiffness", "damping")
    motor, load, stiffness, damping = (float(np.asarray(getattr(plant, n))[0]) for n in names)
    return damping / 2 * math.sqrt((1 / motor + 1 / load) / stiffness)


def _share(evidence: Evidence) -> float | None:
    """What a fixed sigmoid saves of the chattering of SMC, over what ASMC+MRAC saves."""
    alone = saved("sigmoid-r", "smc1500-r", "chattering_um")(evidence)
    return ratio(alone, saved("asmc-mrac-caps-r", "smc1500-r", "chattering_um")(evidence))


def _steps() -> list[Claim]:
    found = [f"step{gain}" for gain in STEP_GAINS]
    times = PUBLISHED["figure10"]["peak_times_s"]
    return [
        *(
            unchecked(
                f"step-{number}", "Section 5.2, Figure 10", "time of a step of 0.5 mm", time, "s",
                f"eps is not printed; the reaching phase, 0.5 c/eps, gives {0.25e3 / time:.0f}",
            )
            for number, time in enumerate(times, 1)
        ),
        claim(
            "step-order", "Section 5.2, Figure 10",
            "a larger eps arrives sooner (largest ratio of neighbours)",
            neighbours(found, "arrived_s", max), at_most(1.0),
            f"eps = {', '.join(map(str, STEP_GAINS))} rad/s2 (chosen); {SELECTED}",
        ),
        claim(
            "step-chattering", "Section 5.2, Figure 11",
            "a larger eps chatters more in the end (least ratio of neighbours)",
            neighbours(found, "chattering_um", min), at_least(1.0),
            SELECTED,
        ),
        claim(
            "motor-energy", "Section 5.2, Figure 12",
            "chattering costs motor energy (least ratio of heat for neighbouring eps)",
            neighbours([f"smc{gain}-r" for gain in GAINS], "motor_loss_W", min),
            at_least(1.0), f"the ratio is free of the copper loss (chosen); {SELECTED}",
        ),
        claim(
            "smc-energy", "Section 5.2", "SMC heats the motor more than ASMC+MRAC (ratio)",
            over("smc1500-r", "asmc-mrac-caps-r", "motor_loss_W"), at_least(1.0), CAPPED,
        ),
    ]  # fmt: skip


def _variances() -> list[Claim]:
    table, where = PUBLISHED["table4"], "Table 4"
    laws = (
        ("smc", "smc1500-r", "SMC", SELECTED),
        ("smc_mrac", "smc500-mrac-r", "SMC+MRAC", SELECTED),
        ("asmc_mrac", "asmc-mrac-caps-r", "ASMC+MRAC", CAPPED),
    )
    claims = [
        claim(
            f"table4-{key.replace('_', '-')}", where, f"variance of the error, {text}",
            of(case, "variance_um2"), within(LEVEL), f"unit um2 chosen; {reason}", table[key],
            "um2",
        )
        for key, case, text, reason in laws
    ]  # fmt: skip
    for suffix, side in (("", "load"), ("-motor", "motor")):
        smc1500, smc500 = f"smc1500-r{suffix}", f"smc500-r{suffix}"
        smc500_mrac, asmc = f"smc500-mrac-r{suffix}", f"asmc-mrac-caps-r{suffix}"
        claims += [
            claim(
                f"order-mrac-{side}", where, f"SMC+MRAC below SMC, friction on the {side} (ratio)",
                over(smc500_mrac, smc1500, "variance_um2"), at_most(1.0), SELECTED,
                table["smc_mrac"] / table["smc"],
            ),
            claim(
                f"order-asmc-{side}", where,
                f"ASMC+MRAC below SMC+MRAC, friction on the {side} (ratio)",
                over(asmc, smc500_mrac, "variance_um2"), at_most(1.0), CAPPED,
                table["asmc_mrac"] / table["smc_mrac"],
            ),
            claim(
                f"cause-mrac-{side}", "Section 5.3",
                f"MRAC is the cause: SMC+MRAC over SMC, both eps = 500, friction on the {side}",
                over(smc500_mrac, smc500, "variance_um2"), at_most(1.0),
                f"Table 4 lowers eps together with adding MRAC; {OURS}",
            ),
        ]  # fmt: skip
    return claims


def _errors() -> list[Claim]:
    largest = PUBLISHED["figure13"]["largest_error_um"]
    times = ["", *(f"/{time:g}s" for time in RUN_TIMES)]

    def spread(evidence: Evidence) -> float | None:
        means = [evidence[f"asmc-mrac-caps-r{time}"]["mean_um"] for time in times]
        return None if None in means else max(means) / min(means)

    return [
        claim(
            "figure13", "Section 5.3, Figure 13", "ASMC+MRAC stays within 2 um",
            of("asmc-mrac-r", "max_um"), at_most(largest),
            f"no caps, as printed; {SELECTED}", largest, "um",
        ),
        claim(
            "figure13-caps", "Section 5.3, Figure 13", "the same with c <= 300 and a <= 60",
            of("asmc-mrac-caps-r", "max_um"), at_most(largest), CAPPED, largest, "um",
        ),
        claim(
            "run-time", "Section 5.3, Figure 15",
            "the mean error does not depend on the run time (largest over smallest, 1 to 8 s)",
            spread, at_most(1.5), f"viscous friction grows with the speed; {CAPPED}",
        ),
        claim(
            "fast-matching", "Section 5.3, Figure 14",
            "MRAC lets a smaller eps match the disturbance: error in 1 s over that without MRAC",
            over("asmc-mrac-caps/1s", "asmc-caps/1s", "mean_um"), at_most(0.1),
            f"friction alone then needs eps = 545, eps(0) is 230; ideal measurement; {CAPS}; "
            f"{OURS}",
        ),
        unchecked(
            "following-error", "Abstract", "following error reduced by this share",
            PUBLISHED["abstract"]["following_error_reduction"], "",
            "only in the abstract; no printed pair gives it: the variances of Table 4 fall by "
            "0.824 or 0.790, their roots by 0.581",
        ),
    ]  # fmt: skip


def _feedforward() -> list[Claim]:
    table, where = PUBLISHED["figure16"], "Section 5.3, Figure 16"
    pid, asmc, claims = "cascade-r", "asmc-mrac-caps-ahead-r", []
    tuned = "gains of the PID chosen: not printed"
    for part, text in (("start", "setting off"), ("reversals", "reversing")):
        key, figure = part.removesuffix("s"), f"{part}_peak_um"
        both = table[f"{key}_pid_um"], table[f"{key}_asmc_um"]
        claims += [
            claim(
                f"{key}-pid", where, f"peak error in {text}, PID with rate feed-forward",
                of(pid, figure), within(LEVEL), f"{tuned}; {SELECTED}", both[0], "um",
            ),
            claim(
                f"{key}-asmc", where, f"peak error in {text}, ASMC+MRAC ahead by 2 um",
                of(asmc, figure), within(LEVEL), CAPPED, both[1], "um",
            ),
            claim(
                f"{key}-reduction", where, f"peak error in {text} reduced by this share",
                saved(asmc, pid, figure), within(LEVEL), f"{tuned}; {CAPPED}",
                table[f"{key}_reduction"],
            ),
            claim(
                f"{key}-arithmetic", where, f"the share printed for {text} is that of its figures",
                lambda e, both=both: 1 - both[1] / both[0], printed(1e-3), PRINTED_PAIR,
                table[f"{key}_reduction"],
            ),
        ]  # fmt: skip
    return [
        *claims,
        claim(
            "ahead-asmc", where, "2 um ahead lowers the error of ASMC+MRAC (ratio of means)",
            over(asmc, "asmc-mrac-caps-r", "mean_um"), at_most(1.0),
            f"a shift can help an error of its own size alone; {CAPPED}",
        ),
        claim(
            "ahead-sim1", where, "2 um ahead lowers the error of the first simulation (ratio)",
            over("sim1-ahead", "sim1", "mean_um"), at_most(1.0),
            f"{LEAD}: its printed static difference is of that size",
        ),
    ]  # fmt: skip


def _spectra() -> list[Claim]:
    where, table = "Section 5.3, Figure 17", PUBLISHED["figure18"]
    asmc, pid, smc = "asmc-mrac-caps-r", "cascade-r", "smc1500-r"
    bands = (("1_50", at_most(1.0), "below"), ("50_150", at_most(1.0), "below"),
             ("150_340", at_least(1.0), "above"))  # fmt: skip
    pair = table["asmc_um"], table["smc_um"]
    mrac = f"{OURS}; {CAPPED}"
    return [
        *(
            claim(
                f"spectrum-{band.replace('_', '-')}", where,
                f"ASMC {side} PID from {band.replace('_', ' to ')} Hz (ratio of the levels)",
                over(asmc, pid, f"level_{band}_Hz_um"), bound, CAPPED,
            )
            for band, bound, side in bands
        ),
        claim(
            "chattering-smc", "Figure 18", "largest amplitude of chattering, SMC (from 50 Hz)",
            of(smc, "chattering_um"), within(CHAOTIC), SELECTED, pair[1], "um",
        ),
        claim(
            "chattering-asmc", "Figure 18", "largest amplitude of chattering, ASMC+MRAC",
            of(asmc, "chattering_um"), within(CHAOTIC), CAPPED, pair[0], "um",
        ),
        claim(
            "chattering-reduction", "Figure 18, abstract", "chattering reduced by this share",
            saved(asmc, smc, "chattering_um"), within(0.1), CAPPED, table["reduction"],
        ),
        claim(
            "chattering-arithmetic", "Figure 18", "the printed share is that of its figures",
            lambda e: 1 - pair[0] / pair[1], printed(1.5e-3),
            f"{PRINTED_PAIR}; the step is the rounding of both", table["reduction"],
        ),
        claim(
            "chattering-cause", "Section 5.3, conclusions",
            "adaptation and MRAC weaken the chattering (share of the reduction that a fixed "
            "sigmoid has alone)",
            _share, at_most(0.5),
            f"against the same sigmoid without adaptation and MRAC; {CAPPED}",
        ),
        claim(
            "resonance", "Table 1, section 2.1", "the drive resonates (damping ratio of its mode)",
            lambda e: _damping_ratio(), at_most(math.sqrt(0.5)),
            f"{ALONE}, C = 0.064 read in N m s/rad",
        ),
        claim(
            "mrac-resonance", "Section 3.1, from reference [28]",
            "MRAC suppresses the resonance at 103 Hz (level of 50 to 150 Hz over that without)",
            over(asmc, "asmc-caps-r", "level_50_150_Hz_um"), at_most(1.0), mrac,
        ),
        claim(
            "mrac-resonance-soft", "Section 3.1, from reference [28]",
            "the same with a hundredth of the printed damping, damping ratio 0.011",
            over("asmc-mrac-caps-soft-r", "asmc-caps-soft-r", "level_50_150_Hz_um"), at_most(1.0),
            f"C = 6.4e-4 chosen; {mrac}",
        ),
        claim(
            "mrac-noise", "Section 3.1, from reference [28]",
            "MRAC suppresses noise (level of 150 to 340 Hz over that without)",
            over(asmc, "asmc-caps-r", "level_150_340_Hz_um"), at_most(1.0), mrac,
        ),
    ]  # fmt: skip


claims: tuple[Claim, ...] = (
    *simulation_claims(), *_steps(), *_variances(), *_errors(), *_feedforward(), *_spectra(),
)  # fmt: skip
