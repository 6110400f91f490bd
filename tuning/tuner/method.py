"""What a method is: pure steps that ask an oracle about candidates.

A state holds, for each of k starts, the point reached and its value. A step takes the state and the
oracle, and returns the next state; all randomness comes from the seed of ``begin``.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from jaxstage.fields import definition
from tuning.tuner.problem import Curvatures, Slopes


class Oracle(NamedTuple):
    """Questions about candidates z (m, n); ``rows`` (m,) tells which start each belongs to.

    values -> J (m,); slopes and curvatures: see `problem`. Every question costs units.
    """

    values: Callable[[np.ndarray, np.ndarray], np.ndarray]
    slopes: Callable[[np.ndarray, np.ndarray], Slopes]
    curvatures: Callable[[np.ndarray, np.ndarray], Curvatures]


class State(Protocol):
    """What every state has: points (k, n), values (k,), gradient norms (k,), NaN where unknown, and
    which starts are at an end (k,)."""

    @property
    def z(self) -> np.ndarray:
        """The points reached."""
        ...

    @property
    def value(self) -> np.ndarray:
        """Their objective."""
        ...

    @property
    def gradient_norm(self) -> np.ndarray:
        """Norm of the gradient."""
        ...

    @property
    def done(self) -> np.ndarray:
        """True where nothing better is found any more."""
        ...


@definition
class Method:
    """begin(oracle, starts (k, n), seed) -> state; step(oracle, state) -> state.

    needs: what it asks the oracle beside values: "", "slopes" or "curvatures"."""

    name: str
    needs: str
    begin: Callable[[Oracle, np.ndarray, int], Any]
    step: Callable[[Oracle, Any], Any]
