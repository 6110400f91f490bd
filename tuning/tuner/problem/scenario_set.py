"""Training and held-out sets: contours x horizons x loads x starts x plants x noise seeds.

A set is asked for by a `Wanted`, kept as a table of plain data (`set_table`), and made into series
(`series`): one contour over one horizon, whose runs go in one batch. Plants are drawn within the
spreads from (seed, number) alone. A plant that cannot exist, such as one whose static friction is
below its Coulomb friction, is passed over.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxstage.model.fields import replace
from jaxstage.model.settings import SCENARIO_PARTS, apply, known_leaves
from jaxstage.model.validate import SHARED, check_leaves
from jaxstage.studies import Case, Timing
from tuning.store.gains_file import NO_GAINS, GainsFile
from tuning.store.prepare import prepare
from tuning.uncertainty.case_table import case_of, case_table
from tuning.uncertainty.scenario_blocks import with_max_delay
from tuning.uncertainty.scenario_file import NO_SCENARIO, ScenarioFile
from tuning.uncertainty.uncertain_space import draw, longest_delay, run_seed, space

#: plants drawn for one that is kept, at most
TRIES = 50
#: most runs of a set
MOST_RUNS = 100_000


class ContourSpec(NamedTuple):
    """What is driven. words: as for ``--set``."""

    loop: str
    words: tuple[str, ...] = ()


class SetSpec(NamedTuple):
    """A set as asked for: every combination of its parts.

    plants: drawn ones. nominal: the nominal plant comes before them. horizons: s; none: the length
    that the timing of a contour gives. skip: s that the figures leave out, or None for what the
    timing says. loads, starts: values to set, by name. spreads, correlations: as in a scenario
    file. design: of `DESIGNS`. dealt: the plants are dealt out to the contours and horizons, where
    else each of these meets them all.
    """

    contours: tuple[ContourSpec, ...]
    plants: int
    nominal: bool
    noise_seeds: int
    seed: int
    horizons: tuple[float, ...] = ()
    skip: float | None = None
    loads: tuple[Mapping[str, Any], ...] = ()
    starts: tuple[Mapping[str, Any], ...] = ()
    spreads: tuple[Mapping[str, Any], ...] = ()
    correlations: tuple[Mapping[str, Any], ...] = ()
    design: str = "random"
    dealt: bool = False


class RunSet(NamedTuple):
    """Runs of one contour over one horizon. values: path -> (runs, *shape) SI. seeds: (runs,) of
    the random keys. labels: of the runs, for people."""

    case: Case
    values: dict[str, np.ndarray]
    seeds: np.ndarray
    labels: tuple[str, ...]


def set_table(
    spec: SetSpec, gains: GainsFile = NO_GAINS, scenario: ScenarioFile = NO_SCENARIO
) -> dict[str, Any]:
    """A set as plain data: its parts, and the case of every contour and horizon.

    gains, scenario: as for `prepare`. Raises ValueError in one line for anything
    unknown or out of range.
    """
    cases = [
        _timed(contour, horizon, spec.skip, gains, scenario)
        for contour in spec.contours
        for horizon in spec.horizons or (None,)
    ]
    for case in cases[1:]:
        same_law(cases[0], case)
    return {
        "plants": spec.plants,
        "nominal": spec.nominal,
        "noise_seeds": spec.noise_seeds,
        "seed": spec.seed,
        "design": spec.design,
        "dealt": spec.dealt,
        "load": [dict(load) for load in spec.loads],
        "start": [dict(start) for start in spec.starts],
        "spread": [dict(spread) for spread in spec.spreads],
        "correlation": [dict(correlation) for correlation in spec.correlations],
        "case": [case_table(case) for case in cases],
    }


def _timed(
    contour: ContourSpec,
    horizon: float | None,
    skip: float | None,
    gains: GainsFile,
    scenario: ScenarioFile,
) -> Case:
    def retimed(timing: Timing) -> Timing:
        timing = timing if horizon is None else replace(timing, duration=horizon)
        return timing if skip is None else replace(timing, skip=skip)

    return prepare(contour.loop, contour.words, gains, scenario, retimed).case


def same_law(first: Case, other: Case) -> None:
    """Raise ValueError for two cases that no gains fit both."""
    structures = {jax.tree.structure(case.gains) for case in (first, other)}
    if first.loop.controller != other.loop.controller or len(structures) > 1:
        raise ValueError(
            f"{first.name} and {other.name} have different laws "
            f"({first.loop.controller.name}, {other.loop.controller.name}): no gains fit both"
        )


def run_sets(table: Mapping[str, Any], blocks: Mapping[str, Any]) -> list[RunSet]:
    """The runs of a `set_table`. Raises ValueError for impossible spreads, loads or starts."""
    parts = len(table["case"]) if table["dealt"] else 1
    return [
        _series(case_of(case, blocks), table, slice(i % parts, None, parts))
        for i, case in enumerate(table["case"])
    ]


def _series(case: Case, table: Mapping[str, Any], hand: slice) -> RunSet:
    """hand: the plants of this case among all."""
    parts: list[dict[str, np.ndarray]] = []
    labels: list[str] = []
    for load in table["load"] or ({},):
        for start in table["start"] or ({},):
            changed, paths = _changed(case, load, start)
            values, names = _plants(changed, table)
            values = {path: value[hand] for path, value in values.items()}
            names = names[hand]
            known = known_leaves((), changed.scenario)
            for path in paths:
                fixed = np.asarray(known[path][1], float)
                values.setdefault(path, np.broadcast_to(fixed, (len(names), *fixed.shape)))
            parts.append(values)
            told = [f"{name} = {value}" for name, value in {**load, **start}.items()]
            labels += [", ".join((case.name, name, *told)) for name in names]
    repeats = table["noise_seeds"]
    stacked = {
        path: np.repeat(np.concatenate([part[path] for part in parts]), repeats, axis=0)
        for path in parts[0]
    }
    told = [f", noise {i}" if repeats > 1 else "" for i in range(repeats)]
    named = tuple(name + noise for name in labels for noise in told)
    seeds = np.array([run_seed(table["seed"], i) for i in range(len(named))], np.uint32)
    delayed = with_max_delay(case, longest_delay(space(case, table["spread"], ())))
    return RunSet(delayed, stacked, seeds, named)


def _changed(
    case: Case, load: Mapping[str, Any], start: Mapping[str, Any]
) -> tuple[Case, tuple[str, ...]]:
    """The case with another load and start, and the paths that differ."""
    given = {f"load.{k}": v for k, v in load.items()} | {f"start.{k}": v for k, v in start.items()}
    _, scenario, _, paths = apply((), case.scenario, given)
    return case._replace(scenario=scenario), paths


def _plants(case: Case, table: Mapping[str, Any]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Values of the plants, path -> (n, *shape), and their names."""
    found = space(case, table["spread"], table["correlation"])
    count, most = table["plants"], TRIES * max(table["plants"], 1)
    rows: list[Mapping[str, np.ndarray]] = []
    names: list[str] = []
    if table["nominal"]:
        rows.append({item.path: item.nominal for item in found.uncertain})
        names.append("nominal plant")
    drawn = draw(found, table["design"], table["seed"], most, 0, most)
    for number in range(most):
        row = {path: value[number] for path, value in drawn.items()}
        if len(rows) < count + table["nominal"] and _possible(case, row):
            rows.append(row)
            names.append(f"plant {number}")
    if len(rows) < count + table["nominal"]:
        raise ValueError(
            f"{case.name}: of {most} plants drawn, only {len(rows) - table['nominal']} can exist; "
            "bound the spreads with low and high"
        )
    return {
        item.path: np.stack([row[item.path] for row in rows]) for item in found.uncertain
    }, names


