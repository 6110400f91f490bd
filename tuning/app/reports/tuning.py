"""The report of a tuning: the folder that ``jaxstage tune --out`` leaves."""

import math
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

from jaxstage.metrics.table import split_key
from jaxstage.studies.verdict import span_text
from tuning.app.reports.page import Page, pictures, read_json
from tuning.app.result_table import (
    DASH,
    Column,
    ResultTable,
    Row,
    heading,
    interval,
    number,
    numeric,
)
from tuning.tuner.problem.gradient_check import TOLERANCE

#: what a tuning leaves to take away, as far as it is there
FILES = ("gains.toml", "refused-gains.toml", "rules.txt")
#: picture -> how to read it
TEXTS = {
    "error": "The error of the loop itself under the gains before and after, and below the command "
    "of its busiest axis: a thicker band there is the price.",
    "history": "How the objective fell against what was spent: 1 are the gains before; the norm of "
    "the gradient below falls where the search settles.",
    "parameters": "Each tuned number in its range, before and after: red ended on its border, so "
    "that the best may lie beyond.",
    "held-out": "Each dot is one plant that the search never saw: below the diagonal the gains "
    "after are better.",
    "baseline": "Other methods on the same problem: at equal cost the lower line is the better "
    "one.",
    "pareto": "Trade-offs: filled dots are beaten by none, the star is the suggested compromise.",
}


def read(folder: Path) -> Page:
    """The page of a folder with ``tune.toml``."""
    answer = read_json(folder / "tune.json")
    table = tomllib.loads((folder / "tune.toml").read_text(encoding="utf-8"))
    return Page(
        title=f"{answer['loop']}: tuned gains",
        subtitle=f"{answer['n']} numbers, searched by {answer['method']}, then tested on the exact "
        "model and on plants that the search never saw.",
        good=answer["accepted"],
        verdict=tuple(verdict(answer)),
        facts={
            "objective": f"{answer['objective']}, {table['risk']} over the training runs",
            "goals": ", ".join(table["goal"]) or "none",
            "held out": f"{answer['held_out']['runs']} runs, judged by "
            f"{split_key(answer['held_out']['figure'])[0]}",
            "scored": scored(answer),
        },
        notes=tuple(answer["diagnostics"]["notes"]),
        tables=(gains(answer), metrics(answer)),
        details=tuple(_details(answer)),
        pictures=pictures(folder, TEXTS | _rules(folder)),
        files=_take_away(folder),
        settings=_settings(answer, table),
    )


def verdict(answer: Row) -> Iterator[str]:
    """Accepted or not, and why; then what the held-out runs say. answer: a ``tune.json``."""
    told = "; ".join(answer["refused"])
    yield f"NOT accepted: {told}." if told else "Accepted: the gains passed every test."
    if told:
        yield f"What to try next: {'; '.join(answer['try_next'])}."
    yield held_out(answer["held_out"])
    yield from (f"Warning: {text}." for text in answer["warnings"])


def held_out(stated: Row) -> str:
    """A metric of runs that the search never saw, before and after, in one sentence."""
    name, unit = split_key(stated["figure"])
    change = stated["change"]
    if change is None and stated["after"] is not None:
        return (
            f"{name} {interval(stated['after'])} {unit} on {stated['runs']} plants never seen; "
            f"{stated['lost']} lost, {stated['lost_before']} before, so that there is no change to "
            "state."
        )
    if change is None:
        return f"{stated['lost']} of {stated['runs']} runs are lost, too few are left to compare."
    return (
        f"{name} {interval(stated['before'])} → {interval(stated['after'])} {unit} on "
        f"{stated['runs']} plants never seen, {_signed(change['value'])} "
        f"({_signed(change['low'])} to {_signed(change['high'])}); {stated['lost']} lost, "
        f"{stated['lost_before']} before."
    )


