"""Uncertain parameters: of plant, load, sensor, drive, start and reference, and their draws.

The spreads come from the study of a loop, or from the user's scenario file (`scenario_file`).
Points of the unit cube (`designs`) become values by the quantiles of each distribution; correlated
values through a Gaussian copula. Everything is elementwise, so that run i is the same whichever
runs are drawn beside it.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtr, ndtri

from jaxstage.metrics.table import key as column_name
from jaxstage.model.fields import in_units_of, leaves
from jaxstage.model.settings import MOTION, known_leaves, replaced, resolve, with_leaf
from jaxstage.studies import Case, known_studies
from tuning.uncertainty.designs import DESIGNS
from tuning.uncertainty.distributions import TAIL, Distribution, from_table


class Uncertain(NamedTuple):
    """One uncertain setting.

    Attributes:
        path: Its full name, e.g. ``plant.mass``.
        distribution: Of the values, or of factors on them.
        relative: The distribution is that of factors on ``nominal``.
        shared: One draw for all its elements.
        nominal: The value before, SI.
        first: Its place in the unit cube.
        columns, labels, unit: Of its elements in a table.
    """

    path: str
    distribution: Distribution
    relative: bool
    shared: bool
    nominal: np.ndarray
    first: int
    columns: tuple[str, ...]
    labels: tuple[str, ...]
    unit: str

    def count(self) -> int:
        """How many independent numbers it takes."""
        return 1 if self.shared else self.nominal.size

    def numbers(self) -> dict[str, str]:
        """Column -> label of each independent number; of shared ones the first."""
        labels = (self.path,) if self.shared else self.labels
        return dict(zip(self.columns, labels, strict=False))

    def values(self, drawn: np.ndarray) -> np.ndarray:
        """(n, *shape) from draws of the distribution (n, count)."""
        each = np.broadcast_to(drawn, (len(drawn), self.nominal.size))
        shaped = each.reshape(len(drawn), *self.nominal.shape)
        return self.nominal * shaped if self.relative else shaped


class Space(NamedTuple):
    """All that is uncertain.

    Attributes:
        uncertain: The settings.
        mixing: Cholesky factor of the correlations, (dimensions, dimensions); None without any.
    """

    uncertain: tuple[Uncertain, ...]
    mixing: np.ndarray | None

    def dimensions(self) -> int:
        """Numbers a run draws."""
        return sum(item.count() for item in self.uncertain)


def uncertain_leaves(case: Case) -> dict[str, tuple[Any, Any]]:
    """What can be uncertain: full path -> (quantity, value); ``reference.`` of the motion."""
    return known_leaves((), case.scenario, case.path) | {
        path: (quantity, value)
        for path, quantity, value in leaves(case.path, MOTION)
        if quantity.role == "param"
    }


def study_spreads(loop: str) -> list[dict[str, Any]]:
    """The spreads of the study that a loop belongs to, as tables of a scenario file."""
    return [
        {"path": s.path, "distribution": "uniform", "low": s.low, "high": s.high}
        for study in known_studies()
        if any(entry.name == loop for entry in study.loops)
        for s in study.spreads
    ]


def space(
    case: Case, spreads: Sequence[Mapping[str, Any]], correlations: Sequence[Mapping[str, Any]]
) -> Space:
    """The uncertain values of a case.

    Args:
        case: The nominal plant.
        spreads, correlations: Tables as in a scenario file.

    Raises:
        ValueError: Naming the spread, for an unknown setting, one that stands twice, an impossible
            distribution or correlation, and for factors on a value that is 0.
    """
    items: list[Uncertain] = []
    for spread in spreads:
        first = sum(item.count() for item in items)
        item = _uncertain(case, dict(spread), first)
        if any(item.path == other.path for other in items):
            raise ValueError(f"the spread of {item.path} is given twice")
        items.append(item)
    dimensions = sum(item.count() for item in items)
    return Space(tuple(items), _mixing(items, dimensions, correlations) if correlations else None)


def _uncertain(case: Case, table: dict[str, Any], first: int) -> Uncertain:
    if "path" not in table:
        raise ValueError("a spread has a path, e.g. plant.mass")
    path = resolve(str(table.pop("path")), uncertain_leaves(case))
    quantity, value = uncertain_leaves(case)[path]
    flags = {name: table.pop(name, default) for name, default in FLAGS.items()}
    for name, flag in flags.items():
        if type(flag) is not bool:
            raise ValueError(f"{path}: {name} = {flag}: must be true or false")
    try:
        distribution = from_table(table)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    nominal = np.asarray(value, float)
    if flags["relative"] and not (np.isfinite(nominal) & (nominal != 0)).all():
        raise ValueError(
            f"{path} = {np.array2string(nominal, separator=', ')}: factors on it change nothing; "
            "relative = false draws the values themselves"
        )
    unit = in_units_of(quantity, case.loop.plant.command_unit).unit
    names = [element_names(index, nominal.shape, case) for index in np.ndindex(nominal.shape)]
    stem = path.replace(".", "_")
    return Uncertain(
        path=path,
        distribution=distribution,
        nominal=nominal,
        first=first,
        columns=tuple(column_name("_".join((stem, *name)), unit) for name in names),
        labels=tuple(" ".join((path, *name)) for name in names),
        unit=unit,
        **flags,
    )


#: the keys of a spread that are true or false
FLAGS = {"relative": True, "shared": False}


def element_names(index: tuple[int, ...], shape: tuple[int, ...], case: Case) -> tuple[str, ...]:
    """The names of an element's indices: of the axes where there are as many, else numbers."""
    axes = case.loop.plant.axes
    return tuple(
        axes[i] if size == len(axes) else str(i) for i, size in zip(index, shape, strict=True)
    )


