"""Combinators of metrics: several together, over a window of ticks, and recording."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxstage.model.blocks import Acc, Metric, Report
from jaxstage.model.fields import replace
from jaxstage.model.signals import Sample, Setpoint


@functools.cache
def together(*metrics: Metric[Any, Any]) -> Metric[dict[str, Any], dict[str, Any]]:
    """Several metrics in one pass. Report and rows are dicts keyed by the metrics' names.

    Raises ValueError when two metrics share a name.
    """
    names = [m.name for m in metrics]
    if len(set(names)) < len(names):
        raise ValueError(f"metrics need different names, got {', '.join(names)}")

    def init(setpoint: Setpoint) -> dict[str, Any]:
        return {m.name: m.init(setpoint) for m in metrics}

    def update(acc: dict[str, Any], sample: Sample, dt: float) -> tuple[dict[str, Any], Any]:
        pairs = {m.name: m.update(acc[m.name], sample, dt) for m in metrics if m.name in acc}
        rows = {name: row for name, (_, row) in pairs.items() if row is not None}
        return {name: after for name, (after, _) in pairs.items()}, rows or None

    def finish(acc: dict[str, Any]) -> dict[str, Any]:
        reports = {m.name: m.finish(acc[m.name]) for m in metrics if m.name in acc}
        return {name: report for name, report in reports.items() if report is not None}

    return Metric(name="together", init=init, update=update, finish=finish)


@functools.cache
def selected(
    metric: Metric[dict[str, Any], Report], names: tuple[str, ...]
) -> Metric[dict[str, Any], Report]:
    """Only the named ones of metrics `together`; the others are not computed.

    Raises ValueError, when a run begins, for a name that is not among them.
    """

    def init(setpoint: Setpoint) -> dict[str, Any]:
        every = metric.init(setpoint)
        unknown = sorted(set(names) - set(every))
        if unknown:
            raise ValueError(f"no metric is called {unknown[0]}; there are {', '.join(every)}")
        return {name: every[name] for name in names}

    return replace(metric, init=init)


@functools.cache
def windowed(
    metric: Metric[Acc, Report], start: int, stop: int, name: str = ""
) -> Metric[Acc, Report]:
    """The metric over ticks start <= k < stop only. Raises ValueError for an empty window."""
    if not 0 <= start < stop:
        raise ValueError(f"a window needs 0 <= start < stop, got {start} and {stop}")

    def update(acc: Acc, sample: Sample, dt: float) -> tuple[Acc, Any]:
        inside = (sample.step >= start) & (sample.step < stop)
        after, row = metric.update(acc, sample, dt)
        return jax.tree.map(lambda new, old: jnp.where(inside, new, old), after, acc), row

    return Metric(name=name or metric.name, init=metric.init, update=update, finish=metric.finish)


def recorded(name: str, pick: Callable[[Sample], Any]) -> Metric[tuple[()], None]:
    """Stores ``pick(sample)`` of every tick: memory grows with the length of the run. No report."""

    def update(acc: tuple[()], sample: Sample, dt: float) -> tuple[tuple[()], Any]:
        return acc, pick(sample)

    return Metric(name=name, init=lambda setpoint: (), update=update, finish=lambda acc: None)


#: Stores every `Sample`.
record = recorded("record", lambda sample: sample)
