"""Analysis of a sweep: yield, statistics of a metric, paired comparisons, sensitivities."""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pyarrow as pa

from jaxstage.model.settings import nearest_name
from tuning.store.gains_file import refused_text
from tuning.sweeps import store
from tuning.sweeps.configuration import SweepPlan
from tuning.sweeps.sensitivity import (
    Indices,
    Tornado,
    at_the_ends,
    names_of,
    rank_correlation,
    sobol_indices,
    tornado,
)
from tuning.uncertainty.designs import DESIGNS
from tuning.uncertainty.metric_table import metric_names
from tuning.uncertainty.specification import Specification, parse
from tuning.uncertainty.statistics import (
    MetricStatistics,
    PairedComparison,
    Share,
    YieldClaim,
    claim,
    metric_statistics,
    paired,
    share,
)

#: the metric that a sweep is judged by if none is named: the first that its loops have
USUAL_METRICS = ("contour_max_um", "tracking_max_um", "following_max_x_um")
#: rows of the list of worst runs
WORST = 10


class Question(NamedTuple):
    """What a user asks of a sweep.

    Attributes:
        spec: Text of a specification (`specification`), or None.
        metric: Column to judge, or None for the usual one.
        target: Yield that is claimed, in (0, 1), or None.
        tornado: Whether slopes are computed, one gradient a loop.
    """

    spec: str | None = None
    metric: str | None = None
    target: float | None = None
    tornado: bool = False


class Criteria(NamedTuple):
    """A question that a plan can answer. metric: the column to judge."""

    spec: Specification | None
    metric: str
    target: float | None
    tornado: bool


class LoopResult(NamedTuple):
    """Answers about one loop.

    Attributes:
        columns: What the answers rest on: column -> (runs,), display units.
        passed: Which runs meet the specification, (runs,) bool; None without one.
        sampled: Rows that are a sample of the spreads, (runs,) bool: shares and statistics rest on
            them.
        lost: Number of runs that were lost.
        met: Yield, the share of the sampled rows that passed.
        correlations: Column of a parameter -> Spearman's rho with the metric.
        ends: Column of a parameter -> median metric where it is lowest and where it is highest.
        notes: What is not said of the effects, and why.
    """

    name: str
    columns: dict[str, np.ndarray]
    passed: np.ndarray | None
    sampled: np.ndarray
    lost: int
    met: Share | None
    claim: YieldClaim | None
    statistics: MetricStatistics | None
    correlations: dict[str, float | None]
    indices: Indices | None
    tornado: Tornado | None
    ends: dict[str, tuple[float, float] | None]
    notes: tuple[str, ...]


class Analysis(NamedTuple):
    """Answers about a sweep."""

    plan: SweepPlan
    metric: str
    spec: Specification | None
    loops: tuple[LoopResult, ...]
    comparisons: tuple[PairedComparison, ...]
    notes: tuple[str, ...]


def usable_columns(plan: SweepPlan) -> dict[str, type]:
    """Columns that a specification may use, those of every loop: name -> float or bool.

    Known before anything has run. The time at which a run was lost is not among them: complete
    runs have no such number, and none of them would pass.
    """
    types: list[dict[str, type]] = []
    for case, space in zip(plan.cases, plan.spaces, strict=True):
        parameters = (column for item in space.uncertain for column in item.columns)
        numbers = dict.fromkeys(("run", *parameters, *metric_names(case)), float)
        types.append(numbers | {"finite": bool})
    return {name: kind for name, kind in types[0].items() if all(name in t for t in types)}


def choose_metric(plan: SweepPlan, spec: Specification | None, name: str | None) -> str:
    """The metric to judge: the named one, else the first that the specification limits, else a
    usual one. Raises ValueError for an unknown name."""
    columns = usable_columns(plan)
    known = [n for n in metric_names(plan.cases[0]) if n in columns]
    if name is not None:
        if name not in known:
            raise ValueError(f"--metric {name}: no such metric{nearest_name(name, known)}")
        return name
    limited = [n for n in (spec.limits if spec else ()) if n in known]
    usual = [n for n in USUAL_METRICS if n in known]
    for candidate in (*limited, *usual, *(n for n in known if n.endswith("_um"))):
        return candidate
    raise ValueError("--metric: name the metric to judge")


def criteria(plan: SweepPlan, question: Question) -> Criteria:
    """The question against the columns of a plan. Raises ValueError in one line."""
    spec = parse(question.spec, usable_columns(plan)) if question.spec is not None else None
    if question.target is not None:
        if spec is None:
            raise ValueError(f"--target {question.target:g} needs a --spec")
        claim(share(0, 1), question.target)
    metric = choose_metric(plan, spec, question.metric)
    return Criteria(spec, metric, question.target, question.tornado)


