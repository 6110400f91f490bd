"""The user's file of training and held-out sets."""

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
    """The sets of a file, or the default ones. case: of the loop that is tuned.

    Raises ValueError, one line with its place, for anything unknown or out of range.
    """
    sets = ScenarioSets(default_training(loop_spec, case), default_held_out(loop_spec, case))
    if file is None:
        return sets
    toml = read_toml(file)
    for name in toml.values:
        if name.partition(".")[0] not in ScenarioSets._fields:
            raise ValueError(f"{toml.place(name)}: '{name}' is not in [train], [held_out]")
    return ScenarioSets(*(_read(toml, name, set_) for name, set_ in sets._asdict().items()))


def _read(toml: TomlFile, name: str, default: SetSpec) -> SetSpec:
    given = {
        key.removeprefix(f"{name}."): value
        for key, value in toml.values.items()
        if key.startswith(f"{name}.")
    }
    if "contour" in given and "horizons" not in given:  # the timing of a contour then counts
        default = default._replace(horizons=(), skip=None)
    spec = default
    for key, value in given.items():
        try:
            if key not in _KEYS:
                hint = nearest_name(key, _KEYS)
                raise ValueError(f"unknown key '{key}'{hint}: one of {', '.join(_KEYS)}")
            field, convert = _KEYS[key]
            spec = spec._replace(**{field: convert(key, value)})
        except ValueError as error:
            raise ValueError(f"{toml.place(f'{name}.{key}')}: [{name}] {error}") from None
    return _whole(toml.file, name, spec)


def _whole(file: Path, name: str, spec: SetSpec) -> SetSpec:
    if spec.plants + spec.nominal < 1:
        raise ValueError(f"{file}: [{name}] holds no plant: plants = 0 needs nominal = true")
    if spec.dealt and spec.plants + spec.nominal < len(spec.contours):
        raise ValueError(f"{file}: [{name}] fewer plants than contours to deal them to")
    if spec.plants and not spec.spreads:
        raise ValueError(f"{file}: [{name}] nothing is uncertain: give [[{name}.spread]] tables")
    return spec


def _count(least: int) -> Callable[[str, Any], int]:
    def convert(key: str, value: Any) -> int:
        if type(value) is not int or not least <= value <= MOST_RUNS:
            raise ValueError(f"{key} = {value}: must be a whole number {least}..{MOST_RUNS}")
        return value

    return convert


def _seed(key: str, value: Any) -> int:
    if type(value) is not int or not 0 <= value < 2**32:
        raise ValueError(f"{key} = {value}: must be a whole number 0..{2**32 - 1}")
    return value


def _flag(key: str, value: Any) -> bool:
    if type(value) is not bool:
        raise ValueError(f"{key} = {value}: must be true or false")
    return value


def _time(least: float) -> Callable[[str, Any], float]:
    def convert(key: str, value: Any) -> float:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not (math.isfinite(value) and value >= least):
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


#: key of the file -> field of `Wanted`, and what checks it
_KEYS: dict[str, tuple[str, Callable[[str, Any], Any]]] = {
    "contour": ("contours", _contours),
    "plants": ("plants", _count(0)),
    "nominal": ("nominal", _flag),
    "noise_seeds": ("noise_seeds", _count(1)),
    "seed": ("seed", _seed),
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
    """Refuse a held-out set that is the training set. Raises ValueError."""
    same = ("contours", "seed", "horizons", "spreads", "design")
    if all(getattr(sets.train, key) == getattr(sets.held_out, key) for key in same):
        raise ValueError("the held-out set is the training set: give it another seed or contour")
