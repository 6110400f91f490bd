"""Validation on the exact model: held-out plants, half the step, a longer run, and the verdict.

No search sees any of this. Metrics are those of `jaxstage run`, over the scored part.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.metrics import selected
from jaxstage.simulate.batch import rollouts
from jaxstage.studies import Case, Timing, with_metric
from jaxstage.studies.case import scored
from tuning.tuner.problem.scenario_set import RunSet, SetTable, run_sets
from tuning.tuner.problem.training_metrics import available_columns
from tuning.uncertainty.metric_table import flag_columns, metric_columns
from tuning.uncertainty.statistics import Interval, Share, bootstrap, share
from tuning.uncertainty.uncertain_space import batch

#: metrics that are shown of runs that only validate
KEPT = ("tracking", "following", "contour", "effort", "energy")
#: bytes that the metrics of one batch may take
MEMORY = 2e9
#: a metric that differs by more between the step and half of it depends on the integration
STEP_LIMIT = 0.1
#: a metric that grows by more over a longer run is not at rest
GROWTH_LIMIT = 2.0
#: a longer run is so many times as long
LONGER = 4


class PairedRuns(NamedTuple):
    """A metric of the same runs under two gains (common random numbers).

    Attributes:
        metric: its column.
        before, after: under the gains before and after, NaN where a run was lost, (runs,).
        columns: every metric, name -> (2, runs).
        labels: of the runs, for people.
    """

    metric: str
    before: np.ndarray
    after: np.ndarray
    columns: dict[str, np.ndarray]
    labels: tuple[str, ...] = ()

    def lost(self) -> tuple[int, int]:
        """Runs lost before and after."""
        return int(np.isnan(self.before).sum()), int(np.isnan(self.after).sum())


def simulate_metrics(every: Sequence[RunSet], gains: Sequence[Any]) -> dict[str, np.ndarray]:
    """Simulate runs under each of some gains.

    Args:
        every: run sets; a column that not all of them have is left out.
        gains: as the law takes them.

    Returns:
        Metrics and flags, column -> (gains, runs).
    """
    tables = [_simulated(one, gains) for one in every]
    names = [name for name in tables[0] if all(name in table for table in tables)]
    return {name: np.concatenate([table[name] for table in tables], axis=1) for name in names}


def with_light_metric(case: Case, metric: str) -> Case:
    """The case with the metrics of `KEPT` and one more column, over its scored part."""
    known = available_columns(case)
    kept = {*KEPT, known.get(metric)} - {""}
    names = dict.fromkeys(name for name in known.values() if name in kept)
    return with_metric(case, scored(selected(case.metric, tuple(names)), case.window))


def _simulated(one: RunSet, gains: Sequence[Any]) -> dict[str, np.ndarray]:
    case, runs, count = one.case, len(one.labels), len(gains)
    values = {path: np.concatenate([value] * count) for path, value in one.values.items()}
    drawn = batch(case, values, np.concatenate([one.seeds] * count))
    stacked = jax.tree.map(
        lambda *leaves: jnp.repeat(jnp.stack([jnp.asarray(x) for x in leaves]), runs, axis=0),
        *gains,
    )
    arguments = (case.loop, stacked, drawn.scenario, drawn.path, case.window.ticks)
    run = rollouts(*arguments, in_axes=(0, *drawn.in_axes[1:]), memory=MEMORY)
    columns = metric_columns(run.report, case.loop.plant) | flag_columns(run, case.loop.dt)
    return {name: column.reshape(count, runs) for name, column in columns.items()}


def column_of(columns: Mapping[str, np.ndarray], metric: str, axes: Sequence[str]) -> np.ndarray:
    """A metric by its column; one that is given per axis, by its bare name, as RMS over the axes.

    Args:
        columns: column -> values.
        metric: the column, such as ``following_rms_um``.
        axes: names of the axes.

    Raises:
        ValueError: there is no such column.
    """
    if metric in columns:
        return columns[metric]
    per_axis = [columns[name] for axis in axes if (name := _per_axis(columns, metric, axis))]
    if not per_axis:
        raise ValueError(f"the runs have no metric {metric}")
    return np.sqrt(np.mean(np.square(per_axis), axis=0))


def _per_axis(columns: Mapping[str, Any], metric: str, axis: str) -> str:
    """The column of one axis of a metric: ``following_rms_um`` -> ``following_rms_x_um``."""
    return next((n for n in columns if n.replace(f"_{axis}", "", 1) == metric and n != metric), "")


def has_column(columns: Mapping[str, Any], metric: str, axes: Sequence[str]) -> bool:
    """Whether `column_of` finds a metric."""
    return metric in columns or any(_per_axis(columns, metric, axis) for axis in axes)


def simulate_pairs(every: Sequence[RunSet], before: Any, after: Any, metric: str) -> PairedRuns:
    """Simulate the same runs under two gains.

    Args:
        every: run sets.
        before, after: gains.
        metric: that they are compared by.
    """
    every = [one._replace(case=with_light_metric(one.case, metric)) for one in every]
    columns = simulate_metrics(every, [before, after])
    values = column_of(columns, metric, every[0].case.loop.plant.axes)
    labels = tuple(label for one in every for label in one.labels)
    return PairedRuns(metric, values[0], values[1], columns, labels)


def half_step(table: SetTable, blocks: Mapping[str, str]) -> list[RunSet]:
    """The runs of a set with half the integration step, controllers as often as before."""
    return _retimed(table, blocks, lambda timing: {"substeps": 2 * timing.substeps})


def prolonged(table: SetTable, blocks: Mapping[str, str]) -> list[RunSet]:
    """The runs of a set, `LONGER` times as long."""

    def longer(timing: Timing) -> dict[str, Any]:
        if timing.duration is not None:
            return {"duration": LONGER * timing.duration}
        return {"laps": LONGER * timing.laps}

    return _retimed(table, blocks, longer)


def _retimed(
    table: SetTable, blocks: Mapping[str, str], change: Callable[[Timing], dict[str, Any]]
) -> list[RunSet]:
    cases = [
        {**case, "timing": case["timing"] | change(Timing(**case["timing"]))}
        for case in table["case"]
    ]
    return run_sets({**table, "case": cases}, blocks)


class HeldOut(NamedTuple):
    """What the held-out runs say of a metric.

    Attributes:
        metric: its column.
        runs: how many.
        before, after: means of the runs that neither gains lost, with bootstrap intervals; where
            those before leave too few to compare, ``after`` is of the runs that those after hold.
        change: relative change of the mean, with its interval; None where too few are left.
        lost_before, lost: runs lost under either gains.
        better: on how many runs the gains after are better; a lost run loses.
        others: every metric -> its means before and after.
        worst: ", most in RUN": the run that the gains after do worst on, or empty.
    """

    metric: str
    runs: int
    before: Interval | None
    after: Interval | None
    change: Interval | None
    lost_before: int
    lost: int
    better: Share
    others: dict[str, tuple[float | None, float | None]]
    worst: str = ""


def held_out_verdict(pairs: PairedRuns) -> HeldOut:
    """Verdict on held-out runs: paired bootstrap of the mean, and a count of the better ones."""
    both = np.isfinite(pairs.before) & np.isfinite(pairs.after)
    before, after = pairs.before[both], pairs.after[both]
    lost_before, lost = pairs.lost()
    ranked = [np.where(np.isnan(x), np.inf, x) for x in (pairs.before, pairs.after)]
    enough = len(before) > 1
    alone = pairs.after[np.isfinite(pairs.after)]
    shown = after if enough else alone
    return HeldOut(
        metric=pairs.metric,
        runs=len(pairs.before),
        before=bootstrap(before, np.mean) if enough else None,
        after=bootstrap(shown, np.mean) if len(shown) > 1 else None,
        change=_change(before, after) if enough else None,
        lost_before=lost_before,
        lost=lost,
        better=share(int(np.sum(ranked[1] < ranked[0])), len(pairs.before)),
        others=_others(pairs.columns, both if enough else None),
        worst=f", most in {pairs.labels[int(np.argmax(ranked[1]))]}" if pairs.labels else "",
    )


def _change(before: np.ndarray, after: np.ndarray) -> Interval:
    """mean(after) / mean(before) - 1 with its interval, plants drawn again in pairs."""
    places = np.arange(len(before), dtype=float)

    def statistic(drawn: np.ndarray, axis: int = -1) -> np.ndarray:
        index = drawn.astype(int)
        return np.mean(after[index], axis=axis) / np.mean(before[index], axis=axis) - 1

    return bootstrap(places, statistic)


def _others(
    columns: Mapping[str, np.ndarray], both: np.ndarray | None
) -> dict[str, tuple[float | None, float | None]]:
    """Means of every metric before and after, of the runs that neither lost; ``both`` None: each of
    those that it holds itself."""
    pairs: dict[str, tuple[float | None, float | None]] = {}
    for name, column in columns.items():
        if name.endswith("_at") or name in ("finite", "lost_at_s"):
            continue
        rows = column.astype(float) if both is None else column[:, both].astype(float)
        kept = [row[np.isfinite(row)] if both is None else row for row in rows]
        first, second = (_mean(row) for row in kept)
        pairs[name] = (first, second)
    return pairs


def _mean(values: np.ndarray) -> float | None:
    mean = float(values.mean()) if len(values) else math.nan
    return mean if math.isfinite(mean) else None


class ValidationRuns(NamedTuple):
    """The training runs, as they were or in another form.

    Attributes:
        metric: its means before and after.
        objective: J before and after.
        lost: runs that the gains after lose.
        run: the run that decides: the first that is lost, else that with the largest metric.
    """

    metric: tuple[float, float]
    objective: tuple[float, float]
    lost: int
    run: str = ""


class Validation(NamedTuple):
    """Both gains on the exact model.

    Attributes:
        exact: on the training runs.
        half_step: the same with half the integration step.
        longer: on other plants, `LONGER` times as long.
        missed: one line for each goal that the gains after do not meet in the training runs.
    """

    exact: ValidationRuns
    half_step: ValidationRuns
    longer: ValidationRuns
    missed: tuple[str, ...]


class Refusal(NamedTuple):
    """A test that gains do not pass.

    Attributes:
        reason: the test, its numbers and the run that decides, in one line.
        advice: the option that may help.
    """

    reason: str
    advice: str


#: metrics of effort, and the growth that a verdict warns of
EFFORT = ("command_rms", "command_max", "command_variation", "chattering", "energy_J")
TENFOLD = 10.0


def warnings(verdict: HeldOut, axes: Sequence[str]) -> tuple[str, ...]:
    """What accepted gains pay for their accuracy: metrics of effort that grow tenfold.

    Args:
        verdict: of the held-out runs.
        axes: names of the axes; of a metric that is given per axis the worst one is told.

    Returns:
        One line each, with the term of an objective that prices it.
    """
    worst: dict[str, tuple[float, str]] = {}
    for name, (before, after) in verdict.others.items():
        if not name.startswith(EFFORT) or not before or after is None or before < 0:
            continue
        growth = after / before
        bare = next((n for a in axes if (n := name.replace(f"_{a}_", "_", 1)) != name), name)
        if growth > max(TENFOLD, worst.get(bare, (0.0, ""))[0]):
            change = f"{name} grows from {before:.4g} to {after:.4g}, {growth:.3g} times"
            worst[bare] = growth, f"{change}: --objective '... + 0.1*{bare}' prices it"
    return tuple(text for _, text in worst.values())


#: what to try where the search found too little
SEARCH_MORE = "a larger --budget, more --starts, or wider ranges by --gains NAME=LOW..HIGH"
#: what to try where gains are too near the edge of stability
MORE_MARGIN = "a larger --margin, or --worst-case 2"


def refusals(validation: Validation, held_out: HeldOut) -> tuple[Refusal, ...]:
    """Why the gains are not accepted; none: they are."""
    return (*validation_refusals(validation), *_held_out_refusals(held_out))


def validation_refusals(validation: Validation) -> tuple[Refusal, ...]:
    """What the training runs in their three forms say against the gains."""
    exact, half, longer, missed = validation
    far = f"{LONGER} times the time and other plants"
    refused = [Refusal(one, "a larger --budget, or a wider --goal") for one in missed]
    if exact.lost:
        refused.append(Refusal(f"{exact.lost} training runs are lost{_first(exact)}", SEARCH_MORE))
    elif not exact.objective[1] < exact.objective[0]:
        reason = f"the objective on the exact model {_did_not_fall(exact)}"
        refused.append(Refusal(reason, SEARCH_MORE))
    for name, one in (("half the step", half), (far, longer)):
        if one.lost:
            advice = "--set substeps=N with a larger N" if one is half else MORE_MARGIN
            refused.append(Refusal(f"with {name} {one.lost} runs are lost{_first(one)}", advice))
        elif not one.objective[1] < one.objective[0]:
            advice = MORE_MARGIN if one is longer else SEARCH_MORE
            refused.append(Refusal(f"with {name} the objective {_did_not_fall(one)}", advice))
    metric = exact.metric[1]
    if abs(half.metric[1] - metric) > STEP_LIMIT * abs(metric):
        reason = (
            f"with half the step the metric is {half.metric[1]:.4g} instead of {metric:.4g}: it "
            f"depends on the integration (limit {STEP_LIMIT:.0%})"
        )
        refused.append(Refusal(reason, "--set substeps=N with a larger N"))
    if longer.metric[1] > GROWTH_LIMIT * abs(metric):
        reason = (
            f"with {far} the metric grows from {metric:.4g} to {longer.metric[1]:.4g} (limit "
            f"{GROWTH_LIMIT:g} times){_largest(longer)}"
        )
        advice = '--goal "growth < 1.1", or longer runs by horizons in the file of --train'
        refused.append(Refusal(reason, advice))
    return tuple(refused)


def _first(runs: ValidationRuns) -> str:
    return f", the first {runs.run}" if runs.run else ""


def _largest(runs: ValidationRuns) -> str:
    return f", most in {runs.run}" if runs.run else ""


def _did_not_fall(runs: ValidationRuns) -> str:
    before, after = runs.objective
    return f"did not fall: {before:.4g} before, {after:.4g} after{_largest(runs)}"


def _held_out_refusals(verdict: HeldOut) -> tuple[Refusal, ...]:
    if verdict.lost > verdict.lost_before:
        reason = (
            f"{verdict.lost} of {verdict.runs} held-out runs are lost, {verdict.lost_before} before"
        )
        return (Refusal(reason + verdict.worst, MORE_MARGIN),)
    change = verdict.change
    if change is None and verdict.after is not None and verdict.lost < verdict.lost_before:
        return ()  # what was lost is held: there is nothing before to be better than
    if change is None:
        reason = "too few held-out runs are left to compare"
        return (Refusal(reason, "narrower spreads by --scenario, or other gains to start from"),)
    if change.high >= 0:
        reason = (
            f"{verdict.metric} on held-out plants: change {change.value:+.1%} "
            f"({change.low:+.1%}..{change.high:+.1%}) is not shown to be a gain{verdict.worst}"
        )
        advice = f"{SEARCH_MORE}, or more plants in the file of --train"
        return (Refusal(reason, advice),)
    return ()
