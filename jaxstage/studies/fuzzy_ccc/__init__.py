"""Adaptive fuzzy PID cross-coupled control of a three-axis stage (Science Progress 2021)."""

from jaxstage.studies.fuzzy_ccc.claims import claims
from jaxstage.studies.fuzzy_ccc.experiments import experiments
from jaxstage.studies.fuzzy_ccc.loops import BOXES, SPREADS, loops
from jaxstage.studies.fuzzy_ccc.plots import plots
from jaxstage.studies.study import Study

study = Study(
    name="fuzzy-ccc",
    title="Adaptive fuzzy PID cross-coupled control of a three-axis linear-motor stage",
    source="Science Progress 2021, doi:10.1177/00368504211011847",
    loops=loops,
    references=("helix",),
    spreads=SPREADS,
    boxes=BOXES,
    experiments=experiments,
    claims=claims,
    plots=plots,
)
