"""A single run: from the words and files of a user to its result."""

import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxstage.controllers.fuzzy_rules import readable
from jaxstage.metrics import record, together
from jaxstage.model import settings
from jaxstage.model.fields import in_units_of, replace
from jaxstage.model.signals import Run
from jaxstage.model.validate import SHARED, check, check_leaves
from jaxstage.simulate.rollout import advance, start
from jaxstage.studies import Case, Timing, find, with_metric
from jaxstage.studies.case import retimed as retime
from jaxstage.studies.precision import LARGEST, single_precision_error
from jaxstage.studies.study import NamedLoop
from jaxstage.system.files import write_text
from jaxstage.system.memory import memory_bytes
from tuning.store.gains_file import NO_GAINS, GainsFile
from tuning.store.run_result import summary, write_settings
from tuning.uncertainty.scenario_blocks import with_max_delay
from tuning.uncertainty.scenario_file import NO_SCENARIO, ScenarioFile

#: settings that belong to the timing, with their units; those without one are whole numbers
TIMING = dict.fromkeys(("lap_time", "dt", "skip"), "s") | {"feed": "mm/min"}
TIMING |= dict.fromkeys(("laps", "scored", "substeps"), "")


#: settings that name the part of a run that is scored
SCORING = ("skip", "scored")


class Prepared(NamedTuple):
    """A case with all settings applied, the loop it comes from, and what the user should know.

    refused: why the gains of a file were not accepted by their tuning."""

    case: Case
    entry: NamedLoop
    notes: tuple[str, ...]
    refused: tuple[str, ...] = ()


def prepare(
    loop: str,
    words: Sequence[str],
    gains: GainsFile = NO_GAINS,
    scenario: ScenarioFile = NO_SCENARIO,
    retimed: Callable[[Timing], Timing] = lambda timing: timing,
) -> Prepared:
    """Build a loop, apply files first, then ``NAME=VALUE`` words, and validate what comes out.

    Args:
        loop: A name of `jaxstage list`.
        words: As for ``--set``.
        gains: Of ``--gains``.
        scenario: Of ``--scenario``; its spreads do not matter here.
        retimed: Changes the timing that the words ask for.

    Raises:
        ValueError: In one line, with its place, for anything unknown, ambiguous or out of range.
    """
    entry = find(loop)
    settled = dict(_word(word) for word in words)
    timing = _timing(entry.timing, {k: v for k, v in settled.items() if k in TIMING})
    built = _built(entry, timing, retimed(timing), not settled.keys().isdisjoint(SCORING))
    case = published = scenario.with_blocks(built)
    gains.refuse_other_law(case)
    if scenario.seed is not None:
        key = jax.random.key(scenario.seed)
        case = case._replace(scenario=replace(case.scenario, key=key))
    case, places = _from_file(case, gains, ("gains",))
    case, more = _from_file(case, scenario, settings.SCENARIO_PARTS)
    values = {k: _numbers(k, v, _unit(case, k)) for k, v in settled.items() if k not in TIMING}
    case, by_words = _applied(case, values, tuple(TIMING))
    places |= more | dict.fromkeys(by_words, "")
    case = with_max_delay(case, _delay(case))
    _check(case, places)
    _check_motion(case, by_words)
    notes = gains.notes() + _notes(published, case, tuple(places))
    return Prepared(case, entry, notes, gains.refused)


def refuse_rough(
    loop: str,
    words: Sequence[str],
    gains: GainsFile = NO_GAINS,
    scenario: ScenarioFile = NO_SCENARIO,
    retimed: Callable[[Timing], Timing] = lambda timing: timing,
) -> None:
    """Raise ValueError where metrics are off by over 1 % in single precision, at the timing asked
    for. Arguments are those of `prepare`."""
    with jax.enable_x64(True):
        prepared = prepare(loop, words, gains, scenario, retimed)
        metric, difference = single_precision_error(prepared.case, prepared.entry)
    if difference > LARGEST:
        raise ValueError(
            f"--precision single: {metric} of {loop} is off by {difference:.1%} "
            f"(limit {LARGEST:.0%}, `jaxstage precision` measures it); --force runs it"
        )


