"""The report of a Monte-Carlo sweep: the folder that ``jaxstage sweep --out`` leaves."""

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jaxstage.metrics.table import split_key
from jaxstage.model.settings import plain_toml
from jaxstage.studies.verdict import span_text
from tuning.app.reports.page import Page, pictures, read_json
from tuning.app.result_table import (
    DASH,
    Column,
    ResultTable,
    Row,
    ends,
    heading,
    interval,
    number,
    numeric,
    share,
    words,
)
from tuning.store.gains_file import LAW

#: what is stated of the runs that were not lost, by its key
STATISTICS = {"mean": "mean", "P50": "p50", "P95": "p95", "mean of the worst 5 %": "cvar95"}


def read(folder: Path) -> Page:
    """The page of a folder with ``sweep.toml``."""
    summary = read_json(folder / "summary.json")
    table = tomllib.loads((folder / "sweep.toml").read_text(encoding="utf-8"))
    return Page(
        title=f"{', '.join(loop['loop'] for loop in summary['loops'])}: {summary['runs']} plants",
        subtitle="A Monte-Carlo sweep: the same plants, drawn from the spreads below, under each "
        "loop.",
        good=_good(summary),
        verdict=tuple(_verdict(summary)),
        facts={
            "specification": summary["specification"] or "none",
            "judged by": heading(summary["metric"]),
            "scored": scored(summary),
        },
        notes=tuple(summary["notes"]),
        tables=(answers(summary), *_comparisons(summary, split_key(summary["metric"])[1])),
        details=tuple(_details(summary, table)),
        pictures=pictures(folder, _texts(summary)),
        files=dict(_gains(table)),
        settings={
            "design": summary["design"],
            "seed": str(summary["seed"]),
            "precision": summary["precision"],
            "configuration": summary["configuration_sha256"],
            "versions": f"jaxstage {summary['version']}, jax {table['jax']}",
        },
    )


def scored(summary: Row) -> str:
    """What of every run is scored; said of each loop where they differ."""
    told = {loop["loop"]: span_text(loop) for loop in summary["loops"]}
    if len(set(told.values())) == 1:
        return next(iter(told.values()))
    return "; ".join(f"{name} {text}" for name, text in told.items())


def _good(summary: Row) -> bool | None:
    """Only a claimed yield makes a verdict good or bad."""
    claims = [loop["claim"]["verdict"] for loop in summary["loops"] if loop["claim"]]
    if not claims or any(verdict not in ("shown", "refuted") for verdict in claims):
        return None
    return all(verdict == "shown" for verdict in claims)


def _verdict(summary: Row) -> Iterator[str]:
    name, unit = split_key(summary["metric"])
    for loop in summary["loops"]:
        met, stated, lost = loop["yield"], loop["statistics"], loop["lost"]
        parts = [f"{share(met)} of {met['of']:g} plants meet the specification"] if met else []
        if loop["claim"]:
            claim = loop["claim"]
            parts.append(f"at least {100 * claim['target']:g} %: {claim['verdict']}")
        if stated and stated["p95"]:
            parts.append(f"95 % of the plants stay below {interval(stated['p95'])} {unit} {name}")
        parts += [f"{lost} of {loop['runs']} runs were lost"] if lost else []
        yield f"{loop['loop']}: {'; '.join(parts) or 'too few runs to state anything'}."


def answers(summary: Row) -> ResultTable:
    """What a ``summary.json`` says of every loop: a row each for value and confidence interval."""
    columns = (Column("loop", "loop"), Column("name", ""), numeric("value", "value", words))
    rows = [row for loop in summary["loops"] for row in _of_loop(loop, heading(summary["metric"]))]
    return ResultTable(
        (*columns, Column("interval", "95 %")),
        rows,
        title="Answers",
        note="95 % confidence intervals: of a yield the exact one, of the rest by bootstrap.",
    )


