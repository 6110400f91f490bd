"""Serialisation of a case as plain data, for configurations: equal text means equal numbers."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxstage.model.fields import leaves
from jaxstage.model.settings import with_leaf
from jaxstage.studies import Case, Timing, find
from jaxstage.studies.own import VARIABLE, file_digest
from tuning.uncertainty.scenario_blocks import with_blocks, with_max_delay
from tuning.uncertainty.uncertain_space import uncertain_leaves


def case_table(case: Case) -> dict[str, Any]:
    """A case as plain data: loop, law, timing, and every value of gains, scenario and motion."""
    known = {path: value for path, (_, value) in uncertain_leaves(case).items()}
    known |= {path: value for path, _, value in leaves(case.gains, "gains")}
    own = file_digest(case.name)
    return {
        "name": case.name,
        **({"file_sha256": own} if own else {}),
        "law": case.loop.controller.name,
        "timing": {k: v for k, v in vars(case.timing).items() if v is not None},
        "values": {path: np.asarray(value, float).tolist() for path, value in known.items()},
    }


def case_of(table: Mapping[str, Any], blocks: Mapping[str, Any]) -> Case:
    """The case of a `case_table`. blocks: part of the scenario -> name, see `scenario_blocks`.

    Raises ValueError where the loop is the user's own and its file has changed since.
    """
    entry = find(table["name"])
    if table.get("file_sha256") != file_digest(entry.name):
        raise ValueError(
            f"{entry.name}: its file in {VARIABLE} is not the one that this was configured with"
        )
    case = with_blocks(entry.build(Timing(**table["timing"])), blocks)
    delay = table["values"].get("drive.delay", 0.0)
    return with_values(with_max_delay(case, delay), table["values"])


def with_values(case: Case, values: Mapping[str, Any]) -> Case:
    """The case with leaves by full name of the setting, SI."""
    gains, scenario, path = case.gains, case.scenario, case.path
    for name, value in values.items():
        root, _, rest = name.partition(".")
        names, array = rest.split("."), jnp.asarray(value)
        if root == "gains":
            gains = with_leaf(gains, names, array)
        elif root == "reference":
            path = with_leaf(path, names, array)
        else:
            scenario = with_leaf(scenario, [root, *names], array)
    return case._replace(gains=gains, scenario=scenario, path=path)