def execute(prepared: Prepared, out: Path | None = None) -> dict[str, Any]:
    """Simulate; with ``out``, write pictures and settings there. Returns the JSON object."""
    case = prepared.case
    metrics = (case.loop.metric, replace(case.metric, name="whole"), *((record,) if out else ()))
    stored = (recorded.metric for recorded in prepared.entry.recorded)
    measured = with_metric(case, together(*metrics, *stored))
    _refuse_long(measured)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)  # before the work: where it cannot be made
    run = _with_recorded(prepared, measured.simulate())
    result = summary(case, run, prepared.notes)
    result["notes"] += prepared.entry.notes(case, result["metrics"])
    if prepared.refused:
        result["verdict"] = f"REFUSED gains. {result['verdict']}"
    if out is not None:
        from jaxstage.plot import pictures

        pictures(case, run.report["scored"], run.rows["record"], result, out)
        write_settings(out, case, result, prepared.refused)
        rules = readable(case.gains, run.final.memory)
        if rules is not None:
            write_text(out / "rules.txt", rules)
    return result


def _refuse_long(case: Case) -> None:
    """Refuse a run whose record does not fit into this machine."""
    begin = jax.eval_shape(lambda: start(case.loop, case.gains, case.scenario, case.path))
    step = lambda c: advance(case.loop, case.gains, case.scenario, case.path, c)  # noqa: E731
    row = jax.tree.leaves(jax.eval_shape(step, begin)[1])
    size = case.window.ticks * sum(leaf.size * leaf.dtype.itemsize for leaf in row)
    if size > memory_bytes() / 2:  # pictures hold it a second time
        raise ValueError(
            f"a record of {case.window.ticks} control periods takes {size / 1e9:.3g} GB, half "
            f"the memory here is {memory_bytes() / 2e9:.3g} GB: simulate less, or without --out"
        )


def _with_recorded(prepared: Prepared, run: Run) -> Run:
    """The run with the metrics of its record among those of the scored part and of the whole."""
    if not prepared.entry.recorded:
        return run
    window, dt, report = prepared.case.window, prepared.case.loop.dt, dict(run.report)
    for part, ticks in (("scored", slice(window.start, window.stop)), ("whole", slice(None))):
        metrics = {
            recorded.metric.name: recorded.evaluate(
                jax.tree.map(lambda row, t=ticks: row[t], run.rows[recorded.metric.name]), dt
            )
            for recorded in prepared.entry.recorded
        }
        report[part] = report[part] | metrics
    return replace(run, report=report)


def check_folder(out: Path) -> None:
    """Refuse an output folder that cannot be written, before any work is done."""
    existing = out
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise ValueError(f"--out {out}: {existing} is not a folder")
    if not os.access(existing, os.W_OK):
        raise ValueError(f"--out {out}: no permission to write in {existing}")


def _word(word: str) -> tuple[str, str]:
    name, equals, value = word.partition("=")
    if not equals or not name.strip() or not value.strip():
        raise ValueError(f"--set {word}: must be NAME=VALUE, e.g. gains.c1=2")
    return name.strip(), value.strip()


def _numbers(name: str, text: str, unit: str) -> list[float]:
    try:
        return [float(item) for item in text.split(",")]
    except ValueError:
        told = f"; units are not written, this one is {unit}" if unit not in ("", "1") else ""
        raise ValueError(
            f"--set {name}={text}: must be a number, or one number per axis split by commas{told}"
        ) from None


def _unit(case: Case, name: str) -> str:
    """The unit of a setting. Raises ValueError for an unknown one."""
    known = settings.known_leaves(case.gains, case.scenario, case.path)
    quantity = known[settings.resolve(name, known, tuple(TIMING))][0]
    return in_units_of(quantity, case.loop.plant.command_unit).unit


def _timing(own: Timing, words: Mapping[str, str]) -> Timing:
    """The loop's own timing with the changes of words."""
    values: dict[str, Any] = {}
    for one, other in (("lap_time", "feed"), ("scored", "skip")):
        if one in words and other in words:
            raise ValueError(f"--set {one} and --set {other}: give one of them")
    for name, text in words.items():
        number, *more = _numbers(name, text, TIMING[name])
        if more:
            raise ValueError(f"--set {name}={text}: must be one number")
        if not TIMING[name]:
            if not math.isfinite(number) or number != int(number):
                raise ValueError(f"--set {name}={text}: must be a whole number")
            number = int(number)
        values[name] = number
    return retime(own, **values)


