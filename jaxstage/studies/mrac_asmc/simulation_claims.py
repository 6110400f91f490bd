"""What the MRAC / ASMC paper claims of its simulations (section 4) and of its equations."""

import numpy as np

from jaxstage.studies.claim import Bound, Claim, at_least, at_most, claim, within
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.mrac_asmc.picking import (
    ALONE,
    LEAD,
    LEVEL,
    OURS,
    PUBLISHED,
    growth,
    of,
    over,
)
from jaxstage.studies.mrac_asmc.traces import SETTLED


def simulation_claims() -> list[Claim]:
    """What the paper simulates, and what its equations promise."""
    section, once = PUBLISHED["section4"], "Section 4, Figure 5"
    slow = Bound(text="above 0 and at most 0.1", holds=lambda ours, _: 0 < ours <= 0.1)
    return [
        claim(
            "steady", once, f"steady after 1.7 s (|e| < {SETTLED:g} um for good)",
            of("sim1", "settled_s"), within(LEVEL), LEAD, section["steady_after_s"], "s",
        ),
        claim(
            "static-difference", once, "a static difference of 2 um is left (mean of |e|)",
            of("sim1", "mean_um"), within(LEVEL),
            f"{LEAD} and on the reading of the sign q (chosen)",
            section["static_difference_um"], "um",
        ),
        claim(
            "static-direction", once, "it points along the motion (share of |e|)",
            of("sim1", "along_motion"), at_least(0.9), LEAD,
        ),
        claim(
            "no-spike", once, "no spike at reversals (largest error there over the mean)",
            over("sim1", "sim1", "reversals_peak_um", "mean_um"), at_most(2.0),
            f"{LEAD}; eps starts at 10 as printed, and there is no MRAC in this simulation",
        ),
        claim(
            "gain-grows", "Section 4, Figure 6",
            "the switching gain keeps growing slowly (share from 1.7 s to the end)",
            growth("sim1", "gain", "1.7_s"), slow, "e s > 0 on average: (16) has no equilibrium",
        ),
        claim(
            "sharpness", "Section 4, Figure 7", "a settles at 50", of("sim1", "sharpness_end"),
            within(0.1), LEAD, section["sharpness_end"],
        ),
        claim(
            "sharpness-settles", "Section 4, Figure 7", "a settles (change from 8 s to the end)",
            growth("sim1", "sharpness", "8_s"), at_most(0.01), LEAD,
        ),
        claim(
            "adaptive-slope", "Section 4, Figure 8", "with adaptive c the error falls to 0.3 um",
            of("sim2", "late_um"), within(LEVEL), f"{LEAD}; read at 11.9 s",
            section["adaptive_slope_error_um"], "um",
        ),
        claim(
            "adaptive-slope-better", "Section 4", "adapting c lowers the error (ratio of means)",
            over("sim2", "sim1", "mean_um"), at_most(1.0), LEAD,
        ),
        claim(
            "slope-settles", "Equations (22)-(25)",
            "c reaches the steady value that its proof assumes (growth from 8 s to the end)",
            growth("sim2", "slope", "8_s"), at_most(0.01),
            "int s e' dt = c e^2/2 + int e'^2 dt never stops rising",
        ),
        claim(
            "printed-sign", "Equations (16)-(18)",
            "with q = sgn(theta_1 u) V' <= 0, so the axis follows (largest error)",
            of("sim1-printed", "max_um"), at_most(SETTLED),
            "theta_1 >= 0 makes it sgn u: the gains shrink for e < 0, and the axis sticks",
            None, "um",
        ),
        claim(
            "sampled-limit", "Table 3, equation (12)",
            "the published gains suit the published control period (eps a T/2 + c T; limit 2 J1/J)",
            lambda e: _sampled(), at_most(_limit()), f"{ALONE}, angles in rad",
        ),
        claim(
            "smooth-command", "Section 3.3",
            "the sigmoid makes the command smooth (change a period with a = 50 over a = 25)",
            over("sigmoid-mrac", "sigmoid-mrac-soft", "command_step_Nm"), at_most(10.0),
            f"a = 25 chosen, below the limit of the sampled loop that a = 50 passes; {OURS}",
        ),
    ]  # fmt: skip


def _sampled() -> float:
    """eps a T/2 + c T of Table 3."""
    law = values.asmc()
    gains = (law.slope, law.switching_gain, law.sharpness)
    slope, gain, sharpness = (float(np.asarray(g)[0]) for g in gains)
    return gain * sharpness * values.DT / 2 + slope * values.DT


def _limit() -> float:
    plant = values.plant()
    motor, load = (float(np.asarray(j)[0]) for j in (plant.motor_inertia, plant.load_inertia))
    return 2 * motor / (motor + load)
