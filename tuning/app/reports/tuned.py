"""The report of a tuning: the folder that ``jaxstage tune --out`` leaves."""

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from jaxstage.metrics.table import split_key
from tuning.app.reports.page import Page, Table, answers, interval, number, pictures

Found = Mapping[str, Any]

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
    """The page of a folder with ``tune.toml``. Raises ValueError for a tuning that was stopped."""
    goes_on = "the same `jaxstage tune` with --resume"
    found = answers(folder, "tune.json", "tuning", goes_on)
    table = tomllib.loads((folder / "tune.toml").read_text(encoding="utf-8"))
    return Page(
        title=f"{found['loop']}: tuned gains",
        subtitle=f"{found['n']} numbers, searched by {found['method']}, then tested on the exact "
        "model and on plants that the search never saw.",
        good=found["accepted"],
        verdict=tuple(_verdict(found)),
        facts={
            "objective": f"{found['objective']}, {table['risk']} over the training runs",
            "goals": ", ".join(table["goal"]) or "none",
            "held out": f"{found['held_out']['runs']} runs, judged by "
            f"{split_key(found['held_out']['figure'])[0]}",
        },
        notes=tuple(found["diagnostics"]["notes"]),
        tables=(gains(found), _figures(found)),
        details=tuple(_details(found)),
        pictures=pictures(folder, TEXTS | _rules(folder)),
        files=_take_away(folder),
        settings=_settings(found, table),
    )


def _verdict(found: Found) -> Iterator[str]:
    """Accepted or not, and why; then what the held-out runs say. found: a ``tune.json``."""
    told = "; ".join(found["refused"])
    yield f"NOT accepted: {told}." if told else "Accepted: the gains passed every test."
    if told:
        yield f"What to try next: {'; '.join(found['try_next'])}."
    yield held_out(found["held_out"])


def held_out(stated: Found) -> str:
    """A figure of runs that the search never saw, before and after, in one sentence."""
    name, unit = split_key(stated["figure"])
    change = stated["change"]
    if change is None:
        return f"{stated['lost']} of {stated['runs']} runs are lost, too few are left to compare."
    return (
        f"{name} {interval(stated['before'])} → {interval(stated['after'])} {unit} on "
        f"{stated['runs']} plants never seen, {_signed(change['value'])} "
        f"({_signed(change['low'])} to {_signed(change['high'])}); {stated['lost']} lost, "
        f"{stated['lost_before']} before."
    )


def gains(found: Found) -> Table:
    """Every number that was tuned. found: a ``tune.json``."""
    return Table(
        title="Gains",
        head=("gain", "symbol", "value", "unit", "range", "before", ""),
        rows=tuple(
            (label.removeprefix("gains."), one["symbol"], number(one["value"]), one["unit"],
             f"{number(one['low'])} … {number(one['high'])}", number(one["before"]),
             "on its border" if one["at_bound"] else "")
            for label, one in found["gains"].items()
        ),
        numeric=(2, 4, 5),
    )  # fmt: skip


def _take_away(folder: Path) -> dict[str, str]:
    """The files of `FILES` that are there."""
    there = [name for name in FILES if (folder / name).is_file()]
    return {name: (folder / name).read_text(encoding="utf-8") for name in there}


def _signed(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:+.1f} %"


def _figures(found: Found) -> Table:
    return Table(
        title="Figures",
        head=("figure", "loop before", "loop after", "held out before", "held out after", "unit"),
        rows=tuple(_figure_rows(found)),
        note="Of the loop itself, and means over the held-out runs that neither gains lost. A "
        "dash: no such figure.",
        numeric=(1, 2, 3, 4),
    )


def _figure_rows(found: Found) -> Iterator[tuple[str, ...]]:
    before, after = (found[when]["figures"] for when in ("before", "after"))
    held = found["held_out"]["figures"]
    for key, first in before.items():
        name, unit = split_key(key)
        parts = first if isinstance(first, Mapping) else {"": first}
        for axis, value in parts.items():
            second = after[key][axis] if axis else after[key]
            other = held.get(_column(key, axis, held), {"before": None, "after": None})
            numbers = (value, second, other["before"], other["after"])
            yield f"{name} {axis}".strip(), *map(number, numbers), unit


def _column(key: str, axis: str, columns: Found) -> str:
    """The column of an axis: ``following_rms_um`` of x is ``following_rms_x_um``."""
    return next((c for c in columns if axis and c.replace(f"_{axis}", "", 1) == key), key)


def _details(found: Found) -> Iterator[Table]:
    yield Table(
        title="What the result rests on",
        head=("question", "answer"),
        rows=tuple(_diagnostics(found["diagnostics"])),
        note="What runs give is the first figure of the objective, their mean.",
    )
    if found["baselines"]:
        yield Table(
            title="Other methods at equal cost",
            head=("method", "objective at the end", "units", "units to the objective found here"),
            rows=tuple(
                (one["method"], number(one["objective"]), number(one["units"]),
                 number(one["units_to_same"]))
                for one in found["baselines"]
            ),
            note="A dash: it was never as good.",
            numeric=(1, 2, 3),
        )  # fmt: skip
    if found["pareto"]:
        yield _trade_offs(found["pareto"])


def _diagnostics(stated: Found) -> Iterator[tuple[str, str]]:
    if stated["gradient_ok"] is not None:
        worst = max((v for v in stated["gradient_error"].values() if v is not None), default=None)
        state = "yes" if stated["gradient_ok"] else "NO"
        yield "Do gradients agree with differences?", f"{state}, largest error {number(worst)}"
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


def _short(labels: list[str]) -> list[str]:
    return [label.removeprefix("gains.") for label in labels]


def _trade_offs(front: Found) -> Table:
    columns = front["columns"]
    rows = [("before", *(number(front["before"][c]) for c in columns), "")]
    for index, point in enumerate(front["points"]):
        told = "suggested" if point["suggested"] else "" if point["on_front"] else "beaten"
        rows.append((str(index), *(number(point["figures"][c]) for c in columns), told))
    return Table(
        title="Trade-offs",
        head=("point", *(" ".join(split_key(c)).strip() for c in columns), ""),
        rows=tuple(rows),
        note="The gains of each point stand in pareto/; tested on the training runs only.",
        numeric=tuple(range(1, 1 + len(columns))),
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


def _settings(found: Found, table: Found) -> dict[str, str]:
    train, held = table["train"], table["held_out"]
    return {
        "loop": found["loop"],
        "search": f"{found['method']}, {table['starts']} starting points, {number(found['units'])} "
        f"of {number(table['budget'])} units, {found['seconds']:.0f} s of simulation; "
        f"{found['ended']}",
        "training": f"{_contours(train)}; plants: {train['plants']} drawn"
        f"{' and the nominal one' if train['nominal'] else ''}; gain margin "
        f"{100 * table['margin']:g} %; surrogate: {table['surrogate']}",
        "held out": f"{_contours(held)}; plants: {held['plants']}",
        "seed": str(table["seed"]),
        "precision": "double",
        "configuration": found["configuration_sha256"],
        "versions": f"jaxstage {found['version']}, jax {table['jax']}",
    }


def _contours(one: Found) -> str:
    return ", ".join(dict.fromkeys(case["name"] for case in one["case"]))
