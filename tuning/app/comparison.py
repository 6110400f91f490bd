"""A study's claims against this simulation: as an object, as text, as pictures."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import jax

from jaxstage import __version__
from jaxstage.metrics import record, together
from jaxstage.model.settings import nearest_name
from jaxstage.studies import Comparison, Study, known_studies, with_metric
from jaxstage.studies.claim import count
from jaxstage.studies.comparison import stored_verdicts
from jaxstage.studies.experiment import measure
from jaxstage.studies.plots import ChartPlot, RunPlot
from jaxstage.system.files import write_text
from jaxstage.system.runtime import cpu_cores
from tuning.app.messages import json_text
from tuning.app.reports.comparison import claims, gains
from tuning.app.result_table import Row, objects, say
from tuning.app.result_table import show as show_table
from tuning.store.gains_file import read_gains
from tuning.store.prepare import prepare


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
    """A loop with the gains of its study and with those of a file: the scored metrics of both.

    refused: why the tuning that gave the file did not accept its gains."""

    loop: str
    file: str
    study: dict[str, Any]
    given: dict[str, Any]
    refused: tuple[str, ...]


def gains_files(study: Study, words: Sequence[str]) -> dict[str, Path]:
    """Loop -> file of ``LOOP=FILE`` words. Raises ValueError for a loop of no or another study."""
    names = [entry.name for entry in study.loops]
    files: dict[str, Path] = {}
    for word in words:
        loop, equals, file = word.partition("=")
        if not equals or not file:
            raise ValueError(f"--gains {word}: must be LOOP=FILE")
        if loop not in names:
            raise ValueError(
                f"--gains {word}: {study.name} has no such loop{nearest_name(loop, names)}"
            )
        files[loop] = Path(file)
    return files


def other_gains(given: Mapping[str, Path], words: Sequence[str] = ()) -> tuple[OtherGains, ...]:
    """Simulate loops with the gains of their study and of files. words: as for ``--set``."""
    cases, files = {}, {}
    for loop, file in given.items():
        cases[f"{loop}/study"] = prepare(loop, words).case
        files[loop] = read_gains(file)
        cases[f"{loop}/given"] = prepare(loop, words, files[loop]).case
    metrics = measure(cases)
    return tuple(
        OtherGains(
            loop, str(file), metrics[f"{loop}/study"], metrics[f"{loop}/given"], files[loop].refused
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
        "claims": objects(claims([judgement._asdict() for judgement in compared.claims])),
        "changed": changed(compared),
        "gains": [one._asdict() for one in others],
    }


def changed(compared: Comparison) -> list[str]:
    """Claims whose verdict is not the one stored with the study."""
    stored = stored_verdicts(compared.study)
    return [j.id for j in compared.claims if stored.get(j.id) != j.verdict]


def show(study: Study, answer: Row) -> None:
    """Print every claim, and the metrics of loops with other gains."""
    say(f"{study.name}  {study.title}", "bold")
    say(study.source)
    show_table(claims(answer["claims"]))
    say(", ".join(f"{n} {verdict}" for verdict, n in answer["counts"].items()))
    if answer["changed"]:
        say(f"not as stored with the study: {', '.join(answer['changed'])}")
    for one in answer["gains"]:
        table = gains(one)
        say(table.title, "bold")
        show_table(table)


def draw(compared: Comparison, folder: Path, answer: Row) -> list[Path]:
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
    write_text(folder / "compare.json", json_text(answer))
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
