"""What gains are trained on and judged by: the study's own spreads, or the user's file.

    [train]
    plants = 3                   # drawn within the spreads, after the nominal one
    nominal = true
    noise_seeds = 1              # random keys of each plant
    seed = 0                     # of the draws
    horizons = [1.0]             # s; left out: as long as the timing of a contour says
    skip = 0.2                   # s that the figures leave out, at the start

    [[train.contour]]            # every contour with every horizon, plant, ...
    loop = "dfcmac-circle"       # loops with the law that is tuned
    set = ["lap_time=1"]         # as --set

    [[train.load]]               # values of the load, each with every plant
    amplitude = [20.0, 15.0, 10.0]

    [[train.start]]              # likewise where a run begins
    offset = [1e-4, 0.0]

    [[train.spread]]             # as in a scenario file; left out: those of the study
    path = "plant.mass"
    distribution = "uniform"
    low = 0.8
    high = 1.2

    [held_out]                   # the same keys; never simulated before the gains are final
    plants = 100
    dealt = true                 # among the contours; false: each contour meets all

What is left out is taken from the default of its set (`default_training`, `default_held_out`).
"""

import functools
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.fields import leaves, replace
from jaxstage.settings import line_of, nearest_name, read_toml
from jaxstage.studies import Case, Timing, find, known_studies
from tuning.designs import DESIGNS
from tuning.runs import prepare
from tuning.scenario_file import ScenarioFile, read_scenario
from tuning.scenarios import study_spreads
from tuning.tuner.sets import MOST_RUNS, Contour, Wanted, widened

#: most control periods of a training run, where nothing else is said
TRAINING_TICKS = 10_000
#: a held-out run is so many times as long
LONGER = 4
#: share of a run that its figures leave out, unless the loop's timing judges whole runs: the start
START_SHARE = 0.2
#: plants: drawn for training, and held out
PLANTS, HELD_OUT = 2, 100
#: least spread of what is uncertain: factors 1 -+ this
SPREAD = 0.2
#: added to the seed for the plants that are held out
HELD_OUT_SEED = 1_000_001
#: control periods of a lap that is only compared with others
GLANCE = 200


class Asked(NamedTuple):
    """The loop whose gains are tuned, and what was said about it, as for ``jaxstage run``.

    spreads: what is uncertain, where a set says nothing of its own (`spreads_of`)."""

    loop: str
    words: tuple[str, ...]
    gains: Path | None
    scenario: Path | None
    spreads: tuple[Mapping[str, Any], ...]
    correlations: tuple[Mapping[str, Any], ...]
    seed: int


def spreads_of(loop: str, file: Path | None) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Spreads and correlations of a scenario file, else the study's, at least +-20 % wide."""
    content = read_scenario(file) if file else ScenarioFile({}, [], [])
    spreads = content.spreads or widened(study_spreads(find(loop).name), SPREAD)
    return spreads, content.correlations


def shortened(timing: Timing) -> Timing:
    """The timing of a training run: at most `TRAINING_TICKS` control periods, by fewer laps or,
    where one lap is longer than that, a faster one."""
    most = TRAINING_TICKS * timing.dt
    whole = timing.laps * timing.lap_time if timing.duration is None else timing.duration
    if timing.feed is not None:
        return _judged(timing, replace(timing, duration=most))
    lap = min(timing.lap_time, most)
    laps = max(1, math.floor(most / lap * (1 + 1e-9)))
    return _judged(timing, replace(timing, lap_time=lap, duration=min(whole, laps * lap)))


def longer(timing: Timing) -> Timing:
    """The timing of a held-out run: the loop's own lap, `LONGER` times as long as training."""
    duration = shortened(timing).duration
    assert duration is not None
    return _judged(timing, replace(timing, duration=LONGER * duration))


