"""What the claims of the adaptive sliding-mode paper read out of the evidence.

Figures are those of `experiments.figures`: ``run/late`` from 1 s on, ``run/whole``.
"""

from statistics import mean
from typing import Any

from jaxstage.studies.adaptive_smc.experiments import over_trials
from jaxstage.studies.claim import Evidence
from jaxstage.studies.figures import ratio
from jaxstage.studies.packaged import packaged_toml

PUBLISHED = packaged_toml("adaptive-smc", "published.toml")
TABLE3, TABLE4, TABLE5 = PUBLISHED["table3"], PUBLISHED["table4"], PUBLISHED["table5"]
TEXT = PUBLISHED["text"]
LAWS = {"smc": "SMC", "asmc": "ASMC"}
CELLS = {
    "max_x": "largest error of axis 1", "max_y": "largest error of axis 2",
    "mean_x": "mean error of axis 1", "mean_y": "mean error of axis 2",
}  # fmt: skip

FITTED = "rests on the friction fitted to the SMC row of Table 3 (chosen)"
ARITHMETIC = "arithmetic of printed figures"
SMOOTH = "friction as fitted, q = 0.3 N as (12) has it (chosen reading): next to no switching"
SWITCHED = "switching of 0.01 m/s2, Coulomb friction, 20 % too light a model (chosen)"


def cell(evidence: Evidence, name: str, which: str) -> float | None:
    """A cell of Tables 3 and 4 in um, e.g. ``max_x``, of a run."""
    figure, axis = which.split("_")
    return evidence[f"{name}/late"][f"following_{figure}_um"][axis]


def _added(figure: Any) -> float | None:
    values = list(figure.values()) if isinstance(figure, dict) else [figure]
    return None if None in values else sum(values)


def total(evidence: Evidence, name: str, figure: str, window: str = "late") -> float | None:
    """A figure of a run, added over the axes where it has them."""
    return _added(evidence[f"{name}/{window}"][figure])


def trial_mean(evidence: Evidence, name: str, window: str, figure: str) -> float | None:
    """Mean over the trials of a figure, added over the axes where it has them."""
    found = over_trials(evidence, name, window, figure)
    whole = [v for v in map(_added, found) if v is not None]
    return mean(whole) if len(whole) == len(found) else None


def energy(evidence: Evidence, name: str) -> float | None:
    """Energy in J of the whole run."""
    return evidence[f"{name}/whole"]["energy_J"]


def rise(top: float | None, bottom: float | None) -> float | None:
    """Share added, top / bottom - 1."""
    share = ratio(top, bottom)
    return None if share is None else share - 1
