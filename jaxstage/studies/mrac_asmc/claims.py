"""The claims of the MRAC / ASMC paper: what each is judged by."""

import math

import numpy as np

from jaxstage.studies import evidence
from jaxstage.studies.claim import Claim, at_least, at_most
from jaxstage.studies.evidence import Evidence, always
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.mrac_asmc.experiments import GAINS, RUN_TIMES, STEP_GAINS
from jaxstage.studies.mrac_asmc.picking import PUBLISHED, neighbours, of, over, paper, saved
from jaxstage.studies.mrac_asmc.simulation_claims import simulation_claims


def _damping_ratio() -> float:
    """Of the free-free mode of Table 1."""
    plant = values.plant()
    names = ("motor_inertia", "load_inertia", "stiffness", "damping")
    motor, load, stiffness, damping = (float(np.asarray(getattr(plant, n))[0]) for n in names)
    return damping / 2 * math.sqrt((1 / motor + 1 / load) / stiffness)


def _steps() -> list[Claim]:
    steps = [f"step{gain}" for gain in STEP_GAINS]
    times = PUBLISHED["figure10"]["peak_times_s"]
    return [
        *(
            paper.about(number=number, eps=0.25e3 / time).unchecked("step-{number}", published=time)
            for number, time in enumerate(times, 1)
        ),
        paper.claim("step-order", neighbours(steps, "arrived_s", max)),
        paper.claim("step-chattering", neighbours(steps, "chattering_um", min)),
        paper.claim(
            "motor-energy", neighbours([f"smc{gain}-r" for gain in GAINS], "motor_loss_W", min)
        ),
        paper.claim("smc-energy", over("smc1500-r", "asmc-mrac-caps-r", "motor_loss_W")),
    ]


def _variances() -> list[Claim]:
    table, variance = PUBLISHED["table4"], "variance_um2"
    claims = [
        paper.claim("table4-smc", of("smc1500-r", variance)),
        paper.claim("table4-smc-mrac", of("smc500-mrac-r", variance)),
        paper.claim("table4-asmc-mrac", of("asmc-mrac-caps-r", variance)),
    ]
    for suffix, side in (("", "load"), ("-motor", "motor")):
        smc500_mrac, asmc = f"smc500-mrac-r{suffix}", f"asmc-mrac-caps-r{suffix}"
        told = paper.about(side=side)
        claims += [
            told.claim(
                "order-mrac-{side}",
                over(smc500_mrac, f"smc1500-r{suffix}", variance),
                published=table["smc_mrac"] / table["smc"],
            ),
            told.claim(
                "order-asmc-{side}",
                over(asmc, smc500_mrac, variance),
                published=table["asmc_mrac"] / table["smc_mrac"],
            ),
            told.claim("cause-mrac-{side}", over(smc500_mrac, f"smc500-r{suffix}", variance)),
        ]
    return claims


def _errors() -> list[Claim]:
    times = ["", *(f"/{time:g}s" for time in RUN_TIMES)]

    def spread(evidence: Evidence) -> float | None:
        means = [evidence[f"asmc-mrac-caps-r{time}"]["mean_um"] for time in times]
        return None if None in means else max(means) / min(means)

    return [
        paper.claim("figure13", of("asmc-mrac-r", "max_um")),
        paper.claim("figure13-caps", of("asmc-mrac-caps-r", "max_um")),
        paper.claim("run-time", spread),
        paper.claim("fast-matching", over("asmc-mrac-caps/1s", "asmc-caps/1s", "mean_um")),
        paper.unchecked("following-error"),
    ]


def _feedforward() -> list[Claim]:
    table, pid, asmc = PUBLISHED["figure16"], "cascade-r", "asmc-mrac-caps-ahead-r"
    claims = []
    for part, text in (("start", "setting off"), ("reversals", "reversing")):
        key, metric = part.removesuffix("s"), f"{part}_peak_um"
        told = paper.about(key=key, text=text)
        printed = always(1 - table[f"{key}_asmc_um"] / table[f"{key}_pid_um"])
        claims += [
            told.claim("{key}-pid", of(pid, metric)),
            told.claim("{key}-asmc", of(asmc, metric)),
            told.claim("{key}-reduction", saved(asmc, pid, metric)),
            told.claim("{key}-arithmetic", printed),
        ]
    return [
        *claims,
        paper.claim("ahead-asmc", over(asmc, "asmc-mrac-caps-r", "mean_um")),
        paper.claim("ahead-sim1", over("sim1-ahead", "sim1", "mean_um")),
    ]


def _spectra() -> list[Claim]:
    table = PUBLISHED["figure18"]
    asmc, pid, smc = "asmc-mrac-caps-r", "cascade-r", "smc1500-r"
    soft = "asmc-mrac-caps-soft-r", "asmc-caps-soft-r"
    bands = (("1_50", "below"), ("50_150", "below"), ("150_340", "above"))
    sides = {"below": at_most(1.0), "above": at_least(1.0)}
    chattering = "chattering_um"
    return [
        *(
            paper.about(band=band, side=side, words=band.replace("_", " to ")).claim(
                "spectrum-{band}", over(asmc, pid, f"level_{band}_Hz_um"), bound=sides[side]
            )
            for band, side in bands
        ),
        paper.claim("chattering-smc", of(smc, chattering)),
        paper.claim("chattering-asmc", of(asmc, chattering)),
        paper.claim("chattering-reduction", saved(asmc, smc, chattering)),
        paper.claim("chattering-arithmetic", always(1 - table["asmc_um"] / table["smc_um"])),
        paper.claim(
            "chattering-cause",
            evidence.over(saved("sigmoid-r", smc, chattering), saved(asmc, smc, chattering)),
        ),
        paper.claim("resonance", always(_damping_ratio())),
        paper.claim("mrac-resonance", over(asmc, "asmc-caps-r", "level_50_150_Hz_um")),
        paper.claim("mrac-resonance-soft", over(*soft, "level_50_150_Hz_um")),
        paper.claim("mrac-noise", over(asmc, "asmc-caps-r", "level_150_340_Hz_um")),
    ]


claims: tuple[Claim, ...] = (
    *simulation_claims(),
    *_steps(),
    *_variances(),
    *_errors(),
    *_feedforward(),
    *_spectra(),
)
