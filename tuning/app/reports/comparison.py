"""The report of a comparison with a paper: the folder that ``jaxstage compare --out`` leaves."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxstage.studies import known_studies
from jaxstage.studies.plots import ChartPlot
from tuning.app.reports import single
from tuning.app.reports.page import Page, Table, number, pictures

#: verdict -> title of its table, in this order
TITLES = {"fails": "Claims that fail", "holds": "Claims that hold",
          "unchecked": "Claims that cannot be checked"}  # fmt: skip


def read(folder: Path) -> Page:
    """The page of a folder with ``compare.json``."""
    found = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    counts, changed = found["counts"], found["changed"]
    told = (
        f"Not as stored with the study: {', '.join(changed)}." if changed
        else "Every verdict is the one that is stored with the study."
    )  # fmt: skip
    return Page(
        title=found["study"],
        subtitle=found["source"],
        good=None,
        verdict=(
            f"{counts['holds']} claims of the paper hold, {counts['fails']} fail, "
            f"{counts['unchecked']} cannot be checked by simulation.",
            told,
        ),
        facts={},
        tables=(),
        details=tuple(_table(found["claims"], verdict) for verdict in TITLES),
        pictures=pictures(folder, _texts(found["study"])),
        files={},
        settings={"versions": f"jaxstage {found['version']}, jax {found['jax']}",
                  "precision": "double"},
    )  # fmt: skip


def _table(claims: list[Mapping[str, Any]], verdict: str) -> Table:
    rows = tuple(
        (c["where"], c["text"], number(c["published"]), number(c["ours"]), c["unit"],
         _difference(c["difference"]), c["reason"])
        for c in claims
        if c["verdict"] == verdict
    )  # fmt: skip
    return Table(
        title=f"{TITLES[verdict]}: {len(rows)}",
        head=("where", "claim", "published", "ours", "unit", "difference", "reason"),
        rows=rows,
        note="A dash: only words are printed, or there is nothing to compute.",
        numeric=(2, 3, 5),
    )


def _difference(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:+.3g} %"


def _texts(name: str) -> dict[str, str]:
    """Picture -> how to read it, from the plots of the study."""
    texts = {
        "claims": "All claims that can be checked: a dot is our figure over the published one, 1 "
        "is equal; the colour is the verdict."
    }
    for study in known_studies():
        for plot in study.plots if study.name == name else ():
            if isinstance(plot, ChartPlot):
                texts[plot.name] = f"{plot.title}. {plot.text}"
            else:
                for view in plot.views:
                    texts[f"{plot.name}-{view}"] = f"{plot.text}. {single.TEXTS[view]}"
    return texts
