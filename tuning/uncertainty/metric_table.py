"""Table of metrics of a batch of runs: one row a run, units in the names of the columns."""

from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.metrics.table import reported_metrics
from jaxstage.model.blocks import Plant
from jaxstage.model.signals import Run
from jaxstage.studies import Case
from tuning.uncertainty.uncertain_space import Uncertain

#: columns that say what became of a run
FLAGS = ("finite", "left_path_at", "non_finite_at", "lost_at_s")


def parameter_columns(
    uncertain: Iterable[Uncertain], values: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Drawn values, one column an element, SI, e.g. ``plant_mass_x_kg``. values: path -> (n, *)."""
    table = {}
    for item in uncertain:
        flat = values[item.path].reshape(len(values[item.path]), -1)
        table |= {name: flat[:, i] for i, name in enumerate(item.columns)}
    return table


def metric_columns(report: Any, plant: Plant) -> dict[str, np.ndarray]:
    """Metrics of a batch in display units, one column an axis, e.g. ``following_rms_x_um``.

    Args:
        report: Leaves (n,) or (n, axes), SI.
        plant: Gives the names of the axes and the unit of the command.

    Returns:
        Column -> (n,), NaN where a run was lost.
    """
    batch = jax.tree.map(lambda x: np.asarray(x, float), report)
    table = {}
    for metric in reported_metrics(batch, plant, batch=1):
        table |= metric.columns()
    return table


def metric_names(case: Case) -> tuple[str, ...]:
    """The columns that `metric_columns` gives for the runs of a case."""
    loop = case.loop

    def report() -> Any:
        first = loop.reference.sample(case.path, jnp.zeros((), jnp.int32))
        return loop.metric.finish(loop.metric.init(first))

    shapes = jax.eval_shape(report)  # computes nothing
    return tuple(
        metric_columns(jax.tree.map(lambda x: np.zeros((1, *x.shape)), shapes), loop.plant)
    )


def flag_columns(run: Run, dt: float) -> dict[str, np.ndarray]:
    """`FLAGS` of a batch; ticks are -1 and times NaN where nothing happened."""
    left, broken = (
        np.asarray(t).astype(np.int32) for t in (run.final.left_path_at, run.final.non_finite_at)
    )
    at = np.where(left >= 0, left, broken)
    flags = (at < 0, left, broken, np.where(at < 0, np.nan, at * dt))
    return dict(zip(FLAGS, flags, strict=True))
