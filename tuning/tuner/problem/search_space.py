"""Search space: gains by path, symbol or part, each in its box, as one unconstrained vector z.

The box of a setting is the user's, else the study's, else a factor around the value before, always
within the range of the field. Labels name every coordinate.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.model.fields import Quantity, in_units_of, leaves
from jaxstage.model.settings import known_leaves, resolve, with_leaf
from jaxstage.studies import Case, known_studies
from jaxstage.studies.study import Box
from tuning.tuner.problem.transforms import Transform, boxed, linear, logarithmic, ordered
from tuning.uncertainty.uncertain_space import element_names

#: a box that nobody gives: so many times smaller and larger than the value before
FACTOR = 10.0
#: where not all are positive: so many times the largest magnitude to either side
SIGNED = 2.0
#: full path of a gain -> its quantity and value
Known = Mapping[str, tuple[Quantity, Any]]


class Search(NamedTuple):
    """What a user says of a setting. None: the default.

    Attributes:
        name: path, unique suffix or symbol of a setting, or a part with all gains below it.
        low, high: bounds of every element, SI.
        transform: of `TRANSFORMS`.
        tied: one number moves all its elements together.
        fixed: it keeps its value though a part that holds it is searched.
    """

    name: str
    low: float | None = None
    high: float | None = None
    transform: Transform | None = None
    tied: bool = False
    fixed: bool = False


class SearchedGain(NamedTuple):
    """One searched setting.

    Attributes:
        path: full path, such as ``gains.slope``.
        symbol: as the source of the law writes it.
        unit: SI.
        transform: from its coordinates to its value.
        low, high: the box, in its shape.
        before: its value before, in its shape.
        labels: of its elements.
        tied: one coordinate moves all elements.
        first, count: its coordinates within z.
    """

    path: str
    symbol: str
    unit: str
    transform: Transform
    low: np.ndarray
    high: np.ndarray
    before: np.ndarray
    labels: tuple[str, ...]
    tied: bool
    first: int
    count: int

    def z_of(self, value: np.ndarray) -> np.ndarray:
        """Its coordinates (count,) of a value."""
        z = self.transform.inverse(value, self.low, self.high, self.before)
        if not self.tied:
            return z.reshape(-1)
        begun = self.transform.inverse(self.before, self.low, self.high, self.before)
        return np.mean(z - begun, keepdims=True).reshape(1)

    def value_of(self, z: Array) -> Array:
        """Its value, in its shape, of its coordinates (count,)."""
        if self.tied:
            begun = self.transform.inverse(self.before, self.low, self.high, self.before)
            z = jnp.asarray(begun, z.dtype) + z[0]
        else:
            z = z.reshape(self.before.shape)
        return self.transform.forward(z, self.low, self.high, self.before)


class SearchSpace(NamedTuple):
    """All that is searched.

    Attributes:
        gains: those before, which hold what is not searched.
        entries: the searched settings.
    """

    gains: Any
    entries: tuple[SearchedGain, ...]

    @property
    def size(self) -> int:
        """n, the number of coordinates."""
        return sum(entry.count for entry in self.entries)

    @property
    def labels(self) -> tuple[str, ...]:
        """One a coordinate; of tied elements the setting alone."""
        return tuple(
            label
            for entry in self.entries
            for label in ((entry.path,) if entry.tied else entry.labels)
        )

    def gains_of(self, z: Array) -> Any:
        """The gains of one vector z (n,). Traceable."""
        gains = self.gains
        for entry in self.entries:
            value = entry.value_of(z[entry.first : entry.first + entry.count])
            gains = with_leaf(gains, entry.path.split(".")[1:], value)
        return gains

    def z_of(self, gains: Any) -> np.ndarray:
        """The vector (n,) of gains; values at or beyond the edge of a box are moved inside."""
        known = {path: value for path, _, value in leaves(gains, "gains")}
        return np.concatenate([e.z_of(np.asarray(known[e.path], float)) for e in self.entries])

    def start(self) -> np.ndarray:
        """The vector of the gains before."""
        return self.z_of(self.gains)


class Parameter(NamedTuple):
    """One element of a searched setting.

    Attributes:
        label: path and axis.
        path: of the setting.
        index: within the setting.
        symbol: of the setting.
        unit: SI.
        value, before: now and before tuning.
        low, high: its box.
        at_bound: within 1 % of an edge of its box, on the scale of its transform.
    """

    label: str
    path: str
    index: tuple[int, ...]
    symbol: str
    unit: str
    value: float
    before: float
    low: float
    high: float
    at_bound: bool


def parameters(space: SearchSpace, z: np.ndarray) -> tuple[Parameter, ...]:
    """Every element of what is searched, with its value at z (n,)."""
    return tuple(one for entry in space.entries for one in _elements(entry, z))


def _elements(e: SearchedGain, z: np.ndarray) -> Iterator[Parameter]:
    value = np.asarray(e.value_of(jnp.asarray(z[e.first : e.first + e.count])), float)
    near = _near_edge(e, value)
    for index, label in zip(np.ndindex(value.shape), e.labels, strict=True):
        now, before, low, high = (float(a[index]) for a in (value, e.before, e.low, e.high))
        where = (label, e.path, index, e.symbol, e.unit)
        yield Parameter(*where, now, before, low, high, at_bound=bool(near[index]))


def _near_edge(entry: SearchedGain, value: np.ndarray) -> np.ndarray:
    if entry.transform == linear:
        return np.zeros(value.shape, bool)
    scale = np.log if entry.transform == logarithmic else np.asarray
    low, high, at = (scale(x) for x in (entry.low, entry.high, value))
    return np.abs(2 * at - low - high) > 0.98 * (high - low)


# --- making one ------------------------------------------------------------------------------


def default_searches(case: Case) -> tuple[Search, ...]:
    """The boxes of the study of a case that the loop has; without any, every gain that is not 0."""
    known = [path for path, quantity in _gains(case).items() if _has_scale(*quantity)]
    boxes = _study_boxes(case, known)
    searches = [Search(path, box.low, box.high, tied=box.tied) for path, box in boxes.items()]
    return tuple(searches) or tuple(map(Search, known))


def _study_boxes(case: Case, paths: Iterable[str]) -> dict[str, Box]:
    """Path -> its box in the study of a case, of the paths that have one."""
    every = [
        box
        for study in known_studies()
        if any(entry.name == case.name for entry in study.loops)
        for box in study.boxes
    ]
    first = {path: next((b for b in every if path.endswith("." + b.path)), None) for path in paths}
    return {path: box for path, box in first.items() if box is not None}


def _has_scale(quantity: Quantity, value: Any) -> bool:
    """True for a gain whose elements say by themselves in what range to search."""
    array = np.asarray(value)
    return quantity.role == "gain" and bool(np.all(np.isfinite(array) & (array != 0)))


def search_space(case: Case, searches: Sequence[Search], factor: float = FACTOR) -> SearchSpace:
    """The space of what is named.

    Args:
        case: its gains are those before.
        searches: what is searched.
        factor: > 1; of the box around a value that has none of its own.

    Raises:
        ValueError: in one line, for an empty set, an unknown name, one named twice, bounds the
            wrong way round or outside of the range of the field, a value outside its box, and a
            value of 0 without a box.
    """
    if not factor > 1:
        raise ValueError(f"factor = {factor:g}: must be > 1")
    known = _gains(case)
    chosen = _chosen(known, searches)
    if not chosen:
        raise ValueError("nothing to tune: name gains, e.g. c1 (`jaxstage run` shows them)")
    boxes = _study_boxes(case, chosen)
    entries: list[SearchedGain] = []
    for path, search in chosen.items():
        search = _with_study_box(search, boxes.get(path), known[path][1])
        entry = _entry(case, path, known[path], search, factor)
        entries.append(entry._replace(first=sum(one.count for one in entries)))
    return SearchSpace(case.gains, _in_order(entries, known))


def _with_study_box(search: Search, box: Box | None, before: Any) -> Search:
    """The search with the bounds of the study where it has none of its own, and they hold the value
    before."""
    value = np.asarray(before, float)
    outside = box is None or np.any((value < box.low) | (value > box.high))
    if box is None or outside or search.transform in (linear, ordered):
        return search
    low = box.low if search.low is None else search.low
    return search._replace(low=low, high=box.high if search.high is None else search.high)


def _gains(case: Case) -> Known:
    known = known_leaves(case.gains, case.scenario)
    return {path: leaf for path, leaf in known.items() if path.startswith("gains.")}


def _chosen(known: Known, searches: Sequence[Search]) -> dict[str, Search]:
    """Full path -> what is said of it. A setting outweighs the part that holds it."""
    single: dict[str, Search] = {}
    within: dict[str, Search] = {}
    for search in searches:
        below = _part(known, search.name)
        for path in below or (resolve(search.name, known),):
            target = within if below else single
            if path in target:
                raise ValueError(f"{path} is named twice")
            target[path] = search
    both = {path: s for path, s in within.items() if path not in single} | single
    return {path: both[path] for path in known if path in both and not both[path].fixed}


def _part(known: Known, name: str) -> tuple[str, ...]:
    """The gains below a part that is named by path or suffix, without those that are 0."""
    return tuple(
        path
        for path, (quantity, value) in known.items()
        if f".{name}." in f".{path}" and _has_scale(quantity, value)
    )


def _entry(
    case: Case, path: str, leaf: tuple[Quantity, Any], search: Search, factor: float
) -> SearchedGain:
    quantity, before = (
        in_units_of(leaf[0], case.loop.plant.command_unit),
        np.asarray(leaf[1], float),
    )
    names = [element_names(index, before.shape, case) for index in np.ndindex(before.shape)]
    low, high = _box(path, quantity, before, search, factor)
    entry = SearchedGain(
        path=path,
        symbol=quantity.symbol,
        unit=quantity.unit,
        transform=search.transform or _suited(low, high),
        low=low,
        high=high,
        before=before,
        labels=tuple(" ".join((path, *name)) for name in names),
        tied=search.tied,
        first=0,
        count=1 if search.tied else before.size,
    )
    _check_box(entry, quantity)
    return entry


def _suited(low: np.ndarray, high: np.ndarray) -> Transform:
    if not np.all(np.isfinite(low) & np.isfinite(high)):
        return linear
    return logarithmic if np.all(low > 0) else boxed


def _box(
    path: str, quantity: Quantity, before: np.ndarray, search: Search, factor: float
) -> tuple[np.ndarray, np.ndarray]:
    if search.transform == linear:
        return np.full(before.shape, -np.inf), np.full(before.shape, np.inf)
    if search.transform == ordered:
        if before.ndim != 1 or np.any(np.diff(before) <= 0):
            raise ValueError(f"{path}: transform ordered needs a list of increasing values")
        low, high = _around(before)
    elif np.all(before > 0):
        low, high = before / factor, before * factor
    else:
        reach = SIGNED * np.max(np.abs(before))
        if reach == 0 and None in (search.low, search.high):
            raise ValueError(f"{path} is 0: give low and high to tune it")
        low, high = before - reach, before + reach
    low = np.maximum(low, quantity.low) if search.low is None else np.full_like(low, search.low)
    high = (
        np.minimum(high, quantity.high) if search.high is None else np.full_like(high, search.high)
    )
    if search.low is None and quantity.above > -np.inf:
        low = np.maximum(low, quantity.above + 1e-6 * (high - quantity.above))
    return low, high


def _around(before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A box for increasing values: one mean gap more at either end."""
    gap = (before[-1] - before[0]) / max(before.size - 1, 1)
    return np.full(before.shape, before[0] - gap), np.full(before.shape, before[-1] + gap)


