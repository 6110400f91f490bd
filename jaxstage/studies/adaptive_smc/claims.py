"""The claims of the adaptive sliding-mode paper."""

from jaxstage.studies.adaptive_smc.experiment_claims import experiment, same_accuracy
from jaxstage.studies.adaptive_smc.law_claims import surface, switching, theory
from jaxstage.studies.adaptive_smc.simulation_claims import integral, machines, table3
from jaxstage.studies.claim import Claim

claims: tuple[Claim, ...] = (
    *table3(),
    *integral(),
    *surface(),
    *switching(),
    *experiment(),
    *same_accuracy(),
    *machines(),
    *theory(),
)
