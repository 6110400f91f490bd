"""What a method is: pure steps that ask an oracle about candidates.

A state holds, for each of k starts, the point reached and its value. A step takes the state and the
oracle, and returns the next state; all randomness comes from the seed of ``begin``.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxstage.model.fields import definition
from tuning.tuner.problem.problem import GaussNewtonModel, ValueAndGrad
from tuning.tuner.search.cost_model import CostModel


class Oracle(NamedTuple):
    """Questions about candidates z (m, n); ``rows`` (m,) tells which start each belongs to.

    values -> J (m,); slopes and curvatures: see `problem`. Every question costs units.
    """

    values: Callable[[np.ndarray, np.ndarray], np.ndarray]
    value_and_grad: Callable[[np.ndarray, np.ndarray], ValueAndGrad]
    gauss_newton_model: Callable[[np.ndarray, np.ndarray], GaussNewtonModel]


#: A NamedTuple of arrays over the k starts, with at least ``z`` (k, n): the points reached,
#: ``value`` (k,): their objective, ``gradient_norm`` (k,): NaN where unknown, and ``done`` (k,):
#: True where nothing better is found any more.
State = Any


@definition
class Method:
    """begin(oracle, starts (k, n), seed) -> state; step(oracle, state) -> state.

    needs: what it asks the oracle beside values: "", "slopes" or "curvatures". first(prices, n):
    units of a start of n parameters until its first step is tried."""

    name: str
    needs: str
    first: Callable[[CostModel, int], float]
    begin: Callable[[Oracle, np.ndarray, int], State]
    step: Callable[[Oracle, State], State]
