"""All claims of a study judged on what its experiments give."""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxstage.studies.claim import Evidence, Judgement, judge
from jaxstage.studies.packaged import packaged_toml
from jaxstage.studies.study import Study


class Comparison(NamedTuple):
    """What a study's experiments gave, and the verdicts."""

    study: Study
    evidence: Evidence
    claims: tuple[Judgement, ...]


def compare(study: Study, progress: Callable[[str], None] = lambda experiment: None) -> Comparison:
    """Run every experiment of a study and judge its claims. Needs double precision.

    progress: called with the text of each experiment before it runs.
    """
    evidence: dict[str, Any] = {}
    for experiment in study.experiments:
        progress(experiment.text)
        evidence |= experiment.measure()
    return Comparison(study, evidence, tuple(judge(claim, evidence) for claim in study.claims))


def stored_verdicts(study: Study) -> dict[str, str]:
    """Claim -> verdict as measured when the study was last changed; empty without claims."""
    return packaged_toml(study.name, "verdicts.toml") if study.claims else {}
