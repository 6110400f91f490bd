"""Scenario sets: contours x horizons x loads x starts x plants x noise seeds.

A set is asked for by a `SetSpec`, kept as a table of plain data (`set_table`), and made into run
sets (`run_sets`): one contour over one horizon, whose runs go in one batch. Plants are drawn within
the spreads from (seed, number) alone, so that gains are compared under common random numbers. A
plant that cannot exist, such as one whose static friction is below its Coulomb friction, is passed
over (rejection sampling).
"""

from collections.abc import Iterable, Mapping, Sequence
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
#: a set as plain data, see `set_table`
SetTable = dict[str, Any]


class ContourSpec(NamedTuple):
    """What is driven. words: as for ``--set``."""

    loop: str
    words: tuple[str, ...] = ()


class SetSpec(NamedTuple):
    """A set as asked for: every combination of its parts.

    Attributes:
        contours: what is driven.
        plants: how many are drawn.
        nominal: the nominal plant comes before them.
        noise_seeds: random keys of each plant.
        seed: of the draws.
        horizons: lengths of the runs, s; none: what the timing of a contour gives.
        skip: what the metrics leave out at the start, s; None: what the timing says.
        loads, starts: values to set, by name.
        spreads, correlations: as in a scenario file.
        design: of `DESIGNS`.
        dealt: each plant is assigned to one contour and horizon; else each of these meets them all.
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
    """Runs of one contour over one horizon.

    Attributes:
        case: loop, gains, nominal scenario and motion.
        values: path -> (runs, *shape), SI.
        seeds: of the random keys, (runs,).
        labels: of the runs, for people.
    """

    case: Case
    values: dict[str, np.ndarray]
    seeds: np.ndarray
    labels: tuple[str, ...]


def set_table(
    spec: SetSpec, gains: GainsFile = NO_GAINS, scenario: ScenarioFile = NO_SCENARIO
) -> SetTable:
    """A set as plain data: its parts, and the case of every contour and horizon.

    Args:
        spec: what is asked for.
        gains, scenario: as for `prepare`.

    Raises:
        ValueError: in one line, for anything unknown or out of range.
    """

    def timed(contour: ContourSpec, horizon: float | None) -> Case:
        def retimed(timing: Timing) -> Timing:
            timing = timing if horizon is None else replace(timing, duration=horizon)
            return timing if spec.skip is None else replace(timing, skip=spec.skip)

        return prepare(contour.loop, contour.words, gains, scenario, retimed).case

    cases = [timed(c, horizon) for c in spec.contours for horizon in spec.horizons or (None,)]
    for case in cases[1:]:
        same_law(cases[0], case)
    counts = ("plants", "nominal", "noise_seeds", "seed", "design", "dealt")
    parts = ("loads", "starts", "spreads", "correlations")
    return (
        {name: getattr(spec, name) for name in counts}
        | {name[:-1]: [dict(one) for one in getattr(spec, name)] for name in parts}
        | {"case": [case_table(case) for case in cases]}
    )


def same_law(first: Case, other: Case) -> None:
    """Refuse two cases that no gains fit both.

    Raises:
        ValueError: their laws or gains differ.
    """
    structures = {jax.tree.structure(case.gains) for case in (first, other)}
    if first.loop.controller != other.loop.controller or len(structures) > 1:
        raise ValueError(
            f"{first.name} and {other.name} have different laws "
            f"({first.loop.controller.name}, {other.loop.controller.name}): no gains fit both"
        )


def run_sets(table: SetTable, blocks: Mapping[str, str]) -> list[RunSet]:
    """The runs of a `set_table`, one set a case.

    Args:
        table: of `set_table`.
        blocks: part of the scenario -> name of the block that was added.

    Raises:
        ValueError: impossible spreads, loads or starts.
    """
    parts = len(table["case"]) if table["dealt"] else 1
    return [
        _run_set(case_of(case, blocks), table, slice(i % parts, None, parts))
        for i, case in enumerate(table["case"])
    ]


def _run_set(case: Case, table: SetTable, assigned: slice) -> RunSet:
    """assigned: the plants of this case among all."""
    parts: list[dict[str, np.ndarray]] = []
    labels: list[str] = []
    for load in table["load"] or ({},):
        for start in table["start"] or ({},):
            changed, paths = _changed(case, load, start)
            values, names = _plants(changed, table)
            values = {path: value[assigned] for path, value in values.items()}
            names = names[assigned]
            known = known_leaves((), changed.scenario)
            for path in paths:
                fixed = np.asarray(known[path][1], float)
                values.setdefault(path, np.broadcast_to(fixed, (len(names), *fixed.shape)))
            parts.append(values)
            settings = [f"{name} = {value}" for name, value in {**load, **start}.items()]
            labels += [", ".join((case.name, name, *settings)) for name in names]
    repeats = table["noise_seeds"]
    stacked = {
        path: np.repeat(np.concatenate([part[path] for part in parts]), repeats, axis=0)
        for path in parts[0]
    }
    noises = [f", noise {i}" if repeats > 1 else "" for i in range(repeats)]
    named = tuple(name + noise for name in labels for noise in noises)
    seeds = np.array([run_seed(table["seed"], i) for i in range(len(named))], np.uint32)
    delayed = with_max_delay(case, longest_delay(space(case, table["spread"], ())))
    return RunSet(delayed, stacked, seeds, named)


def _changed(
    case: Case, load: Mapping[str, Any], start: Mapping[str, Any]
) -> tuple[Case, tuple[str, ...]]:
    """The case with another load and start, and the paths that differ."""
    values = {f"load.{k}": v for k, v in load.items()} | {f"start.{k}": v for k, v in start.items()}
    _, scenario, _, paths = apply((), case.scenario, values)
    return case._replace(scenario=scenario), paths


def _plants(case: Case, table: SetTable) -> tuple[dict[str, np.ndarray], list[str]]:
    """Values of the plants, path -> (n, *shape), and their names."""
    uncertain_space = space(case, table["spread"], table["correlation"])
    count, most = table["plants"] + table["nominal"], TRIES * max(table["plants"], 1)
    rows: list[Mapping[str, np.ndarray]] = []
    names: list[str] = []
    if table["nominal"]:
        rows.append({item.path: item.nominal for item in uncertain_space.uncertain})
        names.append("nominal plant")
    drawn = draw(uncertain_space, table["design"], table["seed"], most, 0, most)
    for number in range(most):
        row = {path: value[number] for path, value in drawn.items()}
        if len(rows) < count and _possible(case, row):
            rows.append(row)
            names.append(f"plant {number}")
    if len(rows) < count:
        raise ValueError(
            f"{case.name}: of {most} plants drawn, only {len(rows) - table['nominal']} can exist; "
            "bound the spreads with low and high"
        )
    paths = [item.path for item in uncertain_space.uncertain]
    return {path: np.stack([row[path] for row in rows]) for path in paths}, names


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


def count_runs(table: SetTable) -> int:
    """Runs of a whole set."""
    variants = max(1, len(table["load"])) * max(1, len(table["start"]))
    plants = table["plants"] + table["nominal"]
    meetings = 1 if table["dealt"] else len(table["case"])
    return meetings * plants * variants * table["noise_seeds"]


def widened(spreads: Iterable[Mapping[str, Any]], share: float) -> Sequence[dict[str, Any]]:
    """Uniform factors 1 -+ share in place of narrower ones; any other spread as it is."""
    wide = []
    for spread in spreads:
        low, high = (spread.get(key) for key in ("low", "high"))
        factors = spread.get("distribution") == "uniform" and spread.get("relative", True)
        if factors and low is not None and high is not None:
            spread = {**spread, "low": min(low, 1 - share), "high": max(high, 1 + share)}
        wide.append(dict(spread))
    return wide
