"""The report of a comparison with a paper: the folder that ``jaxstage compare --out`` leaves."""

from collections.abc import Sequence
from pathlib import Path

from jaxstage.studies import known_studies
from jaxstage.studies.plots import ChartPlot
from tuning.app.reports import run
from tuning.app.reports.page import Page, pictures, read_json
from tuning.app.result_table import DASH, Column, ResultTable, Row, metric_table, numeric
from tuning.store.gains_file import refused_text

#: verdict -> title of its table, in this order
TITLES = {
    "fails": "Claims that fail",
    "holds": "Claims that hold",
    "unchecked": "Claims that cannot be checked",
}


def read(folder: Path) -> Page:
    """The page of a folder with ``compare.json``."""
    answer = read_json(folder / "compare.json")
    counts, changed = answer["counts"], answer["changed"]
    every = "Every verdict is the one that is stored with the study."
    return Page(
        title=answer["study"],
        subtitle=answer["source"],
        good=None,
        verdict=(
            f"{counts['holds']} claims of the paper hold, {counts['fails']} fail, "
            f"{counts['unchecked']} cannot be checked by simulation.",
            f"Not as stored with the study: {', '.join(changed)}." if changed else every,
        ),
        facts={},
        tables=(),
        details=tuple(_of_verdict(answer["claims"], verdict) for verdict in TITLES),
        pictures=pictures(folder, _texts(answer["study"])),
        files={},
        settings={
            "versions": f"jaxstage {answer['version']}, jax {answer['jax']}",
            "precision": "double",
        },
    )


def claims(rows: Sequence[Row]) -> ResultTable:
    """Claims of a ``compare.json``: both values, their difference, the verdict and its reason."""
    return ResultTable(
        (
            Column("where", "where", wrap=2),
            Column("text", "claim", wrap=5),
            numeric("published", "published"),
            numeric("ours", "ours"),
            Column("unit", "unit"),
            numeric("difference", "difference", _difference),
            Column(
                "verdict",
                "verdict",
                styles={"holds": "green", "fails": "red", "unchecked": "dim"},
            ),
            Column("reason", "reason", wrap=5),
        ),
        rows,
        note="A dash: only words are printed, or there is nothing to compute.",
    )


def gains(one: Row) -> ResultTable:
    """Metrics of a loop under the gains of its study and of a file."""
    values = {"study": one["study"], "given": one["given"]}
    refused = f" ({refused_text(one['refused'])})" if one["refused"] else ""
    return metric_table(values, title=f"{one['loop']}, {one['file']}{refused}")


def _of_verdict(rows: Sequence[Row], verdict: str) -> ResultTable:
    chosen = [row for row in rows if row["verdict"] == verdict]
    return claims(chosen)._replace(title=f"{TITLES[verdict]}: {len(chosen)}")


def _difference(share: float | None) -> str:
    if share is None:
        return DASH
    return f"{share:+.1%}" if abs(share) < 10 else f"{share:+.2g}".replace("e+0", "e") + " x"


def _texts(name: str) -> dict[str, str]:
    """Picture -> how to read it, from the plots of the study."""
    texts = {
        "claims": "All claims that can be checked: a dot is our number over the published one, 1 "
        "is equal; the colour is the verdict."
    }
    for study in known_studies():
        for plot in study.plots if study.name == name else ():
            if isinstance(plot, ChartPlot):
                texts[plot.name] = f"{plot.title}. {plot.text}"
            else:
                for view in plot.views:
                    texts[f"{plot.name}-{view}"] = f"{plot.text}. {run.TEXTS[view]}"
    return texts