def analyse(folder: Path, plan: SweepPlan, question: Question) -> Analysis:
    """Answer a question about a finished sweep. Raises ValueError in one line."""
    judged = criteria(plan, question)
    spec, metric = judged.spec, judged.metric
    todo = store.missing(folder, plan)
    if todo:
        raise ValueError(f"{folder}: {len(todo)} chunks are missing, sweep with --resume goes on")
    parameters = [c for item in plan.spaces[0].uncertain for c in item.columns]
    names = dict.fromkeys([metric, *parameters, *(spec.names if spec else ()), "finite"])
    table = store.read(folder, plan, list(names))
    runs = plan.table["runs"]
    loops = []
    for loop in range(len(plan.cases)):
        rows = table.slice(loop * runs, runs)
        columns = {name: rows[name].to_numpy() for name in names}
        loops.append(_loop_result(plan, loop, columns, judged))
    pairs = [(a, b) for i, a in enumerate(loops) for b in loops[i + 1 :]]
    comparisons = [_compare(a, b, metric, parameters) for a, b in pairs]
    possible = tuple(c for c in comparisons if c is not None)
    notes = _notes(plan, len(possible) < len(pairs))
    notes += tuple(note for loop in loops for note in loop.notes)
    return Analysis(plan, metric, spec, tuple(loops), possible, notes)


def _loop_result(
    plan: SweepPlan, loop: int, columns: dict[str, np.ndarray], judged: Criteria
) -> LoopResult:
    space, design = plan.spaces[loop], DESIGNS[plan.table["design"]]
    values = columns[judged.metric]
    numbers = [column for item in space.uncertain for column in item.numbers()]
    passed = judged.spec.passes(columns) if judged.spec else None
    sampled = np.zeros(len(values), bool)
    if design.sample is not None:
        sampled[:: design.sample(space.dimensions())] = True
    met = None
    if passed is not None and sampled.any():
        met = share(int(passed[sampled].sum()), int(sampled.sum()))
    indices, slopes, notes = _effects(plan, loop, values, judged)
    return LoopResult(
        name=plan.table["loop"][loop]["name"],
        columns=columns,
        passed=passed,
        sampled=sampled,
        lost=int((~columns["finite"]).sum()),
        met=met,
        claim=claim(met, judged.target) if met and judged.target is not None else None,
        statistics=metric_statistics(values[sampled]) if sampled.any() else None,
        correlations={column: rank_correlation(columns[column], values) for column in numbers},
        indices=indices,
        tornado=slopes,
        ends={column: at_the_ends(columns[column][sampled], values[sampled]) for column in numbers},
        notes=notes,
    )


def _effects(
    plan: SweepPlan, loop: int, values: np.ndarray, judged: Criteria
) -> tuple[Indices | None, Tornado | None, tuple[str, ...]]:
    """Sobol indices and tornado where asked for, and notes: what cannot be had must not cost the
    other answers."""
    space, name = plan.spaces[loop], plan.table["loop"][loop]["name"]
    indices = slopes = None
    notes = []
    try:
        if plan.table["design"] == "saltelli":
            indices = sobol_indices(names_of(space), values)
            if indices.dropped:
                part = f"{indices.dropped:.1%} of the blocks"
                notes.append(f"the Sobol indices leave out {part}, which hold a lost run")
    except ValueError as error:
        notes.append(str(error))
    try:
        if judged.tornado:
            with jax.enable_x64(plan.table["precision"] == "double"):
                slopes = tornado(plan.cases[loop], space, judged.metric)
            if slopes.left_out:
                notes.append(f"no slope, not in the tornado: {', '.join(slopes.left_out)}")
    except ValueError as error:
        notes.append(str(error))
    return indices, slopes, tuple(f"{name}: {note}" for note in notes)


def _compare(
    a: LoopResult, b: LoopResult, metric: str, parameters: list[str]
) -> PairedComparison | None:
    """None where the loops did not meet the same plants, or no rows are a sample."""
    same = all(np.array_equal(a.columns[name], b.columns[name]) for name in parameters)
    if not same or not a.sampled.any():
        return None
    return paired(a.name, a.columns[metric][a.sampled], b.name, b.columns[metric][b.sampled])


def _notes(plan: SweepPlan, unpaired: bool) -> tuple[str, ...]:
    design, runs = plan.table["design"], plan.table["runs"]
    refused = plan.table.get("refused", {}).items()
    notes = [f"{loop}: {refused_text(reasons)}" for loop, reasons in refused]
    if design == "corners":
        notes.append("corners are no sample of the spreads: counts, but no yield and no statistics")
    if design == "saltelli":
        notes.append(
            "yield and statistics rest on the independent part of the saltelli design, "
            f"{runs // (plan.spaces[0].dimensions() + 2)} runs"
        )
    if design == "sobol" and runs & (runs - 1):
        notes.append(f"sobol is balanced at powers of 2; {runs} is none")
    if design in ("sobol", "lhs"):
        notes.append(f"{design} is more even than chance: its intervals are too wide, if anything")
    if unpaired and len(plan.cases) > 1 and design != "corners":
        notes.append("the loops did not run on the same plants: no paired comparison")
    return tuple(notes)


def worst_runs(
    folder: Path, plan: SweepPlan, metric: str, count: int, loop: str | None = None
) -> list[dict[str, Any]]:
    """The worst rows that are there: lost runs first, the earliest before all, then by metric."""
    table = store.read(folder, plan, ["loop", "run", metric, "lost_at_s"])
    if loop is not None:
        table = table.filter(pa.array([name == loop for name in table["loop"].to_pylist()]))
    value, lost = (table[name].to_numpy() for name in (metric, "lost_at_s"))
    order = np.lexsort((-np.nan_to_num(value, nan=np.inf), np.nan_to_num(lost, nan=np.inf)))
    rows = table.take(order[:count]).to_pylist()
    return [
        {"loop": r["loop"], "run": r["run"], "value": r[metric], "lost_at_s": r["lost_at_s"]}
        for r in rows
    ]