def _of_loop(loop: Row, metric: str) -> Iterator[dict[str, str]]:
    """Name, value and interval (or why there is none) of all that is said of a loop."""
    met, claim = loop["yield"], loop["claim"]
    lines = [("lost", str(loop["lost"]), "")]
    if met:
        lines.append(("yield", f"{met['value']:.2%}", f"{met['low']:.2%} to {met['high']:.2%}"))
    elif loop["passed"] is not None:
        lines.append(("meet the specification", str(loop["passed"]), ""))
    if claim:
        needed = f": about {claim['needed']} runs would decide it" if claim["needed"] else ""
        lines.append((f"yield >= {claim['target']:.4g}", "", claim["verdict"] + needed))
    for name, key in STATISTICS.items() if loop["statistics"] else ():
        estimate, lost = loop["statistics"][key], " (not lost)" * (key == "mean" and loop["lost"])
        value = number(estimate["value"]) if estimate else DASH
        told = ends(estimate) if estimate else loop["reasons"].get(key, DASH)
        lines.append((f"{metric} {name}{lost}", value, told))
    for i, (name, value, told) in enumerate(lines):
        yield {"loop": "" if i else loop["loop"], "name": name, "value": value, "interval": told}


def _comparisons(summary: Row, unit: str) -> Iterator[ResultTable]:
    if summary["comparisons"]:
        columns = (
            Column("first", "first"),
            Column("second", "second"),
            numeric("plants", "plants", words),
            Column("difference", f"first - second, {unit}", interval),
            Column("better", "first is smaller", share),
        )
        title = "One law against another, on the same plants"
        yield ResultTable(columns, summary["comparisons"], title)


def _details(summary: Row, table: Row) -> Iterator[ResultTable]:
    name, unit = split_key(summary["metric"])
    loops = [loop["loop"] for loop in summary["loops"]]
    rhos = {loop["loop"]: loop["rank_correlation"] for loop in summary["loops"]}
    yield ResultTable(
        (Column("value", "uncertain value"), *(numeric(loop, loop) for loop in loops)),
        [
            {"value": column, **{loop: rhos[loop].get(column) for loop in loops}}
            for column in rhos[loops[0]]
        ],
        title="What matters",
        note=f"Spearman's rank correlation with {name}: 1 or -1 decides it, 0 does not matter.",
    )
    yield ResultTable(
        (
            Column("loop", "loop"),
            numeric("run", "run", words),
            numeric("value", f"{name}, {unit}"),
            numeric("lost_at_s", "lost at, s"),
        ),
        summary["worst"],
        title="The worst plants",
        note="jaxstage replay DIR --run ID --out FOLDER simulates and draws one of them again.",
    )
    yield ResultTable(
        (
            Column("path", "value"),
            Column("distribution", "distribution"),
            Column("numbers", "numbers"),
        ),
        [
            {**spread, "numbers": ", ".join(f"{k} = {v}" for k, v in _numbers(spread))}
            for spread in table["spread"]
        ],
        title="What was uncertain",
        note="Factors on the nominal value, unless relative = false.",
    )


def _numbers(spread: Row) -> Iterator[tuple[str, Any]]:
    return ((k, v) for k, v in spread.items() if k not in ("path", "distribution"))


def _texts(summary: Row) -> dict[str, str]:
    """Picture -> how to read it."""
    texts = {
        "distribution": "How the metric is distributed over the plants, with the limit of the "
        "specification: the further left a curve rises, the better the law."
    }
    for loop in (x["loop"] for x in summary["loops"]):
        texts |= {
            f"{loop}-parameters": f"{loop}: each uncertain value against the metric; a slope says "
            "that it matters, marked plants fail.",
            f"{loop}-indices": f"{loop}: share of the variance by a value alone, and with all its "
            "interactions.",
            f"{loop}-tornado": f"{loop}: effect of each value to first order, beside what the "
            "sweep shows; where they differ the loop is not linear.",
        }
    for c in summary["comparisons"]:
        texts[f"{c['first']}-against-{c['second']}"] = (
            f"Each dot is one plant: below the diagonal {c['second']} has the smaller metric."
        )
    return texts


def _gains(table: Row) -> Iterator[tuple[str, str]]:
    """``gains.toml`` of each loop, as ``--gains`` takes it."""
    for loop in table["loop"]:
        tree: dict[str, Any] = {}
        for path, value in loop["values"].items():
            if path.startswith("gains."):
                *tables, field = path.split(".")
                inner = tree
                for name in tables:
                    inner = inner.setdefault(name, {})
                inner[field] = value
        if tree:
            yield f"{loop['name']} gains.toml", plain_toml({LAW: loop["law"], **tree})
