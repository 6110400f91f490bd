"""Adaptive sliding-mode control of a lead-screw table (Msukwa and Uchiyama 2019)."""

from jaxstage.studies.adaptive_smc.claims import claims
from jaxstage.studies.adaptive_smc.experiments import experiments
from jaxstage.studies.adaptive_smc.loops import BOXES, SPREADS, loops
from jaxstage.studies.adaptive_smc.plots import plots
from jaxstage.studies.study import Study

study = Study(
    name="adaptive-smc",
    title="Adaptive sliding mode with a nonlinear surface, and its energy, on a lead-screw table",
    source="Msukwa and Uchiyama, IEEE Access 7 (2019), Design and Experimental Verification of "
    "Adaptive Sliding Mode Control for Precision Motion and Energy Saving in Feed Drive Systems",
    loops=loops,
    references=("trifolium",),
    spreads=SPREADS,
    boxes=BOXES,
    experiments=experiments,
    claims=claims,
    plots=plots,
)
