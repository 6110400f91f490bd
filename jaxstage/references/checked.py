"""Range checks of the parameters of a motion (host only)."""

import math
from typing import cast

import numpy as np
from jax import Array


def finite(name: str, value: float) -> Array:
    """The value as a float64 array (). Raises ValueError unless it is finite."""
    if not math.isfinite(value):
        raise ValueError(f"{name} must be finite; got {value!r}")
    return cast(Array, np.asarray(value, float))


def positive(name: str, value: float, unit: str) -> Array:
    """The value as a float64 array (). Raises ValueError unless it is finite and > 0."""
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} must be finite and > 0 {unit}; got {value!r}")
    return cast(Array, np.asarray(value, float))
