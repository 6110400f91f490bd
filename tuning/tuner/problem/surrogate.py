"""Surrogate machines: smoother than the exact ones, to search on; results are accepted on those."""

from collections.abc import Callable

from jaxstage.model.fields import replace
from jaxstage.numerics.smooth import creeping
from jaxstage.plants import pmsm_table
from jaxstage.studies import Case

#: no surrogate
NONE = "none"


def with_creeping(case: Case) -> Case:
    """Regularised friction: it creeps in place of sticking.

    Raises:
        ValueError: the machine has no friction that sticks.
    """
    plant = case.loop.plant
    if plant != pmsm_table(plant.axes):
        raise ValueError(f"--surrogate creeping: {plant.name} has no dry friction that sticks")
    return case._replace(loop=replace(case.loop, plant=pmsm_table(plant.axes, creeping)))


#: by the names that ``--surrogate`` takes
SURROGATES: dict[str, Callable[[Case], Case]] = {NONE: lambda case: case, "creeping": with_creeping}
