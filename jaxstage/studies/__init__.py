"""The published systems: their loops, values and timing."""

from jaxstage.studies.case import Case as Case
from jaxstage.studies.case import NamedLoop as NamedLoop
from jaxstage.studies.case import Study as Study
from jaxstage.studies.case import Timing as Timing
from jaxstage.studies.case import with_metric as with_metric
from jaxstage.studies.fuzzy_cmac import study as fuzzy_cmac

#: All studies.
studies: tuple[Study, ...] = (fuzzy_cmac,)


def loop_names() -> tuple[str, ...]:
    """The names of all loops of all studies."""
    return tuple(entry.name for study in studies for entry in study.loops)


def build(name: str, timing: Timing | None = None) -> Case:
    """The loop called ``name``, e.g. ``dfcmac-circle``. Raises KeyError for an unknown name."""
    for study in studies:
        for entry in study.loops:
            if entry.name == name:
                return entry.build(timing or Timing())
    raise KeyError(name)
