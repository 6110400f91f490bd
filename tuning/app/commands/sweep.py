"""``jaxstage sweep``: Monte-Carlo robustness."""

import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tuning.app import completion
from tuning.app.shared_options import AsJson, Precision, Settings, picked

if TYPE_CHECKING:
    from tuning.sweeps.analysis import Analysis, Question
    from tuning.sweeps.configuration import SweepPlan

#: what a configuration holds: not to be given again where a stored one is taken
_STORED = {
    "runs": "-n",
    "design": "--design",
    "seed": "--seed",
    "chunk": "--chunk",
    "gains": "--gains",
    "scenario": "--scenario",
    "words": "--set",
    "precision": "--precision",
}


@dataclass(frozen=True)
class SweepOptions:
    """What ``jaxstage sweep`` takes."""

    context: typer.Context
    loops: Annotated[
        list[str],
        typer.Argument(
            help="Loops of `jaxstage list`, each on the same plants.",
            autocompletion=completion.loops,
        ),
    ] = field(default_factory=list)
    runs: Annotated[int, typer.Option("-n", "--runs", help="Plants to draw.")] = 1024
    design: Annotated[
        str, typer.Option(help="sobol, lhs, random, corners, or saltelli for Sobol indices.")
    ] = "sobol"
    spec: Annotated[
        str | None,
        typer.Option(help='What a run must meet: "contour_max_um < 20 and finite".'),
    ] = None
    target: Annotated[
        float | None, typer.Option(help="Claimed share of runs that meet it, e.g. 0.99.")
    ] = None
    metric: Annotated[
        str | None, typer.Option(help="Column to judge; the first of --spec if left out.")
    ] = None
    out: Annotated[Path | None, typer.Option(help="Folder of the sweep.")] = None
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the sweep in --out; loops may be left out.")
    ] = False
    scenario: Annotated[
        Path | None, typer.Option(help="TOML file: values, [[spread]], [[correlation]], [blocks].")
    ] = None
    gains: Annotated[
        list[str],
        typer.Option(metavar="[LOOP=]FILE", help="TOML file of gains. Repeatable."),
    ] = field(default_factory=list)
    words: Settings = field(default_factory=list)
    seed: Annotated[int, typer.Option(help="Of the draws.")] = 0
    chunk: Annotated[int, typer.Option(help="Most runs of one file of results.")] = 1024
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler: its workers compute.")
    ] = None
    workers: Annotated[
        int | None, typer.Option(help="Worker processes on this machine, by Dask.")
    ] = None
    cores: Annotated[
        int | None, typer.Option(help="Cores of each worker; all it may use if left out.")
    ] = None
    precision: Precision = "double"
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Single precision also where it is off by over 1 %; over a day of work."
        ),
    ] = False
    tornado: Annotated[
        bool, typer.Option("--tornado", help="First-order effects, from one gradient a loop.")
    ] = False
    as_json: AsJson = False


def sweep(options: SweepOptions) -> None:
    """Monte-Carlo robustness: the yield over many plants."""
    from tuning.store.prepare import check_folder
    from tuning.sweeps import store

    if options.out is None:
        raise ValueError("--out DIR is needed: it keeps the runs")
    check_folder(options.out)
    stored = None
    if options.resume and not options.loops:
        stored = store.read_configuration(options.out)
        _refuse_given(options.context)
    _start_jax(options, stored)
    from tuning.sweeps.analysis import Question, analyse, criteria
    from tuning.sweeps.configuration import build

    question = Question(options.spec, options.metric, options.target, options.tornado)
    text = stored or _configure(options, question)
    plan = build(text)
    metric = criteria(plan, question).metric
    with _executor(options.scheduler, options.workers) as executor:
        store.create(options.out, text, options.resume)
        simulated = _simulate(plan, options, metric, executor)
    _report(analyse(options.out, plan, question), options, simulated)


def _start_jax(options: SweepOptions, stored: str | None) -> None:
    """Precision and devices, before JAX computes anything."""
    from jaxstage.system.runtime import configure, cpu_cores
    from tuning.store.prepare import refuse_rough
    from tuning.sweeps.configuration import precision_of

    if options.cores is not None and options.cores < 1:
        raise ValueError(f"--cores {options.cores}: must be >= 1")
    precision = precision_of(stored) if stored else options.precision
    configure(precision=precision, cores=options.cores or cpu_cores(), cache="default")
    if precision == "single" and not options.force and stored is None:
        for loop in options.loops:
            refuse_rough(loop, options.words)