def _judged(own: Timing, changed: Timing) -> Timing:
    """Figures cover all but the start, or the whole run where the loop's own timing says so."""
    if own.scored == 0:
        return changed
    assert changed.duration is not None
    start = START_SHARE * changed.duration
    skip = start if own.skip is None else min(own.skip, changed.duration / 2)
    return replace(changed, scored=None, skip=skip)


def default_training(asked: Asked, case: Case) -> Wanted:
    """The nominal plant and `PLANTS` others on the contour of the loop, in a lap that fits, and at
    the loop's own speed on the one with the sharpest corners, if others are left to be held out.
    case: of the loop."""
    timing = shortened(case.timing)
    assert timing.duration is not None
    contours = [Contour(asked.loop, (*asked.words, *_changed_words(case.timing, timing)))]
    others = sisters(asked.loop, case.timing.dt, case.timing.substeps)
    contours += [Contour(others[0], asked.words)] if len(others) > 1 else []
    return Wanted(
        contours=tuple(contours),
        plants=PLANTS, nominal=True, noise_seeds=1, seed=asked.seed, horizons=(timing.duration,),
        skip=timing.skip, spreads=asked.spreads, correlations=asked.correlations, design="sobol",
    )  # fmt: skip


def _changed_words(own: Timing, timing: Timing) -> tuple[str, ...]:
    return (f"lap_time={timing.lap_time!r}",) if timing.lap_time != own.lap_time else ()


def default_held_out(asked: Asked, case: Case) -> Wanted:
    """`HELD_OUT` plants, on the contours of the law that are not trained on where there are any,
    else with the motion spread, too, at the loop's own lap time and `LONGER` times as long."""
    timing = longer(case.timing)
    assert timing.duration is not None
    others = sisters(asked.loop, case.timing.dt, case.timing.substeps)
    others = others[1:] if len(others) > 1 else others
    own = [
        {"path": path, "distribution": "uniform", "low": 1 - SPREAD, "high": 1 + SPREAD}
        for path, quantity, value in leaves(case.path, "reference")
        if quantity.role == "param" and np.all(np.asarray(value) != 0)
    ]
    motion = [] if others else own
    spreads = (*asked.spreads, *motion)
    return Wanted(
        contours=tuple(Contour(name, asked.words) for name in others or (asked.loop,)),
        plants=HELD_OUT, nominal=False, noise_seeds=1, seed=(asked.seed + HELD_OUT_SEED) % 2**32,
        horizons=(timing.duration,), skip=timing.skip, spreads=spreads,
        correlations=asked.correlations, dealt=True,
    )  # fmt: skip


@functools.cache
def sisters(loop: str, dt: float, substeps: int) -> tuple[str, ...]:
    """Loops of the same study with the same law and published gains on another contour, the one
    with the sharpest corners first."""
    stem = loop.rpartition("-")[0]
    study = next(s for s in known_studies() if any(entry.name == loop for entry in s.loops))
    names = [e.name for e in study.loops if stem and e.name.startswith(f"{stem}-")]
    if len(names) < 2:
        return ()
    # a short lap: only the curves are compared
    timing = Timing(lap_time=GLANCE * dt, laps=1, dt=dt, substeps=substeps)
    built = {name: find(name).build(timing) for name in names}
    found = [n for n in names if n != loop and _are_sisters(built[loop], built[n])]
    return tuple(sorted(found, key=lambda name: -_sharpness(built[name])))


def _sharpness(case: Case) -> float:
    """Largest change of the commanded velocity in a tick, over the mean speed."""
    ticks = jnp.arange(case.window.lap)
    velocity = np.asarray(
        jax.vmap(case.loop.reference.sample, (None, 0))(case.path, ticks).velocity
    )
    steps = np.linalg.norm(np.roll(velocity, -1, axis=0) - velocity, axis=1)
    return float(steps.max() / np.linalg.norm(velocity, axis=1).mean())


def _are_sisters(own: Case, other: Case) -> bool:
    blocks = ("plant", "controller", "reference", "load", "sensor", "drive")
    same = all(getattr(own.loop, b) == getattr(other.loop, b) for b in blocks)
    return same and _equal(own.gains, other.gains) and not _equal(own.path, other.path)


