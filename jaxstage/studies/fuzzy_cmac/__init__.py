"""Direct fuzzy CMAC sliding-mode tracking of a biaxial stage (Mao et al. 2021)."""

from jaxstage.studies.fuzzy_cmac.claims import claims
from jaxstage.studies.fuzzy_cmac.experiments import experiments
from jaxstage.studies.fuzzy_cmac.loops import BOXES, CONTOURS, SPREADS, loops
from jaxstage.studies.fuzzy_cmac.plots import plots
from jaxstage.studies.study import Study

study = Study(
    name="fuzzy-cmac",
    title="Direct fuzzy CMAC sliding-mode tracking of a biaxial stage",
    source="Mao et al., Energies 2021, 14, 7802, doi:10.3390/en14227802",
    loops=loops,
    references=tuple(CONTOURS),
    spreads=SPREADS,
    boxes=BOXES,
    experiments=experiments,
    claims=claims,
    plots=plots,
)