def _mixing(
    items: Sequence[Uncertain], dimensions: int, correlations: Sequence[Mapping[str, Any]]
) -> np.ndarray:
    matrix = np.eye(dimensions)
    for table in correlations:
        between, value = table.get("between", ()), table.get("value")
        if len(table) != 2 or not isinstance(between, list) or len(between) != 2:
            raise ValueError("a correlation has between = [two settings] and value = -1..1")
        if not isinstance(value, int | float) or not -1 < value < 1:
            both = " and ".join(map(str, between))
            raise ValueError(f"correlation of {both} = {value}: must be > -1 and < 1")
        one, other = (_places(name, items) for name in between)
        if len(one) != len(other) or set(one) & set(other):
            raise ValueError(
                f"correlation of {between[0]} and {between[1]}: {len(one)} and {len(other)} "
                "numbers that must be as many and different ones"
            )
        for i, j in zip(one, other, strict=True):
            matrix[i, j] = matrix[j, i] = value
    try:
        return np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        raise ValueError("these correlations cannot hold together: not positive definite") from None


def _places(name: str, items: Sequence[Uncertain]) -> list[int]:
    """The places in the unit cube of a setting, or of one of its elements (``plant.mass.x``)."""
    for item in items:
        if name == item.path:
            return list(range(item.first, item.first + item.count()))
        for index, label in enumerate(item.labels):
            if name == label.replace(" ", ".") and not item.shared:
                return [item.first + index]
    known = ", ".join(item.path for item in items)
    raise ValueError(f"correlation of '{name}': not among the spreads {known}, whole or by axis")


def draw(
    space: Space, design: str, seed: int, runs: int, start: int, stop: int
) -> dict[str, np.ndarray]:
    """Values of runs start..stop-1: path -> (stop - start, *shape), SI, float64."""
    plan, dimensions = DESIGNS[design], space.dimensions()
    if not dimensions:
        return {}
    rows = plan.rows(seed, runs, dimensions, start, stop)
    columns = [np.ascontiguousarray(rows[:, d]) for d in range(dimensions)]
    if space.mixing is not None:
        columns = _correlated(columns, space.mixing)
    values = {}
    for item in space.uncertain:
        mine = columns[item.first : item.first + item.count()]
        drawn = [plan.values(item.distribution, column) for column in mine]
        values[item.path] = item.values(np.stack(drawn, axis=1))
    return values


def _correlated(columns: list[np.ndarray], mixing: np.ndarray) -> list[np.ndarray]:
    """Gaussian copula: z = L z0 of the normal scores z0, L the Cholesky factor of the correlations
    (Nelsen, An Introduction to Copulas, 2006). Summed element by element, as the rounding of a
    matrix product depends on its size."""
    normal = [ndtri(np.clip(column, TAIL, 1 - TAIL)) for column in columns]
    mixed = []
    for d, column in enumerate(columns):
        others = [k for k in range(d) if mixing[d, k]]
        total = sum((mixing[d, k] * normal[k] for k in others), mixing[d, d] * normal[d])
        mixed.append(ndtr(total) if others else column)
    return mixed


def run_seed(seed: int, run: int) -> int:
    """The seed of run i's random key: different for every run of a sweep."""
    return (seed * 1_000_003 + run) % 2**32


class Batch(NamedTuple):
    """Arguments of `rollouts`; ``in_axes`` has 0 where a leaf has a leading batch axis (runs,)."""

    gains: Any
    scenario: Any
    path: Any
    in_axes: Any


def batch(case: Case, values: Mapping[str, np.ndarray], seeds: np.ndarray) -> Batch:
    """A case with drawn values and a random key of its own in every run. seeds: (n,)."""
    scenario, path = case.scenario, case.path
    axes_of_scenario, axes_of_path = (jax.tree.map(lambda _: None, x) for x in (scenario, path))
    for name, value in values.items():
        array = jnp.asarray(value)
        root, _, rest = name.partition(".")
        if root == MOTION:
            path = with_leaf(path, rest.split("."), array)
            axes_of_path = with_leaf(axes_of_path, rest.split("."), 0)
        else:
            _, scenario = replaced((), scenario, name, array)
            _, axes_of_scenario = replaced((), axes_of_scenario, name, 0)
    keys = jax.vmap(jax.random.key)(jnp.asarray(seeds, jnp.uint32))
    scenario = with_leaf(scenario, ["key"], keys)
    axes_of_scenario = with_leaf(axes_of_scenario, ["key"], 0)
    return Batch(case.gains, scenario, path, (None, axes_of_scenario, axes_of_path))


def longest_delay(space: Space) -> int:
    """Control periods that the drive must be able to delay: the longest that is drawn."""
    ends = [
        item.distribution.high * (float(np.max(item.nominal)) if item.relative else 1.0)
        for item in space.uncertain
        if item.path == "drive.delay"
    ]
    return math.ceil(max(ends, default=0.0))
