"""How far single precision is from double, per loop: measured, kept, and acted upon."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxstage.metrics import columns
from jaxstage.simulate.rollout import simulate
from jaxstage.studies.case import Case
from jaxstage.studies.packaged import packaged_studies, packaged_toml
from jaxstage.studies.study import NamedLoop

#: the metrics that are compared
HEADLINE = ("ate_um", "tesd_um", "contour_rms_um", "contour_max_um", "energy_J")
#: a loop with a larger relative difference is refused in single precision, unless forced
LARGEST = 0.01


def compare_precision(case: Case) -> dict[str, float]:
    """|f32 - f64| / |f64| of each headline metric. Needs double precision to be switched on."""
    if jnp.zeros(()).dtype != jnp.float64:
        raise ValueError("comparing precisions needs precision = double")
    single = jax.tree.map(
        lambda x: x.astype(jnp.float32) if x.dtype == jnp.float64 else x, case.path
    )
    tables = []
    for path in (case.path, single):
        run = simulate(case.loop, case.gains, case.scenario, path, case.window.ticks)
        tables.append(columns(run.report, case.loop.plant))
    double, rough = tables
    return {
        key: abs(rough[key] - double[key]) / abs(double[key])
        if rough[key] is not None and double[key]
        else float("inf")
        for key in HEADLINE
        if key in double
    }


def stored_precision(study: str) -> dict[str, dict[str, float]]:
    """The measured table of a study, loop -> metric -> relative difference."""
    return packaged_toml(study, "precision.toml")


def single_precision_error(case: Case, entry: NamedLoop) -> tuple[str, float]:
    """How far single precision is off for a case of a loop, and in which metric.

    At the loop's own timing that is stored for the published studies. At any other, and for a loop
    of the user's own, it is measured: errors grow with the length of a run and with the rate of
    its control periods. Needs double precision to be switched on.
    """
    if case.timing == entry.timing:
        for study in packaged_studies():
            table = stored_precision(study).get(entry.name)
            if table is not None:
                return worst(table)
    return worst(compare_precision(case))


def worst(table: dict[str, Any]) -> tuple[str, float]:
    """The metric with the largest difference, and that difference."""
    metric = max(table, key=lambda key: table[key])
    return metric, float(table[metric])
