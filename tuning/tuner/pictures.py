"""Plots of a tuning as files in its folder."""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxstage import __version__
from jaxstage.controllers.fuzzy_rules import OUTPUTS, fuzzy_laws, readable
from jaxstage.metrics import record, together
from jaxstage.metrics.table import columns, split_key
from jaxstage.model.signals import Run
from jaxstage.plot import rule_surface, save, sweep, tuning, view
from jaxstage.studies import Case, with_metric
from jaxstage.studies.verdict import lost_because
from jaxstage.system.files import write_text
from tuning.store.work_folder import digest
from tuning.tuner.baselines import ConvergenceCurve, convergence_curve
from tuning.tuner.pareto import Front
from tuning.tuner.problem.search_space import parameters
from tuning.tuner.problem.transforms import logarithmic
from tuning.tuner.report import Extras, verdict_text
from tuning.tuner.session import TuningResult


class BeforeAfter(NamedTuple):
    """The loop as it stands, with the gains before and after: cases and their runs."""

    before: Case
    after: Case
    runs: tuple[Run, Run]

    def metrics(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """The scored metrics of both."""
        plant = self.before.loop.plant
        first, second = (columns(run.report["scored"], plant) for run in self.runs)
        return first, second


def simulate_before_after(case: Case, before: Any, after: Any, recorded: bool) -> BeforeAfter:
    """The loop itself under both gains. recorded: every tick, for pictures."""
    kept = (record,) if recorded else ()
    cases = [case._replace(gains=gains) for gains in (before, after)]
    runs = [with_metric(c, together(c.loop.metric, *kept)).simulate() for c in cases]
    return BeforeAfter(cases[0], cases[1], (runs[0], runs[1]))


def pictures(folder: Path, outcome: TuningResult, extras: Extras, pair: BeforeAfter) -> list[Path]:
    """Draw all that applies; returns the files. pair: recorded."""
    footer = _footer(outcome)
    own = convergence_curve(outcome.rounds[-1].tuned)
    drawn = {
        "error": tuning.before_after(*_views(pair)),
        "history": tuning.history(_traces([own]), footer),
        "parameters": tuning.parameters(_moved(outcome), footer),
        "held-out": _held_out(outcome, footer),
    }
    if extras.baselines:
        first = convergence_curve(outcome.rounds[0].tuned)
        drawn["baseline"] = tuning.history(_traces([first, *extras.baselines]), footer)
    if extras.front is not None:
        drawn["pareto"] = _front(extras.front, footer)
    drawn |= rule_pictures(pair)
    files = [folder / f"{name}.png" for name in drawn]
    for file, plot in zip(files, drawn.values(), strict=True):
        save(plot, file)
    return files


def _footer(outcome: TuningResult) -> str:
    table = outcome.plan.table
    return "   |   ".join(
        (
            table["loop"],
            f"{outcome.tuned.method}, {outcome.tuned.n} parameters, "
            f"{outcome.simulations:.0f} simulations",
            f"objective {table['objective']}",
            f"{outcome.problem.runs} training runs, seed {table['seed']}",
            "accepted" if not outcome.refused else f"NOT accepted: {outcome.refused[0].reason}",
            f"configuration {digest(outcome.plan.text)}",
            f"jaxstage {__version__}, jax {jax.__version__}",
        )
    )


def _views(pair: BeforeAfter) -> list[Any]:
    views = []
    for case, run in zip((pair.before, pair.after), pair.runs, strict=True):
        left = int(run.final.left_path_at)
        because = lost_because(case, left if left >= 0 else None)
        views.append(view(case, run.report["scored"], run.rows["record"], because))
    return views


def _traces(courses: list[ConvergenceCurve]) -> list[tuning.Trace]:
    return [tuning.Trace(*one) for one in courses]


def _moved(outcome: TuningResult) -> list[tuning.Moved]:
    space = outcome.problem.space
    logs = {entry.path: entry.transform == logarithmic for entry in space.entries}
    return [
        tuning.Moved(
            f"{p.label.removeprefix('gains.')} ({p.unit})",
            p.before,
            p.value,
            p.low,
            p.high,
            logs[p.path],
            p.at_bound,
        )
        for p in parameters(space, outcome.chosen.z)
    ]


def _held_out(outcome: TuningResult, footer: str) -> sweep.Figure:
    pairs, verdict = outcome.pairs, outcome.held_out
    name, unit = split_key(verdict.metric)
    shown = f"{name} ({unit.replace('um', 'µm')})" if unit else name
    sheet = sweep.Sheet(shown, None, footer)
    samples = [
        sweep.MetricSample(label, values, None)
        for label, values in (("after", pairs.after), ("before", pairs.before))
    ]
    text = f"Each dot is one held-out plant under both gains: {verdict_text(verdict)}."
    if not np.any(np.isfinite(pairs.before) & np.isfinite(pairs.after)):
        return sweep.distribution(samples, sheet)
    return sweep.versus(samples[0], samples[1], text, sheet)


def _front(front: Front, footer: str) -> sweep.Figure:
    labels = [
        f"{name} ({unit.replace('um', 'µm')})" for name, unit in map(split_key, front.columns)
    ]
    return tuning.front(front.points, front.kept, front.suggested, front.before, labels, footer)


def rule_pictures(pair: BeforeAfter) -> dict[str, sweep.Figure]:
    """What fuzzy rules infer, before and after."""
    drawn = {}
    for case, when in ((pair.before, "before"), (pair.after, "after")):
        for number, law in enumerate(fuzzy_laws(case.gains)):
            part = f"-{number}" if number else ""
            for field, output in OUTPUTS.items():
                drawn[f"rules{part}-{field}-{when}"] = rule_surface(
                    law.error_sets, law.rate_sets, getattr(law.rules, field), f"{output}, {when}"
                )
    return drawn


def rules_text(pair: BeforeAfter) -> str | None:
    """The fuzzy rules before and after tuning as tables, None for a law without any."""
    tables = [
        readable(case.gains, run.final.memory)
        for case, run in zip((pair.before, pair.after), pair.runs, strict=True)
    ]
    if tables[0] is None or tables[1] is None:
        return None
    return f"BEFORE TUNING\n\n{tables[0]}\n\nAFTER TUNING\n\n{tables[1]}"


def write_rules(folder: Path, pair: BeforeAfter) -> None:
    """rules.txt, where the law has fuzzy rules."""
    text = rules_text(pair)
    if text is not None:
        write_text(folder / "rules.txt", text)
