"""A study's claims against this simulation: as an object, as text, as pictures."""

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import jax
from rich.console import Console
from rich.table import Table

from jaxstage import __version__
from jaxstage.metrics import record, together
from jaxstage.metrics.table import split_key
from jaxstage.model.settings import nearest_name
from jaxstage.studies import Comparison, Study, known_studies, with_metric
from jaxstage.studies.claim import count
from jaxstage.studies.comparison import stored_verdicts
from jaxstage.studies.experiment import measure
from jaxstage.studies.plots import ChartPlot, RunPlot
from jaxstage.system.files import write_text
from jaxstage.system.runtime import cpu_cores
from tuning.store.gains_file import read_gains, refused_text
from tuning.store.prepare import prepare

COLOURS = {"holds": "green", "fails": "red", "unchecked": "dim"}


def find_study(name: str) -> Study:
    """The study with claims called ``name``. Raises ValueError with the nearest known name."""
    studies = {study.name: study for study in known_studies() if study.claims}
    if name not in studies:
        its = [s for s in studies.values() for loop in s.loops if loop.name == name]
        if its:
            raise ValueError(f"'{name}' is a loop: `jaxstage compare {its[0].name}` has its study")
        hint = nearest_name(name, studies)
        raise ValueError(f"unknown study '{name}'{hint} (there are {', '.join(studies)})")
    return studies[name]


class OtherGains(NamedTuple):
    """A loop with the gains of its study and with those of a file: the scored figures of both.

    refused: why the tuning that gave the file did not accept its gains."""

    loop: str
    file: str
    study: dict[str, Any]
    given: dict[str, Any]
    refused: tuple[str, ...]


def gains_files(study: Study, words: Sequence[str]) -> dict[str, Path]:
    """Loop -> file of ``LOOP=FILE`` words. Raises ValueError for a loop of no or another study."""
    names = [entry.name for entry in study.loops]
    found: dict[str, Path] = {}
    for word in words:
        loop, equals, file = word.partition("=")
        if not equals or not file:
            raise ValueError(f"--gains {word}: must be LOOP=FILE")
        if loop not in names:
            raise ValueError(
                f"--gains {word}: {study.name} has no such loop{nearest_name(loop, names)}"
            )
        found[loop] = Path(file)
    return found


def other_gains(given: Mapping[str, Path], words: Sequence[str] = ()) -> tuple[OtherGains, ...]:
    """Simulate loops with the gains of their study and of files. words: as for ``--set``."""
    cases, gains = {}, {}
    for loop, file in given.items():
        cases[f"{loop}/study"] = prepare(loop, words).case
        gains[loop] = read_gains(file)
        cases[f"{loop}/given"] = prepare(loop, words, gains[loop]).case
    found = measure(cases)
    return tuple(
        OtherGains(
            loop, str(file), found[f"{loop}/study"], found[f"{loop}/given"], gains[loop].refused
        )
        for loop, file in given.items()
    )


def as_object(compared: Comparison, others: Sequence[OtherGains] = ()) -> dict[str, Any]:
    """The object that ``--json`` prints."""
    return {
        "study": compared.study.name,
        "source": compared.study.source,
        "version": __version__,
        "jax": jax.__version__,
        "counts": count(compared.claims),
        "claims": [judgement._asdict() for judgement in compared.claims],
        "changed": changed(compared),
        "gains": [one._asdict() for one in others],
    }


def changed(compared: Comparison) -> list[str]:
    """Claims whose verdict is not the one stored with the study."""
    stored = stored_verdicts(compared.study)
    return [j.id for j in compared.claims if stored.get(j.id) != j.verdict]


def show_gains(others: Sequence[OtherGains]) -> None:
    """Print the figures of each loop with the gains of the study and of the file."""
    for one in others:
        table = Table(box=None, padding=(0, 2), header_style="bold")
        refused = f" ({refused_text(one.refused)})" if one.refused else ""
        table.add_column(f"{one.loop}, {one.file}{refused}")
        for name in ("study", "given"):
            table.add_column(name, justify="right", no_wrap=True)
        table.add_column("")
        for name, first in one.study.items():
            second, (shown, unit) = one.given.get(name), split_key(name)
            for axis in first if isinstance(first, dict) else ("",):
                pair = [v[axis] if isinstance(v, dict) else v for v in (first, second)]
                table.add_row(f"{shown} {axis}".strip(), *map(_number, pair), unit)
        Console(highlight=False).print(table)


def show(compared: Comparison, width: int | None = None) -> None:
    """Print every claim with both figures, their difference, the verdict and its reason."""
    console = Console(highlight=False, width=width)
    console.print(f"[bold]{compared.study.name}[/bold]  {compared.study.title}")
    console.print(compared.study.source)
    table = Table(box=None, padding=(0, 1), header_style="bold")
    for name in ("where", "claim"):
        table.add_column(name, ratio=2 if name == "where" else 5, overflow="fold")
    for name in ("published", "ours", "unit", "difference"):
        table.add_column(name, justify="left" if name == "unit" else "right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    table.add_column("reason", ratio=5, overflow="fold")
    for j in compared.claims:
        table.add_row(
            j.where, j.text, _number(j.published), _number(j.ours), j.unit,
            _difference(j.difference), f"[{COLOURS[j.verdict]}]{j.verdict}[/]", j.reason,
        )  # fmt: skip
    console.print(table)
    numbers = count(compared.claims)
    console.print(", ".join(f"{n} {verdict}" for verdict, n in numbers.items()))
    if changed(compared):
        console.print(f"not as stored with the study: {', '.join(changed(compared))}")


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"


def _difference(share: float | None) -> str:
    if share is None:
        return ""
    return f"{share:+.1%}" if abs(share) < 10 else f"{share:+.2g}".replace("e+0", "e") + " x"


def draw(compared: Comparison, folder: Path, others: Sequence[OtherGains] = ()) -> list[Path]:
    """Write claims.png, the study's plots and compare.json; returns the files."""
    from jaxstage import plot

    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / "claims.png"]
    plot.save(plot.claims(compared.study.title, compared.claims), files[0])
    plots = compared.study.plots
    with ThreadPoolExecutor(cpu_cores()) as pool:
        views = pool.map(_view, [d for d in plots if isinstance(d, RunPlot)])
    for planned in plots:
        if isinstance(planned, ChartPlot):
            file = folder / f"{planned.name}.png"
            panels = planned.charts(compared.evidence)
            plot.save(plot.chart(planned.title, planned.text, panels), file)
            files.append(file)
        else:
            files += _draw_run(planned, next(views), folder)
    write_text(folder / "compare.json", json.dumps(as_object(compared, others), indent=2) + "\n")
    return files


def _view(planned: RunPlot) -> Any:
    """The recorded run of a plot."""
    from jaxstage import plot

    with jax.enable_x64(True):  # a setting of the thread
        case = planned.case()
        run = with_metric(case, together(case.loop.metric, record)).simulate()
        shown = plot.view(case, run.report["scored"], run.rows["record"])
    return shown._replace(name=planned.text)


def _draw_run(planned: RunPlot, view: Any, folder: Path) -> list[Path]:
    from jaxstage import plot

    files = []
    for name in planned.views:
        file = folder / f"{planned.name}-{name}.png"
        plot.save(plot.VIEWS[name](view), file)
        files.append(file)
    return files
