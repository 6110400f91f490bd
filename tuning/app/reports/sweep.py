"""The report of a Monte-Carlo sweep: the folder that ``jaxstage sweep --out`` leaves."""

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from jaxstage.metrics.table import split_key
from jaxstage.model.settings import plain_toml
from tuning.app.reports.page import Page, Table, answers, interval, number, pictures
from tuning.store.gains_file import LAW

Found = Mapping[str, Any]


def read(folder: Path) -> Page:
    """The page of a folder with ``sweep.toml``. Raises ValueError for a sweep that was stopped."""
    goes_on = f"`jaxstage sweep --out {folder} --resume`"
    found = answers(folder, "summary.json", "sweep", goes_on)
    table = tomllib.loads((folder / "sweep.toml").read_text(encoding="utf-8"))
    return Page(
        title=f"{', '.join(loop['loop'] for loop in found['loops'])}: {found['runs']} plants",
        subtitle="A Monte-Carlo sweep: the same plants, drawn from the spreads below, under each "
        "loop.",
        good=_good(found),
        verdict=tuple(_verdict(found)),
        facts={"specification": found["specification"] or "none",
               "judged by": " ".join(split_key(found["metric"])).strip()},
        notes=tuple(found["notes"]),
        tables=tuple(_answers(found)),
        details=tuple(_details(found, table)),
        pictures=pictures(folder, _texts(found)),
        files=dict(_gains(table)),
        settings={
            "design": found["design"], "seed": str(found["seed"]),
            "precision": found["precision"], "configuration": found["configuration_sha256"],
            "versions": f"jaxstage {found['version']}, jax {table['jax']}",
        },
    )  # fmt: skip


def _good(found: Found) -> bool | None:
    """Only a claimed yield makes a verdict good or bad."""
    claims = [loop["claim"]["verdict"] for loop in found["loops"] if loop["claim"]]
    if not claims or any(verdict not in ("shown", "refuted") for verdict in claims):
        return None
    return all(verdict == "shown" for verdict in claims)


def _verdict(found: Found) -> Iterator[str]:
    name, unit = split_key(found["metric"])
    for loop in found["loops"]:
        met, stated, lost = loop["yield"], loop["statistics"], loop["lost"]
        parts = [f"{_percent(met)} of {met['of']:g} plants meet the specification"] if met else []
        if loop["claim"]:
            claim = loop["claim"]
            parts.append(f"at least {100 * claim['target']:g} %: {claim['verdict']}")
        if stated and stated["p95"]:
            parts.append(f"95 % of the plants stay below {interval(stated['p95'])} {unit} {name}")
        parts += [f"{lost} of {loop['runs']} runs were lost"] if lost else []
        yield f"{loop['loop']}: {'; '.join(parts) or 'too few runs to state anything'}."


def _answers(found: Found) -> Iterator[Table]:
    name, unit = split_key(found["metric"])
    figures = {"mean": "mean", "p50": "P50", "p95": "P95", "cvar95": "mean of the worst 5 %"}
    yield Table(
        title="Answers",
        head=("loop", "lost", "yield (95 %)", *(f"{t}, {unit}" for t in figures.values())),
        rows=tuple(
            (loop["loop"], str(loop["lost"]), _percent(loop["yield"]),
             *(_stated(loop, key) for key in figures))
            for loop in found["loops"]
        ),
        note=f"Of the {name}. In brackets the 95 % interval: of a yield the exact one, of the rest "
        "by bootstrap.",
        numeric=(1,),
    )  # fmt: skip
    if found["comparisons"]:
        yield Table(
            title="One law against another, on the same plants",
            head=("first", "second", "plants", f"first - second, {unit}", "first is smaller"),
            rows=tuple(
                (c["first"], c["second"], str(c["plants"]), interval(c["difference"]),
                 _percent(c["better"]))
                for c in found["comparisons"]
            ),
            numeric=(2,),
        )  # fmt: skip


def _stated(loop: Found, key: str) -> str:
    """A statistic with its interval, or why there is none."""
    found = (loop["statistics"] or {}).get(key)
    return interval(found) if found else loop["reasons"].get(key, "–")


def _details(found: Found, table: Found) -> Iterator[Table]:
    name, unit = split_key(found["metric"])
    yield Table(
        title="What matters", head=("uncertain value", *(x["loop"] for x in found["loops"])),
        rows=tuple(
            (column, *(number(x["rank_correlation"].get(column)) for x in found["loops"]))
            for column in found["loops"][0]["rank_correlation"]
        ),
        note="Spearman's rank correlation with the figure: 1 or -1 decides it, 0 does not matter.",
        numeric=tuple(range(1, 1 + len(found["loops"]))),
    )  # fmt: skip
    yield Table(
        title="The worst plants", head=("loop", "run", f"{name}, {unit}", "lost at, s"),
        rows=tuple(
            (w["loop"], str(w["run"]), number(w["value"]), number(w["lost_at_s"]))
            for w in found["worst"]
        ),
        note="`jaxstage replay DIR --run ID --out FOLDER` simulates and draws one of them again.",
        numeric=(1, 2, 3),
    )  # fmt: skip
    yield Table(
        title="What was uncertain", head=("value", "distribution", "numbers"),
        rows=tuple(
            (s["path"], s["distribution"],
             ", ".join(f"{k} = {v}" for k, v in s.items() if k not in ("path", "distribution")))
            for s in table["spread"]
        ),
        note="Factors on the nominal value, unless relative = false.",
    )  # fmt: skip


def _texts(found: Found) -> dict[str, str]:
    """Picture -> how to read it."""
    texts = {
        "distribution": "How the figure is distributed over the plants, with the limit of the "
        "specification: the further left a curve rises, the better the law."
    }
    for loop in (x["loop"] for x in found["loops"]):
        texts |= {
            f"{loop}-parameters": f"{loop}: each uncertain value against the figure; a slope says "
            "that it matters, marked plants fail.",
            f"{loop}-indices": f"{loop}: share of the variance by a value alone, and with all its "
            "interactions.",
            f"{loop}-tornado": f"{loop}: effect of each value to first order, beside what the "
            "sweep shows; where they differ the loop is not linear.",
        }
    for c in found["comparisons"]:
        texts[f"{c['first']}-against-{c['second']}"] = (
            f"Each dot is one plant: below the diagonal {c['second']} has the smaller figure."
        )
    return texts


def _gains(table: Found) -> Iterator[tuple[str, str]]:
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


def _percent(share: Found | None) -> str:
    if not share:
        return "–"
    return f"{share['value']:.2%} ({share['low']:.2%} to {share['high']:.2%})"