def _check_box(entry: SearchedGain, quantity: Quantity) -> None:
    """Refuse a box that is empty, outside of the range of the field, or without the value."""
    path, low, high, transform = entry.path, entry.low, entry.high, entry.transform

    def first(wrong: np.ndarray, *arrays: np.ndarray) -> list[float]:
        """The numbers of the first element that is wrong."""
        at = np.unravel_index(int(np.argmax(wrong)), wrong.shape)
        return [float(a[at]) for a in arrays]

    if np.any(empty := low >= high):
        one, other = first(empty, low, high)
        raise ValueError(f"{path}: low = {one:g} must be below high = {other:g}")
    inside = (low >= quantity.low) & (low >= quantity.above) & (high <= quantity.high)
    if transform != linear and not np.all(inside):
        one, other = first(~inside, low, high)
        raise ValueError(
            f"{path}: the box {one:g}..{other:g} leaves the range of the field: "
            f"{quantity.range_text()}"
        )
    if np.any(out := (entry.before < low) | (entry.before > high)):
        value, one, other = first(out, entry.before, low, high)
        raise ValueError(f"{path} = {value:g} is outside its box {one:g}..{other:g}")
    if transform == logarithmic and not np.all(low > 0):
        raise ValueError(f"{path}: transform log needs low > 0, got {np.min(low):g}")
    if transform != linear and not np.all(np.isfinite(low) & np.isfinite(high)):
        raise ValueError(f"{path}: transform {transform.name} needs low and high")


def _in_order(entries: list[SearchedGain], known: Known) -> tuple[SearchedGain, ...]:
    """Boxes narrowed so that no value can fall below the one that its field must not fall below."""
    by_path = {entry.path: entry for entry in entries}
    for path, (quantity, value) in known.items():
        if not quantity.at_least:
            continue
        other = f"{path.rpartition('.')[0]}.{quantity.at_least}"
        upper, lower = np.asarray(value, float), np.asarray(known[other][1], float)
        if path in by_path and other in by_path:
            lower = upper = (lower + upper) / 2
        if path in by_path:
            one = by_path[path]
            by_path[path] = _narrowed(one._replace(low=np.maximum(one.low, lower)))
        if other in by_path:
            one = by_path[other]
            by_path[other] = _narrowed(one._replace(high=np.minimum(one.high, upper)))
    return tuple(by_path.values())


def _narrowed(entry: SearchedGain) -> SearchedGain:
    if np.any(entry.low >= entry.high):
        raise ValueError(f"{entry.path}: nothing is left of its box beside its neighbour's value")
    return entry
