"""``jaxstage sweep`` and ``jaxstage replay``."""

import json
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from tuning.app import completion

#: what a configuration holds: not to be given again where a stored one is taken
_STORED = {
    "runs": "-n", "design": "--design", "seed": "--seed", "chunk": "--chunk", "gains": "--gains",
    "scenario": "--scenario", "set_": "--set", "precision": "--precision",
}  # fmt: skip


def sweep(
    context: typer.Context,
    loops: Annotated[
        list[str] | None,
        typer.Argument(
            help="Loops of `jaxstage list`, each on the same plants.",
            autocompletion=completion.loops,
        ),
    ] = None,
    runs: Annotated[int, typer.Option("-n", "--runs", help="Plants to draw.")] = 1024,
    design: Annotated[
        str, typer.Option(help="sobol, lhs, random, corners, or saltelli for Sobol indices.")
    ] = "sobol",
    spec: Annotated[
        str | None,
        typer.Option(help='What a run must meet: "contour_max_um < 20 and finite".'),
    ] = None,
    target: Annotated[
        float | None, typer.Option(help="Claimed share of runs that meet it, e.g. 0.99.")
    ] = None,
    metric: Annotated[
        str | None, typer.Option(help="Column to judge; the first of --spec if left out.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the sweep.")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the sweep in --out; loops may be left out.")
    ] = False,
    scenario: Annotated[
        Path | None, typer.Option(help="TOML file: values, [[spread]], [[correlation]], [blocks].")
    ] = None,
    gains: Annotated[
        list[str] | None,
        typer.Option(metavar="[LOOP=]FILE", help="TOML file of gains. Repeatable."),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="As for `jaxstage run`. Repeatable."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the draws.")] = 0,
    chunk: Annotated[int, typer.Option(help="Most runs of one file of results.")] = 1024,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler: its workers compute.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Worker processes on this machine, by Dask.")
    ] = None,
    cores: Annotated[
        int | None, typer.Option(help="Cores of each worker; all it may use if left out.")
    ] = None,
    precision: Annotated[str, typer.Option(help="double or single.")] = "double",
    force: Annotated[
        bool, typer.Option("--force", help="Single precision also where it is off by over 1 %.")
    ] = False,
    tornado: Annotated[
        bool, typer.Option("--tornado", help="First-order effects, from one gradient a loop.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Monte-Carlo robustness: the yield over many plants."""
    from jaxstage.system.runtime import configure, cpu_cores
    from tuning.store import prepare as single_runs
    from tuning.sweeps import configuration, store

    if out is None:
        raise ValueError("--out DIR is needed: it keeps the runs")
    single_runs.check_folder(out)
    taken = store.read_configuration(out) if resume and not loops else None
    if taken is not None:
        _refuse_given(context)
        precision = configuration.precision_of(taken)
    if cores is not None and cores < 1:
        raise ValueError(f"--cores {cores}: must be >= 1")
    configure(precision=precision, cores=cores or cpu_cores(), cache="default")
    if precision == "single" and not force and taken is None:
        for loop in loops or []:
            single_runs.refuse_rough(loop)
    text = taken or configuration.configure_sweep(
        configuration.SweepRequest(
            loops=tuple(loops or ()), runs=runs, design=design, seed=seed, chunk=chunk,
            precision=precision, words=tuple(set_ or ()), gains=_gains(loops or [], gains or []),
            scenario=scenario,
        )
    )  # fmt: skip
    from tuning.sweeps.analysis import Question, analyse, understood

    question = Question(spec, metric, target, tornado)
    plan = configuration.build(text)
    _, judged = understood(plan, question)
    each = cores or (max(1, cpu_cores() // workers) if workers else 0)
    with _executor(scheduler, workers) as executor:
        store.create(out, text, resume)
        extra = _simulate(plan, out, judged, executor, each)
    _tell(analyse(out, plan, question), out, as_json, extra)


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
    found: dict[str, Path] = {}
    for word in words:
        loop, equals, file = word.partition("=")
        if not equals:
            if len(loops) != 1:
                raise ValueError(f"--gains {word}: write LOOP=FILE where there are several loops")
            loop, file = loops[0], word
        if loop not in loops:
            raise ValueError(f"--gains {word}: {loop} is not swept")
        if loop in found:
            raise ValueError(f"--gains {word}: {loop} has {found[loop]} already")
        found[loop] = Path(file)
    return found


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
    plan: Any, out: Path, metric: str, executor: Executor | None, cores: int
) -> dict[str, Any]:
    """Run what is missing, with a bar on standard error; returns how many runs that was."""
    from jaxstage.system.files import goes_on
    from tuning.app.sweep_display import bar
    from tuning.sweeps import store
    from tuning.sweeps.sweep import sweep as run_sweep

    total, begin = plan.table["runs"] * len(plan.cases), time.perf_counter()
    try:
        kept = store.read(out, plan, ["finite", metric]) if store.present(out, plan) else None
        with bar(metric, total, kept) as watch:
            runs = run_sweep(plan.text, out, executor, watch, cores if executor else None)
    except KeyboardInterrupt:
        raise InterruptedError("finished chunks are kept, --resume goes on") from None
    except OSError as error:
        raise goes_on(error, "finished chunks are kept, --resume goes on") from None
    return {"simulated": runs, "seconds": time.perf_counter() - begin}


def _tell(found: Any, out: Path, as_json: bool, extra: dict[str, Any]) -> None:
    from jaxstage.system.files import write_text
    from tuning.app.sweep_display import show
    from tuning.sweeps.pictures import pictures
    from tuning.sweeps.summary import as_object

    answer = as_object(found, out) | extra
    write_text(out / "summary.json", json.dumps(answer, indent=2, allow_nan=False) + "\n")
    files = pictures(found, out)
    if as_json:
        print(json.dumps(answer, indent=2, allow_nan=False))
        return
    show(found, answer)
    print(f"{', '.join(file.name for file in files)}, summary.json: {out}/")


def replay(
    folder: Annotated[Path, typer.Argument(help="Folder of a sweep.")],
    run: Annotated[int | None, typer.Option(help="Number of the run.")] = None,
    worst: Annotated[int | None, typer.Option(help="The so many worst runs.")] = None,
    loop: Annotated[str | None, typer.Option(help="Only this loop of the sweep.")] = None,
    metric: Annotated[str | None, typer.Option(help="What --worst goes by.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for pictures, gains.toml, scenario.toml a run.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Plants of a sweep again, held against their rows."""
    from jaxstage.system.runtime import configure
    from tuning.store import prepare as runs
    from tuning.sweeps import configuration, replays, store

    text = store.read_configuration(folder)
    if (run is None) == (worst is None):
        raise ValueError("give --run ID or --worst K")
    if out is not None:
        runs.check_folder(out)
    configure(
        precision=configuration.precision_of(text), cores=replays.stored_devices(folder),
        cache="default",
    )  # fmt: skip
    plan = configuration.build(text)
    chosen = replays.choose(folder, plan, run, worst, loop, metric)
    found = [row for number, ids in chosen for row in replays.replay(folder, plan, number, ids)]
    if out is not None:
        for number, ids in chosen:
            for one in ids:
                name = plan.table["loop"][number]["name"]
                replays.draw_run(plan, number, one, out / f"{name}-run-{one}")
    if as_json:
        print(json.dumps({"sweep": str(folder), "runs": found}, indent=2, allow_nan=False))
        return
    from tuning.app.sweep_display import show_replayed

    show_replayed(found, out)
