"""Plots of a sweep, as files in its folder."""

from pathlib import Path

import jax
import numpy as np

from jaxstage import __version__
from jaxstage.metrics.table import split_key
from jaxstage.plot import save, sensitivity, sweep
from tuning.store.work_folder import digest
from tuning.sweeps.analysis import Analysis, LoopResult
from tuning.sweeps.summary import scored_words
from tuning.uncertainty.statistics import PairedComparison


def pictures(analysis: Analysis, folder: Path) -> list[Path]:
    """Draw all plots that apply into a folder; returns the files."""
    files = []
    for name, plot in plots(analysis).items():
        files.append(folder / f"{name}.png")
        save(plot, files[-1])
    return files


def plots(analysis: Analysis) -> dict[str, sweep.Figure]:
    """All plots that apply, by name."""
    sheet = _sheet(analysis)
    samples = {loop.name: _sample(loop, analysis.metric) for loop in analysis.loops}
    by_chance = {loop.name: _by_chance(samples[loop.name], loop) for loop in analysis.loops}
    drawn = {"distribution": sweep.distribution(list(by_chance.values()), sheet)}
    labels = {
        column: f"{label} ({item.unit})" if item.unit != "1" else label
        for item in analysis.plan.spaces[0].uncertain
        for column, label in item.numbers().items()
    }
    for loop in analysis.loops:
        columns = {label: loop.columns[column] for column, label in labels.items()}
        correlations = {label: loop.correlations[column] for column, label in labels.items()}
        drawn[f"{loop.name}-parameters"] = sweep.parameters(
            samples[loop.name], columns, correlations, sheet
        )
        drawn |= _effects(loop, sheet)
    for c in analysis.comparisons:
        drawn[f"{c.first}-against-{c.second}"] = sweep.versus(
            by_chance[c.first], by_chance[c.second], _words(c, analysis.metric), sheet
        )
    return drawn


def _effects(loop: LoopResult, sheet: sweep.Sheet) -> dict[str, sweep.Figure]:
    drawn = {}
    if loop.tornado is not None:
        bars = [
            sensitivity.Effect(bar.name, bar.low, bar.high, loop.ends[bar.column])
            for bar in loop.tornado.bars
        ]
        drawn[f"{loop.name}-tornado"] = sensitivity.tornado(
            loop.name, loop.tornado.nominal, bars, sheet, loop.tornado.left_out
        )
    if loop.indices is not None:
        rows = [
            sensitivity.Index(name, *map(float, numbers)) for name, *numbers in loop.indices.rows()
        ]
        drawn[f"{loop.name}-indices"] = sensitivity.indices(loop.name, rows, sheet)
    return drawn


def _sheet(analysis: Analysis) -> sweep.Sheet:
    table, spec = analysis.plan.table, analysis.spec
    name, unit = split_key(analysis.metric)
    footer = "   |   ".join(
        (
            *(f"REFUSED gains: {loop}" for loop in table.get("refused", ())),
            f"{table['runs']} plants, {table['design']}",
            f"seed {table['seed']}",
            f"{table['precision']} precision",
            f"scored: {scored_words(analysis)}",
            f"specification: {spec.text}" if spec else "no specification",
            f"configuration {digest(analysis.plan.text)}",
            f"jaxstage {__version__}, jax {jax.__version__}",
        )
    )
    limit = spec.limits.get(analysis.metric) if spec else None
    shown = unit.replace("um", "µm")
    return sweep.Sheet(f"{name} ({shown})" if unit else name, limit, footer)


def _sample(loop: LoopResult, metric: str) -> sweep.MetricSample:
    met = loop.met
    interval = (met.value, met.low, met.high) if met else None
    text = f"yield {met.text()}" if met else ""
    return sweep.MetricSample(
        loop.name, np.asarray(loop.columns[metric]), loop.passed, text, interval
    )


def _by_chance(sample: sweep.MetricSample, loop: LoopResult) -> sweep.MetricSample:
    """Only the runs that are a sample of the spreads; all where none are."""
    rows = loop.sampled
    if not rows.any():
        return sample._replace(chance=False)
    passed = None if sample.passed is None else sample.passed[rows]
    return sample._replace(values=sample.values[rows], passed=passed)


def _words(c: PairedComparison, metric: str) -> str:
    unit = split_key(metric)[1].replace("um", "µm")
    gap = ""
    if c.difference is not None:
        d = c.difference
        both = "" if c.survived == c.plants else f" on the {c.survived} plants that neither lost"
        interval = f"(95 %: {d.low:.4g}..{d.high:.4g})"
        gap = f"Mean difference {d.value:.4g} {unit} {interval}{both}. "
    return (
        f"Each dot is one plant under both laws. {gap}{c.first} is the smaller one on "
        f"{c.better.text()} of the plants; a lost run is larger than any other."
    )