def _built(entry: NamedLoop, timing: Timing, changed: Timing, named: bool) -> Case:
    """The case. named: what is scored was asked for by name. changed: ``timing``, or what the
    caller of `prepare` makes of it, which names what is scored."""
    own = entry.timing
    if named or changed != timing:
        return entry.build(changed)
    if timing.feed is not None and own.skip is not None:
        lap = entry.build(replace(timing, skip=None)).window.lap
        timing = replace(timing, skip=own.skip * lap * timing.dt / own.lap_time)
    case = entry.build(timing)
    case.window.refuse_part_of_a_lap(own)
    return case


def _from_file(
    case: Case, file: GainsFile | ScenarioFile, roots: tuple[str, ...]
) -> tuple[Case, dict[str, str]]:
    """The case with the values of a file, and full path of a setting -> its place in the file.
    roots: the tables that the values may stand in."""
    places: dict[str, str] = {}
    for name, value in file.values.items():
        assert file.toml is not None
        place = f"{file.toml.place(name)}: "
        try:
            if name.partition(".")[0] not in roots:
                raise ValueError(f"'{name}' is not in [{'], ['.join(roots)}]")
            case, paths = _applied(case, {name: value})
        except ValueError as error:
            raise ValueError(f"{place}{error}") from None
        for path in paths:
            if path in places:
                raise ValueError(f"{place}{path} is set twice, by another name before")
            places[path] = place
    return case, places


def _delay(case: Case) -> float:
    """Dead time of the drive in control periods, 0 where it has none."""
    return float(np.max(getattr(case.scenario.drive, "delay", 0.0)))


def _check(case: Case, places: Mapping[str, str]) -> None:
    """Validate a case. An error begins with the place of the setting that it names, else of the
    sibling that the setting may not fall below. places: full path of a setting -> where it was set.
    """
    try:
        check(case.loop, case.gains, case.scenario, case.path)
    except ValueError as error:
        path = re.split(r"[^\w.]", str(error))[0]
        sibling = f"{path.rpartition('.')[0]}.{str(error).rpartition(' ')[2]}"
        raise ValueError(f"{places.get(path, places.get(sibling, ''))}{error}") from None


def _applied(
    case: Case, values: Mapping[str, Any], other_names: tuple[str, ...] = ()
) -> tuple[Case, tuple[str, ...]]:
    gains, scenario, path, changed = settings.apply(
        case.gains, case.scenario, values, other_names, case.path
    )
    return case._replace(gains=gains, scenario=scenario, path=path), changed


def _check_motion(case: Case, changed: tuple[str, ...]) -> None:
    """Refuse sizes of the motion that are out of range, or that a feed does not know of."""
    sizes = [path for path in changed if path.startswith(f"{settings.MOTION}.")]
    if sizes:
        shared = jax.tree.map(lambda _: SHARED, case.path)
        check_leaves(case.loop.plant, case.path, settings.MOTION, shared)
        if case.timing.feed is not None:
            raise ValueError(
                f"--set feed and --set {sizes[0]}: the feed gives the lap time for the size of the "
                "study; give lap_time"
            )


def _notes(published: Case, case: Case, paths: tuple[str, ...]) -> tuple[str, ...]:
    """Say which assumptions of the controller a changed plant value did not move."""
    before, known = (
        settings.known_leaves(one.gains, one.scenario, one.path) for one in (published, case)
    )
    changed = [p for p in dict.fromkeys(paths) if not np.array_equal(before[p][1], known[p][1])]
    notes = []
    for path in changed:
        root, _, field = path.partition(".")
        assumed = next((p for p in known if p.endswith(f"nominal.{field}")), None)
        if root != "plant" or assumed in paths:
            continue
        if assumed:
            value = ", ".join(f"{v:g}" for v in known[assumed][1])
            notes.append(
                f"{path} changed; the controller still assumes nominal.{field} = {value} "
                f"(set nominal.{field}=... to change that)"
            )
        else:
            notes.append(f"{path} changed; what the controller assumes has not changed")
    return tuple(notes)
