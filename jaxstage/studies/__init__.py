"""The published systems and the user's own: their loops, values and timing."""

import warnings

import jax.numpy as jnp

from jaxstage.model.settings import nearest_name
from jaxstage.studies import adaptive_smc as adaptive_smc
from jaxstage.studies import fuzzy_ccc as fuzzy_ccc
from jaxstage.studies import fuzzy_cmac as fuzzy_cmac
from jaxstage.studies import mrac_asmc as mrac_asmc
from jaxstage.studies.case import Case as Case
from jaxstage.studies.case import Timing as Timing
from jaxstage.studies.case import with_metric as with_metric
from jaxstage.studies.case import with_scored_metric as with_scored_metric
from jaxstage.studies.claim import judge as judge
from jaxstage.studies.comparison import Comparison as Comparison
from jaxstage.studies.comparison import compare as compare
from jaxstage.studies.comparison import stored_verdicts as stored_verdicts
from jaxstage.studies.own import own_files, own_studies
from jaxstage.studies.precision import LARGEST, stored_precision, worst
from jaxstage.studies.study import Box as Box
from jaxstage.studies.study import NamedLoop as NamedLoop
from jaxstage.studies.study import Spread as Spread
from jaxstage.studies.study import Study as Study

#: The published studies.
all_studies: tuple[Study, ...] = (
    fuzzy_cmac.study,
    adaptive_smc.study,
    fuzzy_ccc.study,
    mrac_asmc.study,
)


def known_studies() -> tuple[Study, ...]:
    """The published studies and the user's own, see `own`.

    Raises ValueError for a file that cannot be used, and for a name that two of them give.
    """
    studies = (*all_studies, *own_studies())
    loops = [entry.name for study in studies for entry in study.loops]
    names = [study.name for study in studies]
    for kind, twice in (
        ("two loops are", {name for name in loops if loops.count(name) > 1}),
        ("two studies are", {name for name in names if names.count(name) > 1}),
        ("a study and a loop are both", {*names} & {*loops}),
    ):
        if twice:
            raise ValueError(f"{kind} called {', '.join(sorted(twice))}{_places(studies, twice)}")
    return studies


def _places(studies: tuple[Study, ...], names: set[str]) -> str:
    """The user's own files that give one of the names."""
    files = [
        str(file)
        for file, study in zip(own_files(), studies[len(all_studies) :], strict=False)
        if {study.name, *(entry.name for entry in study.loops)} & names
    ]
    return f" ({', '.join(dict.fromkeys(files))})" if files else ""


def loop_names() -> tuple[str, ...]:
    """The names of all loops of all studies."""
    return tuple(entry.name for study in known_studies() for entry in study.loops)


def find(name: str) -> NamedLoop:
    """The loop called ``name``. Raises ValueError with the nearest known name."""
    entries = {entry.name: entry for study in known_studies() for entry in study.loops}
    if name not in entries:
        study = next((study for study in known_studies() if study.name == name), None)
        if study is not None:
            first = ", ".join(entry.name for entry in study.loops[:3])
            raise ValueError(f"'{name}' is a study: name one of its loops, e.g. {first}")
        hint = nearest_name(name, entries)
        raise ValueError(f"unknown loop '{name}'{hint} (`jaxstage list` shows all)")
    return entries[name]


def build(name: str, timing: Timing | None = None) -> Case:
    """The loop called ``name``, e.g. ``dfcmac-circle``.

    timing: that of the published loop if left out. Warns where single precision, JAX's default,
    moves the metrics of this loop by over 1 %. Raises ValueError for an unknown name and for
    impossible timing.
    """
    entry = find(name)
    if jnp.zeros(()).dtype == jnp.float32:
        for study in all_studies:
            metric, difference = worst(stored_precision(study.name).get(name, {"": 0.0}))
            if difference > LARGEST:
                warnings.warn(
                    f"single precision moves {metric} of {name} by {difference:.1%} at its own "
                    "timing: "
                    'call configure(precision="double") first',
                    stacklevel=2,
                )
    return entry.build(timing or entry.timing)
