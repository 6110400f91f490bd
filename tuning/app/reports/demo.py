"""The report of a demo: the folder that ``jaxstage demo`` leaves."""

from collections.abc import Iterator
from pathlib import Path

from jaxstage.metrics.table import split_key
from tuning.app.reports import run, tuning
from tuning.app.reports.page import Page, pictures, read_json
from tuning.app.result_table import (
    Column,
    ResultTable,
    Row,
    heading,
    interval,
    numeric,
    words,
)

#: metrics of the machine as it is assumed to be
NOMINAL = ("contour_rms_um", "contour_max_um", "energy_J")


def read(folder: Path) -> Page:
    """The page of a folder with ``demo.toml``."""
    answer = read_json(folder / "demo.json")
    names = [loop["loop"] for loop in answer["loops"]]
    better = [_better(loop) for loop in answer["loops"]]
    return Page(
        title=f"{' and '.join(names)}, before and after tuning",
        subtitle="Two control laws on one machine: simulated at the published gains, tuned by "
        "gradients, tested on plants that no search has seen.",
        good=any(better) if len(set(better)) == 1 else None,
        verdict=tuple(answer["verdict"]),
        facts={
            "plants": f"{answer['plants']} machines drawn within the spreads of the study, the "
            "same for both laws and both gains",
            "judged by": " ".join(split_key(answer["metric"])),
        },
        notes=(
            "Each law assumes the nominal machine, friction and load included, and meets machines "
            "that are off: where it lives on feed-forward, that is what it has to cope with.",
        ),
        tables=(_answers(folder, answer),),
        details=tuple(_details(folder, answer)),
        pictures=pictures(folder, _texts(answer)),
        files={
            f"{loop['loop']} {Path(loop['gains']).name}": _text(folder / loop["gains"])
            for loop in answer["loops"]
        },
        settings={
            "plants": f"{answer['plants']}, seed {answer['seed']}",
            "precision": "double",
            "configuration": answer["configuration_sha256"],
            "time": f"{answer['seconds']:.0f} s, {answer['processor_seconds']:.0f} s of a core",
            "versions": f"jaxstage {answer['version']}, jax {answer['jax']}",
        },
    )


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8")


def _better(loop: Row) -> bool:
    """Accepted, and shown to be better on the plants with none lost."""
    plants = loop["plants"]
    change = plants["change"]
    return loop["accepted"] and not plants["lost"] and change is not None and change["high"] < 0


def _answers(folder: Path, answer: Row) -> ResultTable:
    metric = heading(answer["metric"])
    rows = []
    for number_, loop in enumerate(answer["loops"]):
        for gains, when in (("published", "before"), ("tuned", "after")):
            swept = read_json(folder / gains / "summary.json")["loops"][number_]
            nominal = {key: loop[when].get(key) for key in NOMINAL}
            row = {"loop": loop["loop"], "gains": gains, "lost": swept["lost"]}
            rows.append(row | nominal | (swept["statistics"] or {}))
    return ResultTable(
        (
            Column("loop", "law"),
            Column("gains", "gains"),
            *(numeric(key, f"{heading(key)}, nominal") for key in NOMINAL),
            Column("mean", f"{metric}, mean of the plants", interval),
            Column("p95", "95 % stay below", interval),
            numeric("lost", "lost", words),
        ),
        rows,
        title="Before and after",
        note="In brackets 95 % intervals by bootstrap. A dash: too few plants to state it.",
    )


def _details(folder: Path, answer: Row) -> Iterator[ResultTable]:
    for loop in (one["loop"] for one in answer["loops"]):
        table = tuning.gains(read_json(folder / "tune" / loop / "tune.json"))
        yield table._replace(title=f"Gains of {loop}")
    yield ResultTable(
        (
            Column("command", "command"),
            numeric("seconds", "s"),
            numeric("processor_seconds", "s of a core"),
        ),
        answer["stages"],
        title="What was run",
        note="jaxstage report makes a report of each of these folders, too.",
    )


def _texts(answer: Row) -> dict[str, str]:
    """Picture -> how to read it."""
    names = [loop["loop"] for loop in answer["loops"]]
    texts = {f"run/{n}/contour": f"{n}, published gains. {run.TEXTS['contour']}" for n in names}
    texts |= {f"tune/{n}/error": f"{n}. {tuning.TEXTS['error']}" for n in names}
    texts["plants"] = (
        "How the metric is distributed over the plants: the further left a curve rises, the "
        "better; a steep one says that the law does not care which machine it gets."
    )
    for when in ("published", "tuned"):
        pair = answer["comparisons"][when]
        if pair:
            texts[f"{when}/{pair['first']}-against-{pair['second']}"] = (
                f"Each dot is one plant at {when} gains: below the diagonal {pair['second']} has "
                "the smaller metric."
            )
    for picture in ("history", "parameters"):
        texts |= {f"tune/{n}/{picture}": f"{n}. {tuning.TEXTS[picture]}" for n in names}
    return texts
