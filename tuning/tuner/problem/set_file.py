"""The user's file of training and held-out sets (its keys: `default_sets`)."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from jaxstage.model.settings import TomlFile, nearest_name, read_toml
from jaxstage.studies import Case, find
from tuning.tuner.problem.default_sets import LoopSpec, default_held_out, default_training
from tuning.tuner.problem.scenario_set import MOST_RUNS, ContourSpec, SetSpec
from tuning.uncertainty.designs import DESIGNS


class ScenarioSets(NamedTuple):
    """What is trained on and what is held out."""

    train: SetSpec
    held_out: SetSpec


def read_sets(file: Path | None, loop_spec: LoopSpec, case: Case) -> ScenarioSets:
    """The sets of a file, or the default ones.

    Args:
        file: as for ``--train``; None: all defaults.
        loop_spec: the loop that is tuned, and what was said about it.
        case: the same loop, built.

    Raises:
        ValueError: in one line with its place, for anything unknown or out of range.
    """
    sets = ScenarioSets(default_training(loop_spec, case), default_held_out(loop_spec, case))
    if file is None:
        return sets
    toml = read_toml(file)
    for name in toml.values:
        if name.partition(".")[0] not in ScenarioSets._fields:
            raise ValueError(f"{toml.place(name)}: '{name}' is not in [train], [held_out]")
    return ScenarioSets(*(_read(toml, name, default) for name, default in sets._asdict().items()))


def _read(toml: TomlFile, name: str, default: SetSpec) -> SetSpec:
    """The set of a table of the file."""
    stem = f"{name}."
    keys = {k.removeprefix(stem): v for k, v in toml.values.items() if k.startswith(stem)}
    spec = default
    if "contour" in keys and "horizons" not in keys:  # the timing of a contour then counts
        spec = spec._replace(horizons=(), skip=None)
    for key, value in keys.items():
        try:
            if key not in _KEYS:
                hint = nearest_name(key, _KEYS)
                raise ValueError(f"unknown key '{key}'{hint}: one of {', '.join(_KEYS)}")
            field, convert = _KEYS[key]
            spec = spec._replace(**{field: convert(key, value)})
        except ValueError as error:
            raise ValueError(f"{toml.place(stem + key)}: [{name}] {error}") from None
    wrong = _contradiction(name, spec)
    if wrong:
        raise ValueError(f"{toml.file}: [{name}] {wrong}")
    return spec


def _contradiction(name: str, spec: SetSpec) -> str:
    """What keys contradict each other, or nothing."""
    plants = spec.plants + spec.nominal
    if plants < 1:
        return "holds no plant: plants = 0 needs nominal = true"
    if spec.dealt and plants < len(spec.contours):
        return "fewer plants than contours to deal them to"
    if spec.plants and not spec.spreads:
        return f"nothing is uncertain: give [[{name}.spread]] tables"
    return ""


def _count(least: int, most: int = MOST_RUNS) -> Callable[[str, Any], int]:
    def convert(key: str, value: Any) -> int:
        if type(value) is not int or not least <= value <= most:
            raise ValueError(f"{key} = {value}: must be a whole number {least}..{most}")
        return value

    return convert


def _flag(key: str, value: Any) -> bool:
    if type(value) is not bool:
        raise ValueError(f"{key} = {value}: must be true or false")
    return value


def _time(least: float) -> Callable[[str, Any], float]:
    def convert(key: str, value: Any) -> float:
        if type(value) not in (int, float) or not (math.isfinite(value) and value >= least):
            raise ValueError(f"{key} = {value}: must be {'> 0' if least else '>= 0'} s")
        return float(value)

    return convert


def _times(key: str, value: Any) -> tuple[float, ...]:
    if not isinstance(value, list) or not value:
        raise ValueError(f"{key} = {value}: must be a list of times in s")
    return tuple(_time(1e-9)(key, v) for v in value)


def _tables(key: str, value: Any) -> tuple[Mapping[str, Any], ...]:
    if not isinstance(value, list) or not value or not all(isinstance(t, dict) for t in value):
        raise ValueError(f"write [[...{key}]], a table for each")
    return tuple(value)


def _contours(key: str, value: Any) -> tuple[ContourSpec, ...]:
    return tuple(_contour(table) for table in _tables(key, value))


def _contour(table: Mapping[str, Any]) -> ContourSpec:
    wrong = set(table) - {"loop", "set"}
    if wrong:
        raise ValueError(f"contour: unknown key '{sorted(wrong)[0]}': one of loop, set")
    words = table.get("set", [])
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise ValueError(f'contour: set = {words}: must be a list like ["lap_time=1"]')
    return ContourSpec(find(str(table.get("loop", ""))).name, tuple(words))


def _design(key: str, value: Any) -> str:
    names = [name for name in DESIGNS if name not in ("corners", "saltelli")]
    if value not in names:
        raise ValueError(f"{key} = {value}: must be one of {', '.join(names)}")
    return value


#: key of the file -> field of `SetSpec`, and what checks it
_KEYS: dict[str, tuple[str, Callable[[str, Any], Any]]] = {
    "contour": ("contours", _contours),
    "plants": ("plants", _count(0)),
    "nominal": ("nominal", _flag),
    "noise_seeds": ("noise_seeds", _count(1)),
    "seed": ("seed", _count(0, 2**32 - 1)),
    "horizons": ("horizons", _times),
    "skip": ("skip", _time(0.0)),
    "load": ("loads", _tables),
    "start": ("starts", _tables),
    "spread": ("spreads", _tables),
    "correlation": ("correlations", _tables),
    "design": ("design", _design),
    "dealt": ("dealt", _flag),
}


def refuse_overlap(sets: ScenarioSets) -> None:
    """Refuse a held-out set that is the training set.

    Raises:
        ValueError: they have the same contours, seed, horizons, spreads and design.
    """
    same = ("contours", "seed", "horizons", "spreads", "design")
    if all(getattr(sets.train, key) == getattr(sets.held_out, key) for key in same):
        raise ValueError("the held-out set is the training set: give it another seed or contour")
