"""The default set of metrics."""

import functools
from collections.abc import Callable
from typing import Any

from jax import Array

from jaxstage.metrics.contour import contour, tangent_contour
from jaxstage.metrics.effort import effort, saturation
from jaxstage.metrics.energy import energy
from jaxstage.metrics.glitch import quadrant_glitch
from jaxstage.metrics.law_memory import sliding_metrics
from jaxstage.metrics.tracking import following, tracking
from jaxstage.metrics.windows import together
from jaxstage.model.blocks import Metric


@functools.cache
def standard(
    surface: Callable[[Any], Array] | None = None,
    contours: tuple[Metric[Any, Any], ...] = (contour, tangent_contour),
    extra: tuple[Metric[Any, Any], ...] = (),
    cutoff: float = 100.0,
    reversal: float = 0.1,
) -> Metric[dict[str, Any], dict[str, Any]]:
    """Tracking, following and contour errors, quadrant glitch, effort, saturation, energy.

    Args:
        surface: picks the sliding variable (axes,) out of the controller's memory, for a law that
            has one; adds its metrics.
        contours: none for a single axis, which has no contour.
        extra: what a system is judged by beside these.
        cutoff: of the chattering, Hz.
        reversal: time after a reversal that belongs to its quadrant glitch, s.
    """
    metrics = (
        tracking,
        following,
        *contours,
        quadrant_glitch(reversal),
        effort(cutoff),
        saturation,
        energy,
    )
    return together(*metrics, *((sliding_metrics(surface),) if surface else ()), *extra)