def _equal(a: Any, b: Any) -> bool:
    if jax.tree.structure(a) != jax.tree.structure(b):
        return False
    return all(np.array_equal(x, y) for x, y in zip(*map(jax.tree.leaves, (a, b)), strict=True))


# --- the user's file ---------------------------------------------------------------------------


class Sets(NamedTuple):
    """What is trained on and what is held out."""

    train: Wanted
    held_out: Wanted


def read_sets(file: Path | None, asked: Asked) -> Sets:
    """The sets of a file, or the default ones.

    Raises ValueError, one line with its place, for anything unknown or out of range.
    """
    case = prepare(asked.loop, list(asked.words), asked.gains, asked.scenario).case
    sets = Sets(default_training(asked, case), default_held_out(asked, case))
    if file is None:
        return sets
    content = read_toml(file)
    for name in content:
        if name.partition(".")[0] not in Sets._fields:
            raise ValueError(
                f"{file}:{line_of(file, name)}: '{name}' is not in [train], [held_out]"
            )
    return Sets(*(_read(file, content, name, set_) for name, set_ in sets._asdict().items()))


def _read(file: Path, content: Mapping[str, Any], name: str, default: Wanted) -> Wanted:
    given = {
        key.removeprefix(f"{name}."): value
        for key, value in content.items()
        if key.startswith(f"{name}.")
    }
    if "contour" in given and "horizons" not in given:  # the timing of a contour then counts
        default = default._replace(horizons=(), skip=None)
    wanted = default
    for key, value in given.items():
        try:
            if key not in _KEYS:
                hint = nearest_name(key, _KEYS)
                raise ValueError(f"unknown key '{key}'{hint}: one of {', '.join(_KEYS)}")
            field, convert = _KEYS[key]
            wanted = wanted._replace(**{field: convert(key, value)})
        except ValueError as error:
            raise ValueError(f"{file}:{_line(file, name, key)}: [{name}] {error}") from None
    return _whole(file, name, wanted)


def _line(file: Path, table: str, key: str) -> int:
    """The line of a key within a table, or of the first [[table.key]]."""
    inside = False
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), start=1):
        text = line.split("#")[0].strip()
        if text.startswith("["):
            inside = text.strip("[] ") == table
            if text.strip("[] ") == f"{table}.{key}":
                return number
        elif inside and text.split("=")[0].strip() == key:
            return number
    return line_of(file, key)


def _whole(file: Path, name: str, wanted: Wanted) -> Wanted:
    if wanted.plants + wanted.nominal < 1:
        raise ValueError(f"{file}: [{name}] holds no plant: plants = 0 needs nominal = true")
    if wanted.dealt and wanted.plants + wanted.nominal < len(wanted.contours):
        raise ValueError(f"{file}: [{name}] fewer plants than contours to deal them to")
    if wanted.plants and not wanted.spreads:
        raise ValueError(f"{file}: [{name}] nothing is uncertain: give [[{name}.spread]] tables")
    return wanted


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


def _contours(key: str, value: Any) -> tuple[Contour, ...]:
    return tuple(_contour(table) for table in _tables(key, value))


def _contour(table: Mapping[str, Any]) -> Contour:
    wrong = set(table) - {"loop", "set"}
    if wrong:
        raise ValueError(f"contour: unknown key '{sorted(wrong)[0]}': one of loop, set")
    words = table.get("set", [])
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise ValueError(f'contour: set = {words}: must be a list like ["lap_time=1"]')
    return Contour(find(str(table.get("loop", ""))).name, tuple(words))


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


def apart(sets: Sets) -> None:
    """Refuse a held-out set that is the training set. Raises ValueError."""
    same = ("contours", "seed", "horizons", "spreads", "design")
    if all(getattr(sets.train, key) == getattr(sets.held_out, key) for key in same):
        raise ValueError("the held-out set is the training set: give it another seed or contour")
