"""Model-reference and adaptive sliding-mode control of a two-inertia axis (Zhang et al. 2023)."""

from jaxstage.studies.mrac_asmc.claims import claims
from jaxstage.studies.mrac_asmc.experiments import experiments
from jaxstage.studies.mrac_asmc.loops import BOXES, SPREADS
from jaxstage.studies.mrac_asmc.loops import loops as every_loop
from jaxstage.studies.mrac_asmc.plots import plots
from jaxstage.studies.study import Study

study = Study(
    name="mrac-asmc",
    title="Model-reference and adaptive sliding-mode control of a two-inertia axis",
    source="Zhang et al., Sensors 2023, 23, 9755, doi:10.3390/s23249755",
    loops=every_loop,
    references=("to and fro", "step"),
    spreads=SPREADS,
    boxes=BOXES,
    experiments=experiments,
    claims=claims,
    plots=plots,
)