def gains(answer: Row) -> ResultTable:
    """Every number that was tuned."""
    return ResultTable(
        (
            Column("gain", "gain"),
            Column("symbol", "symbol"),
            numeric("value", "value"),
            Column("unit", "unit"),
            numeric("range", "range", str),
            numeric("before", "before"),
            Column("border", ""),
        ),
        [
            {
                **gain,
                "gain": label.removeprefix("gains."),
                "range": f"{number(gain['low'])} … {number(gain['high'])}",
                "border": "on its border" if gain["at_bound"] else "",
            }
            for label, gain in answer["gains"].items()
        ],
        title="Gains",
    )


def scored(answer: Row) -> str:
    """What of the runs is scored: of the loop, in training, held out."""
    return "; ".join(
        f"{name.replace('_', ' ')} {', '.join(map(span_text, parts))}"
        for name, parts in answer.get("scored", {}).items()
    )


def _take_away(folder: Path) -> dict[str, str]:
    """The files of `FILES` that are there."""
    there = [name for name in FILES if (folder / name).is_file()]
    return {name: (folder / name).read_text(encoding="utf-8") for name in there}


def _signed(share: float | None) -> str:
    return DASH if share is None else f"{100 * share:+.1f} %"


def metrics(answer: Row, named: tuple[str, ...] = ("",)) -> ResultTable:
    """Metrics of the loop itself, and means over the held-out runs. named: how the keys begin."""
    heads = ("loop before", "loop after", "held out before", "held out after")
    before, after = (answer[when]["figures"] for when in ("before", "after"))
    held = answer["held_out"]["figures"]
    rows = []
    for key, first in before.items():
        name, unit = split_key(key)
        for axis, value in first.items() if isinstance(first, Mapping) else (("", first),):
            second = after[key][axis] if axis else after[key]
            other = held.get(_column(key, axis, held), {"before": None, "after": None})
            values = zip(heads, (value, second, other["before"], other["after"]), strict=True)
            rows.append({"metric": f"{name} {axis}".strip(), "unit": unit, **dict(values)})
    return ResultTable(
        (
            Column("metric", "metric"),
            *(numeric(head, head) for head in heads),
            Column("unit", "unit"),
        ),
        [row for row in rows if row["metric"].startswith(named)],
        title="Figures",
        note="Of the loop itself, and means over the held-out runs that neither gains lost. A "
        "dash: no such metric.",
    )


def _column(key: str, axis: str, columns: Row) -> str:
    """The column of an axis: ``following_rms_um`` of x is ``following_rms_x_um``."""
    return next((c for c in columns if axis and c.replace(f"_{axis}", "", 1) == key), key)


def _details(answer: Row) -> Iterator[ResultTable]:
    yield diagnostics(answer)
    yield from baselines(answer)
    yield from trade_offs(answer)


def diagnostics(answer: Row) -> ResultTable:
    """What the result rests on."""
    return ResultTable(
        (Column("question", "question"), Column("answer", "answer")),
        [{"question": q, "answer": told} for q, told in _diagnostics(answer["diagnostics"])],
        title="What the result rests on",
        note="What runs give is the first metric of the objective, their mean.",
    )


def baselines(answer: Row) -> Iterator[ResultTable]:
    """Other methods, where they were asked for."""
    if answer["baselines"]:
        columns = (
            Column("method", "method"),
            numeric("objective", "objective at the end"),
            numeric("units", "simulations"),
            numeric("units_to_same", "simulations to the same objective"),
        )
        title, note = "Other methods at equal cost", "A dash: it was never as good."
        yield ResultTable(columns, answer["baselines"], title, note)


