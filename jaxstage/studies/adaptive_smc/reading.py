"""What the claims of the adaptive sliding-mode paper read out of the evidence.

Metrics are those of `experiments.evidence_of`: ``run/late`` from 1 s on, ``run/whole``.
"""

from statistics import mean
from typing import Any

from jaxstage.studies.adaptive_smc.experiments import MACHINES, over_trials
from jaxstage.studies.claim import paper_claims
from jaxstage.studies.evidence import Evidence, Pick, of
from jaxstage.studies.packaged import packaged_toml

PUBLISHED = packaged_toml("adaptive-smc", "published.toml")
TABLE3, TABLE4, TABLE5 = PUBLISHED["table3"], PUBLISHED["table4"], PUBLISHED["table5"]
TEXT = PUBLISHED["text"]
LAWS = {"smc": "SMC", "asmc": "ASMC"}
CELLS = {
    f"{metric}_{axis}": f"{words} error of axis {number}"
    for metric, words in (("max", "largest"), ("mean", "mean"))
    for number, axis in enumerate("xy", 1)
}
ERROR = "following_mean_um"

paper = paper_claims("adaptive-smc", machines=MACHINES)


def cell(run: str, which: str) -> Pick:
    """A cell of Tables 3 and 4 in um, e.g. ``max_x``, of a run."""
    metric, axis = which.split("_")
    return of(f"{run}/late", f"following_{metric}_um", axis)


def _added(metric: Any) -> float | None:
    values = list(metric.values()) if isinstance(metric, dict) else [metric]
    return None if None in values else sum(values)


def total(run: str, metric: str = ERROR, window: str = "late") -> Pick:
    """A metric of a run, added over the axes where it has them."""
    return lambda evidence: _added(evidence[f"{run}/{window}"][metric])


def trial_mean(name: str, metric: str = ERROR, window: str = "late") -> Pick:
    """Mean over the trials of a metric, added over the axes where it has them."""

    def pick(evidence: Evidence) -> float | None:
        every = [_added(value) for value in over_trials(evidence, name, window, metric)]
        known = [value for value in every if value is not None]
        return mean(known) if len(known) == len(every) else None

    return pick


def energy(run: str) -> Pick:
    """Energy in J of the whole run."""
    return of(f"{run}/whole", "energy_J")
