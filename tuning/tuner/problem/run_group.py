"""Training runs: a case with drawn values and random keys, simulated together in one batch."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxstage.hardware.drives import Amplified, amplified
from jaxstage.model.fields import replace
from jaxstage.model.validate import check
from jaxstage.simulate.batch import spread_axes
from jaxstage.studies import Case
from tuning.uncertainty.uncertain_space import Batch
from tuning.uncertainty.uncertain_space import batch as make_batch

#: what a run with a wrong gain counts beside the others, while it is not lost
MARGIN_WEIGHT = 0.05


class RunGroup(NamedTuple):
    """Training runs of one contour and horizon.

    Attributes:
        name: of the case, for people.
        case: its gains are those before.
        batch: scenario and motion of the runs.
        runs: how many.
        weights: how much each run counts, (runs,).
    """

    name: str
    case: Case
    batch: Batch
    runs: int
    weights: np.ndarray


def make_group(
    name: str, case: Case, values: Mapping[str, np.ndarray], seeds: np.ndarray, margin: float = 0.0
) -> RunGroup:
    """Training runs of a case, with a gain margin.

    A margin x adds two runs of the first plant whose drive gives 1 - x and 1 + x times what is
    commanded, so that gains near the edge of stability are lost in training. As long as they hold
    they count `MARGIN_WEIGHT` of the others.

    Args:
        name: of the group.
        case: loop, gains before, nominal scenario and motion.
        values: path -> drawn values (runs, *shape), SI.
        seeds: of the random keys, (runs,).
        margin: x, 0..1.

    Raises:
        ValueError: in one line, for what cannot be simulated.
    """
    if not 0 <= margin < 1:
        raise ValueError(f"margin = {margin:g}: must be in 0..1")
    weights = np.ones(len(seeds))
    if margin:
        weights = np.append(weights, [MARGIN_WEIGHT] * 2)
        loop = replace(case.loop, drive=amplified(case.loop.drive))
        params = Amplified(factor=jnp.ones(()), drive=case.scenario.drive)
        case = case._replace(loop=loop, scenario=replace(case.scenario, drive=params))
        values = _behind_amplifier(values, margin, len(seeds))
        seeds = np.append(seeds, [seeds[0]] * 2)
    drawn = make_batch(case, values, seeds)
    trees = (case.gains, drawn.scenario, drawn.path)
    check(case.loop, *trees, spread_axes(drawn.in_axes, trees))
    return RunGroup(name, case, drawn, len(seeds), weights)


def _behind_amplifier(
    values: Mapping[str, np.ndarray], margin: float, runs: int
) -> dict[str, np.ndarray]:
    """The values of all runs and of the two with a wrong gain."""
    moved = {
        f"drive.{path}" if path.startswith("drive.") else path: np.append(v, v[[0, 0]], axis=0)
        for path, v in values.items()
    }
    return moved | {"drive.factor": np.append(np.ones(runs), [1 - margin, 1 + margin])}