def _diagnostics(stated: Row) -> Iterator[tuple[str, str]]:
    if stated["gradient_ok"] is not None:
        yield "Can gradients be trusted?", _gradients(stated)
    if stated["starts_agree"] is not None:
        ends = ", ".join(map(number, stated["starts"]))
        yield (
            "Do the starting points agree?",
            f"{'yes' if stated['starts_agree'] else 'NO'}: {ends}",
        )
    for question, key in (
        ("The training runs", "exact"),
        ("With half the integration step", "half_step"),
        ("Other plants, four times as long", "longer"),
    ):
        one = stated[key]
        yield question, f"{number(one['before'])} → {number(one['after'])}, {one['lost']} lost"
    for question, key in (
        ("On the border of their range", "at_bounds"),
        ("Without effect", "insensitive"),
    ):
        if stated[key] is not None:
            yield question, ", ".join(_short(stated[key])) or "none"
    for group in stated["redundant"] or ():
        yield "Act only together", ", ".join(_short(group))
    if stated["share"] < 1:
        yield "Taken back", f"to {stated['share']:.0%} of the way: what was found failed a test"
    if stated["surrogate"]:
        first, second = (number(stated["surrogate"][when]) for when in ("before", "after"))
        yield "Objective on the surrogate that was searched", f"{first} → {second}"
    if stated["spectral_radius"]:
        radius = stated["spectral_radius"]
        before, after = (f"{radius[when]:.6g}" for when in ("before", "after"))
        yield "Spectral radius of one control period", f"{before} → {after}"


def _gradients(stated: Row) -> str:
    """In how many training runs slopes agree with differences, and where they do worst."""
    errors = {k: math.inf if v is None else v for k, v in stated["gradient_error"].items()}
    good = sum(error <= TOLERANCE for error in errors.values())
    state = "yes" if stated["gradient_ok"] else "NO"
    text = f"{state}: {good} of {len(errors)} runs agree with differences to {TOLERANCE:.0%}"
    worst = max(errors, key=lambda run: errors[run], default=None)
    return text if worst is None else f"{text}, worst {number(errors[worst])} in {worst}"


def _short(labels: list[str]) -> list[str]:
    return [label.removeprefix("gains.") for label in labels]


def trade_offs(answer: Row) -> Iterator[ResultTable]:
    """The gains before and those on the way from corner to corner, where they were asked for."""
    front = answer["pareto"]
    if front:
        rows = [{"point": "before", **front["before"]}]
        for index, point in enumerate(front["points"]):
            told = "suggested" if point["suggested"] else "" if point["on_front"] else "beaten"
            rows.append({"point": str(index), **point["figures"], "told": told})
        columns = (numeric(key, heading(key)) for key in front["columns"])
        yield ResultTable(
            (Column("point", "point"), *columns, Column("told", "")),
            rows,
            title="Trade-offs",
            note="The gains of each point stand in pareto/; tested on the training runs only.",
        )


def _rules(folder: Path) -> dict[str, str]:
    """Pictures of fuzzy rules, before next to after."""
    names = [f.stem for f in folder.glob("rules*-*.png")]
    order = sorted(names, key=lambda n: (n.rpartition("-")[0], n.endswith("-after")))
    return {
        name: "What the rules infer over both inputs, the consequents at their centres, "
        f"{name.rpartition('-')[2]} tuning."
        for name in order
    }


def _settings(answer: Row, table: Row) -> dict[str, str]:
    train, held = table["train"], table["held_out"]
    return {
        "loop": answer["loop"],
        "search": f"{answer['method']}, {table['starts']} starting points, "
        f"{number(answer['units'])} of {number(table['budget'])} simulations, "
        f"{answer['seconds']:.0f} s; {answer['ended']}",
        "training": f"{_contours(train)}; plants: {train['plants']} drawn"
        f"{' and the nominal one' if train['nominal'] else ''}; gain margin "
        f"{100 * table['margin']:g} %; surrogate: {table['surrogate']}",
        "held out": f"{_contours(held)}; plants: {held['plants']}",
        "seed": str(table["seed"]),
        "precision": "double",
        "configuration": answer["configuration_sha256"],
        "versions": f"jaxstage {answer['version']}, jax {table['jax']}",
    }


def _contours(one: Row) -> str:
    return ", ".join(dict.fromkeys(case["name"] for case in one["case"]))
