"""Training runs: a case with drawn values and seeds, run together in one batch."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxstage.batch import spread_axes
from jaxstage.check import check
from jaxstage.drives import Amplified, amplified
from jaxstage.fields import replace
from jaxstage.studies import Case
from tuning.scenarios import Batch
from tuning.scenarios import batch as make_batch


class Group(NamedTuple):
    """Training runs of one contour and horizon. case: its gains are those before. weight: how much
    each of its runs counts."""

    name: str
    case: Case
    batch: Batch
    runs: int
    weight: float = 1.0


def make_group(
    name: str, case: Case, values: Mapping[str, np.ndarray], seeds: np.ndarray,
    margin: float = 0.0, weight: float = 1.0,
) -> Group:  # fmt: skip
    """Training runs of a case: drawn values path -> (runs, *shape) and seeds (runs,).

    margin: x adds two runs of the first plant whose drive gives 1 - x and 1 + x times what is
    commanded, so that gains near the edge of stability are lost in training. Raises ValueError for
    what cannot be simulated.
    """
    if not 0 <= margin < 1:
        raise ValueError(f"margin = {margin:g}: must be in 0..1")
    if not weight > 0:
        raise ValueError(f"weight = {weight:g} of {name}: must be > 0")
    if margin:
        loop = replace(case.loop, drive=amplified(case.loop.drive))
        params = Amplified(factor=jnp.ones(()), drive=case.scenario.drive)
        case = case._replace(loop=loop, scenario=replace(case.scenario, drive=params))
        values = _behind_amplifier(values, margin, len(seeds))
        seeds = np.append(seeds, [seeds[0]] * 2)
    drawn = make_batch(case, values, seeds)
    trees = (case.gains, drawn.scenario, drawn.path)
    check(case.loop, *trees, spread_axes(drawn.in_axes, trees))
    return Group(name, case, drawn, len(seeds), weight)


def _behind_amplifier(
    values: Mapping[str, np.ndarray], margin: float, runs: int
) -> dict[str, np.ndarray]:
    moved = {
        f"drive.{path}" if path.startswith("drive.") else path: np.append(v, v[[0, 0]], axis=0)
        for path, v in values.items()
    }
    return moved | {"drive.factor": np.append(np.ones(runs), [1 - margin, 1 + margin])}
