"""What the MRAC / ASMC paper claims of its simulations (section 4) and of its equations."""

import numpy as np

from jaxstage.studies.claim import Bound, Claim
from jaxstage.studies.evidence import always
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.mrac_asmc.picking import growth, of, over, paper


def simulation_claims() -> list[Claim]:
    """What the paper simulates, and what its equations promise."""
    slow = Bound(text="above 0 and at most 0.1", holds=lambda ours, _: 0 < ours <= 0.1)
    return [
        paper.claim("steady", of("sim1", "settled_s")),
        paper.claim("static-difference", of("sim1", "mean_um")),
        paper.claim("static-direction", of("sim1", "along_motion")),
        paper.claim("no-spike", over("sim1", "sim1", "reversals_peak_um", "mean_um")),
        paper.claim("gain-grows", growth("sim1", "gain", "1.7_s"), bound=slow),
        paper.claim("sharpness", of("sim1", "sharpness_end")),
        paper.claim("sharpness-settles", growth("sim1", "sharpness", "8_s")),
        paper.claim("adaptive-slope", of("sim2", "late_um")),
        paper.claim("adaptive-slope-better", over("sim2", "sim1", "mean_um")),
        paper.claim("slope-settles", growth("sim2", "slope", "8_s")),
        paper.claim("printed-sign", of("sim1-printed", "max_um")),
        paper.claim("sampled-limit", always(_sampled())),
        paper.claim("smooth-command", over("sigmoid-mrac", "sigmoid-mrac-soft", "command_step_Nm")),
    ]


def _sampled() -> float:
    """eps a T/2 + c T of Table 3."""
    law = values.asmc()
    gains = (law.slope, law.switching_gain, law.sharpness)
    slope, gain, sharpness = (float(np.asarray(g)[0]) for g in gains)
    return gain * sharpness * values.DT / 2 + slope * values.DT
