"""Optimisers as pure functions: a state, and a step that asks an oracle.

A method searches from k starts at once. Its state holds, for each start, the point reached and the
objective there; a step maps state and oracle to the next state. All randomness comes from the seed
of ``begin``, so equal answers of the oracle give equal searches.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxstage.model.fields import definition
from tuning.tuner.problem.problem import GaussNewtonModel, ValueAndGrad
from tuning.tuner.search.cost_model import CostModel

#: derivatives that a method asks for beside values
Derivatives = Literal["", "gradient", "gauss_newton"]


class Oracle(NamedTuple):
    """Zeroth-, first- and second-order oracle of the objective J.

    Each function takes candidates z (m, n) and ``rows`` (m,), the start that each belongs to, and
    costs simulations of the training set (`cost_model`).

    Attributes:
        values: J, (m,).
        value_and_grad: J and dJ/dz by reverse mode.
        gauss_newton_model: J, dJ/dz and the Gauss-Newton matrix by forward mode.
    """

    values: Callable[[np.ndarray, np.ndarray], np.ndarray]
    value_and_grad: Callable[[np.ndarray, np.ndarray], ValueAndGrad]
    gauss_newton_model: Callable[[np.ndarray, np.ndarray], GaussNewtonModel]


#: A NamedTuple of arrays over the k starts, with at least ``z`` (k, n): the points reached,
#: ``value`` (k,): J there, ``gradient_norm`` (k,): NaN where unknown, and ``done`` (k,): True where
#: nothing better is found any more. Each method has its own.
State = Any


@definition
class Method:
    """An optimiser.

    Attributes:
        name: as options name it.
        needs: the derivatives that it asks for.
        first: (cost model, n) -> simulations of one start of n parameters until its first step has
            been tried.
        begin: (oracle, starts (k, n), seed) -> state.
        step: (oracle, state) -> state.
    """

    name: str
    needs: Derivatives
    first: Callable[[CostModel, int], float]
    begin: Callable[[Oracle, np.ndarray, int], State]
    step: Callable[[Oracle, State], State]
