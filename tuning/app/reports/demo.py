"""The report of a demo: the folder that ``jaxstage demo`` leaves."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from jaxstage.metrics.table import split_key
from tuning.app.reports import single, tuned
from tuning.app.reports.page import Page, Table, answers, interval, number, pictures

Found = Mapping[str, Any]

#: figures of the machine as it is assumed to be
NOMINAL = ("contour_rms_um", "contour_max_um", "energy_J")


def read(folder: Path) -> Page:
    """The page of a folder with ``demo.toml``. Raises ValueError for a demo that was stopped."""
    found = answers(folder, "demo.json", "demo", f"`jaxstage demo --out {folder}`")
    names = [loop["loop"] for loop in found["loops"]]
    better = [_better(loop) for loop in found["loops"]]
    return Page(
        title=f"{' and '.join(names)}, before and after tuning",
        subtitle="Two control laws on one machine: simulated at the published gains, tuned by "
        "gradients, tested on plants that no search has seen.",
        good=any(better) if len(set(better)) == 1 else None,
        verdict=tuple(found["verdict"]),
        facts={
            "plants": f"{found['plants']} machines drawn within the spreads of the study, the same "
            "for both laws and both gains",
            "judged by": " ".join(split_key(found["metric"])),
        },
        notes=(
            "Each law assumes the nominal machine, friction and load included, and meets machines "
            "that are off: where it lives on feed-forward, that is what it has to cope with.",
        ),
        tables=(_answers(folder, found),),
        details=tuple(_details(folder, found)),
        pictures=pictures(folder, _texts(found)),
        files={
            f"{loop['loop']} {Path(loop['gains']).name}": _text(folder / loop["gains"])
            for loop in found["loops"]
        },
        settings={
            "plants": f"{found['plants']}, seed {found['seed']}",
            "precision": "double",
            "configuration": found["configuration_sha256"],
            "time": f"{found['seconds']:.0f} s, {found['processor_seconds']:.0f} s of a core",
            "versions": f"jaxstage {found['version']}, jax {found['jax']}",
        },
    )


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8")


def _read(file: Path) -> Any:
    return json.loads(_text(file))


def _better(loop: Found) -> bool:
    """Accepted, and shown to be better on the plants with none lost."""
    plants = loop["plants"]
    return (
        loop["accepted"] and not plants["lost"] and plants["change"] is not None
        and plants["change"]["high"] < 0
    )  # fmt: skip


def _answers(folder: Path, found: Found) -> Table:
    name, unit = split_key(found["metric"])
    rows = []
    for number_, loop in enumerate(found["loops"]):
        for gains, when in (("published", "before"), ("tuned", "after")):
            swept = _read(folder / gains / "summary.json")["loops"][number_]
            stated = swept["statistics"] or {}
            rows.append((
                loop["loop"], gains, *(number(loop[when].get(key)) for key in NOMINAL),
                *(interval(stated.get(key)) for key in ("mean", "p95")), str(swept["lost"]),
            ))  # fmt: skip
    heads = (f"{' '.join(split_key(key))}, nominal" for key in NOMINAL)
    return Table(
        title="Before and after",
        head=("law", "gains", *heads, f"{name} {unit}, mean of the plants", "95 % stay below",
              "lost"),
        rows=tuple(rows),
        note="In brackets 95 % intervals by bootstrap. A dash: too few plants to state it.",
        numeric=(2, 3, 4, 7),
    )  # fmt: skip


def _details(folder: Path, found: Found) -> Iterator[Table]:
    for loop in (one["loop"] for one in found["loops"]):
        table = tuned.gains(_read(folder / "tune" / loop / "tune.json"))
        yield table._replace(title=f"Gains of {loop}")
    yield Table(
        title="What was run",
        head=("command", "s", "s of a core"),
        rows=tuple(
            (one["command"], f"{one['seconds']:.1f}", f"{one['processor_seconds']:.1f}")
            for one in found["stages"]
        ),
        note="`jaxstage report` makes a report of each of these folders, too.",
        numeric=(1, 2),
    )


def _texts(found: Found) -> dict[str, str]:
    """Picture -> how to read it."""
    names = [loop["loop"] for loop in found["loops"]]
    texts = {f"run/{n}/contour": f"{n}, published gains. {single.TEXTS['contour']}" for n in names}
    texts |= {f"tune/{n}/error": f"{n}. {tuned.TEXTS['error']}" for n in names}
    texts["plants"] = (
        "How the figure is distributed over the plants: the further left a curve rises, the "
        "better; a steep one says that the law does not care which machine it gets."
    )
    for when in ("published", "tuned"):
        pair = found["comparisons"][when]
        if pair:
            texts[f"{when}/{pair['first']}-against-{pair['second']}"] = (
                f"Each dot is one plant at {when} gains: below the diagonal {pair['second']} has "
                "the smaller figure."
            )
    for picture in ("history", "parameters"):
        texts |= {f"tune/{n}/{picture}": f"{n}. {tuned.TEXTS[picture]}" for n in names}
    return texts
