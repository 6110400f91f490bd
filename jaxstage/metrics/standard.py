"""The default set of metrics."""

import functools
from collections.abc import Callable
from typing import Any

from jax import Array

from jaxstage.blocks import Metric
from jaxstage.metrics.contour import contour, tangent_contour
from jaxstage.metrics.effort import effort, saturation
from jaxstage.metrics.energy import energy
from jaxstage.metrics.tracking import following, quadrant_glitch, sliding_integral, tracking
from jaxstage.metrics.windows import together


@functools.cache
def standard(surface: Callable[[Any], Array] | None = None) -> Metric:
    """Tracking, following and contour errors, quadrant glitch, effort, saturation, energy.

    surface: picks the sliding variable (axes,) out of the controller's memory, for a law that
    has one; adds the integral of its magnitude.
    """
    metrics = (
        tracking,
        following,
        contour,
        tangent_contour,
        quadrant_glitch(),
        effort(),
        saturation,
        energy,
    )
    return together(*metrics, *((sliding_integral(surface),) if surface else ()))