def _possible(case: Case, values: Mapping[str, np.ndarray]) -> bool:
    """Whether a machine with these values is within the ranges of its fields."""
    plain = {path: value for path, value in values.items() if not path.startswith("reference.")}
    _, scenario, _, _ = apply((), case.scenario, plain)
    try:
        for name in SCENARIO_PARTS:
            tree = getattr(scenario, name)
            shared = jax.tree.map(lambda _: SHARED, tree)
            check_leaves(case.loop.plant, tree, name, shared, per_axis=name == "sensor")
    except ValueError:
        return False
    return True


def count_runs(table: Mapping[str, Any]) -> int:
    """Runs of a whole set."""
    variants = max(1, len(table["load"])) * max(1, len(table["start"]))
    plants = table["plants"] + table["nominal"]
    meetings = 1 if table["dealt"] else len(table["case"])
    return meetings * plants * variants * table["noise_seeds"]


def widened(spreads: Sequence[Mapping[str, Any]], share: float) -> list[dict[str, Any]]:
    """Uniform factors 1 -+ share in place of narrower ones; any other spread as it is."""
    found = []
    for spread in spreads:
        low, high = (spread.get(key) for key in ("low", "high"))
        factors = spread.get("distribution") == "uniform" and spread.get("relative", True)
        if factors and low is not None and high is not None:
            spread = {**spread, "low": min(low, 1 - share), "high": max(high, 1 + share)}
        found.append(dict(spread))
    return found
