"""Screening: quasi-random points around a vector, in the coordinates of a search."""

import numpy as np
from scipy.special import ndtri

from tuning.uncertainty.designs import sobol_rows
from tuning.uncertainty.distributions import TAIL


def sobol_normal(seed: int, count: int, size: int) -> np.ndarray:
    """Scrambled Sobol sequence with standard normal marginals.

    Args:
        seed: of the scrambling.
        count: points.
        size: dimensions.

    Returns:
        (count, size).
    """
    return ndtri(np.clip(sobol_rows(seed, count, size, 0, count), TAIL, 1 - TAIL))