def _configure(options: SweepOptions, question: "Question") -> str:
    """The configuration that the options ask for; questions are checked before any draw."""
    from jaxstage.system.runtime import cpu_cores
    from tuning.app.limits import refuse_unbounded
    from tuning.sweeps.analysis import criteria
    from tuning.sweeps.configuration import SweepRequest, configure_sweep

    def check(plan: "SweepPlan") -> None:
        criteria(plan, question)
        if not options.force:
            refuse_unbounded(plan, options.cores or cpu_cores())

    gains = _gains(options.loops, options.gains)
    return configure_sweep(picked(options, SweepRequest)._replace(gains=gains), check)


def _refuse_given(context: typer.Context) -> None:
    """Nothing that the stored configuration decides may be given beside it."""
    for name, option in _STORED.items():
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise ValueError(
                f"{option}: --resume without loops takes the stored configuration; name the loops "
                "to compare with it"
            )


def _gains(loops: list[str], words: list[str]) -> dict[str, Path]:
    """Loop -> file of gains; a file without a loop is that of the only one."""
    files: dict[str, Path] = {}
    for word in words:
        loop, equals, file = word.partition("=")
        if not equals:
            if len(loops) != 1:
                raise ValueError(f"--gains {word}: write LOOP=FILE where there are several loops")
            loop, file = loops[0], word
        if loop not in loops:
            raise ValueError(f"--gains {word}: {loop} is not swept")
        if loop in files:
            raise ValueError(f"--gains {word}: {loop} has {files[loop]} already")
        files[loop] = Path(file)
    return files


@contextmanager
def _executor(scheduler: str | None, workers: int | None) -> Iterator[Executor | None]:
    from tuning.sweeps.cluster import local_workers, scheduler_at

    if scheduler is not None and workers is not None:
        raise ValueError("--scheduler and --workers: give one of them")
    if scheduler is not None:
        with scheduler_at(scheduler) as executor:
            yield executor
    elif workers is not None:
        with local_workers(workers) as executor:
            yield executor
    else:
        yield None


def _simulate(
    plan: "SweepPlan", options: SweepOptions, metric: str, executor: Executor | None
) -> dict[str, Any]:
    """Run what is missing, with a bar on standard error; returns how many runs that was."""
    from jaxstage.system.files import goes_on
    from jaxstage.system.runtime import cpu_cores
    from tuning.app.sweep_display import bar
    from tuning.sweeps import store
    from tuning.sweeps.sweep import sweep as run_sweep

    assert options.out is not None
    cores = options.cores or (max(1, cpu_cores() // options.workers) if options.workers else 0)
    total, begin = plan.table["runs"] * len(plan.cases), time.perf_counter()
    try:
        there = store.present(options.out, plan)
        kept = store.read(options.out, plan, ["finite", metric]) if there else None
        with bar(metric, total, kept) as watch:
            runs = run_sweep(plan.text, options.out, executor, watch, cores if executor else None)
    except KeyboardInterrupt:
        raise InterruptedError("finished chunks are kept, --resume goes on") from None
    except OSError as error:
        raise goes_on(error, "finished chunks are kept, --resume goes on") from None
    return {"simulated": runs, "seconds": time.perf_counter() - begin}


def _report(analysis: "Analysis", options: SweepOptions, simulated: dict[str, Any]) -> None:
    """Write summary.json and the pictures, print the answers."""
    from jaxstage.system.files import write_text
    from tuning.app.messages import json_text, print_json
    from tuning.app.sweep_display import show
    from tuning.sweeps.pictures import pictures
    from tuning.sweeps.summary import as_object

    assert options.out is not None
    answer = as_object(analysis, options.out) | simulated
    write_text(options.out / "summary.json", json_text(answer))
    files = pictures(analysis, options.out)
    if options.as_json:
        print_json(answer)
        return
    show(answer)
    print(f"{', '.join(file.name for file in files)}, summary.json: {options.out}/")
