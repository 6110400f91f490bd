"""All claims of a study judged on what its experiments give."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax

from jaxstage.studies.claim import Judgement, judge
from jaxstage.studies.evidence import Evidence
from jaxstage.studies.experiment import Experiment
from jaxstage.studies.packaged import packaged_toml
from jaxstage.studies.study import Study
from jaxstage.system.runtime import cpu_cores


class Comparison(NamedTuple):
    """What a study's experiments gave, and the verdicts."""

    study: Study
    evidence: Evidence
    claims: tuple[Judgement, ...]


def compare(study: Study, progress: Callable[[str], None] = lambda experiment: None) -> Comparison:
    """Run every experiment of a study, in double precision, and judge its claims.

    Single long runs keep one core busy: experiments run beside each other, one a core. progress:
    called with the text of each experiment before it runs.
    """

    def measured(experiment: Experiment) -> Evidence:
        with jax.enable_x64(True):  # a setting of the thread
            progress(experiment.text)
            return experiment.measure()

    evidence: dict[str, Any] = {}
    with ThreadPoolExecutor(cpu_cores()) as pool:
        for part in pool.map(measured, study.experiments):
            evidence |= part
    return Comparison(study, evidence, tuple(judge(claim, evidence) for claim in study.claims))


def stored_verdicts(study: Study) -> dict[str, str]:
    """Claim -> verdict as measured when the study was last changed; empty without claims."""
    return packaged_toml(study.name, "verdicts.toml") if study.claims else {}
