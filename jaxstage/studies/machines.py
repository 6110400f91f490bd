"""Machines drawn from the spreads of a study."""

from collections.abc import Iterable

import jax.numpy as jnp
import numpy as np

from jaxstage.model.settings import known_leaves, replaced
from jaxstage.studies.case import Case
from jaxstage.studies.study import Spread


def other_machine(case: Case, spreads: Iterable[Spread], seed: int) -> Case:
    """The case with every spread value drawn on its own per axis; the law's model stays."""
    draw = np.random.default_rng(seed)
    gains, scenario = case.gains, case.scenario
    for spread in spreads:
        value = known_leaves(gains, scenario)[spread.path][1]
        factor = jnp.asarray(draw.uniform(spread.low, spread.high, jnp.shape(value)))
        gains, scenario = replaced(gains, scenario, spread.path, value * factor)
    return case._replace(gains=gains, scenario=scenario)
