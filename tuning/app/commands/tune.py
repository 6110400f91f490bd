"""``jaxstage tune``: better gains by gradients."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tuning.app.shared_options import AsJson, Loop, Settings, picked

if TYPE_CHECKING:
    from tuning.tuner.configuration import TuningPlan
    from tuning.tuner.pictures import BeforeAfter
    from tuning.tuner.report import Extras
    from tuning.tuner.session import TuningResult


@dataclass(frozen=True)
class TuneOptions:
    """What ``jaxstage tune`` takes."""

    loop: Loop
    gains: Annotated[
        list[str],
        typer.Option(
            metavar="NAMES|FILE",
            help="Which gains: names (path, symbol, part) to tune, e.g. 'c1=0.1..10,eta:tied'; a "
            "word that ends in .toml is a file of values to start from. Repeatable. The study's "
            "choice if no names are given.",
        ),
    ] = field(default_factory=list)
    objective: Annotated[
        str | None,
        typer.Option(help='Sum of weight * metric / scale: "contour_rms_um + 0.1*energy_J".'),
    ] = None
    goals: Annotated[
        list[str],
        typer.Option(
            "--goal", help='What every training run must meet: "contour_max_um < 20". Repeatable.'
        ),
    ] = field(default_factory=list)
    risk: Annotated[
        str, typer.Option(help="Over the training runs: mean, worst, or cvar (worst quarter).")
    ] = "mean"
    margin: Annotated[
        float,
        typer.Option(help="Gain margin: trains with 1 -+ this share of the command, too."),
    ] = 0.5
    surrogate: Annotated[
        str, typer.Option(help="none, or creeping: searches with friction that creeps.")
    ] = "none"
    train: Annotated[Path | None, typer.Option(help="TOML file of training and held-out runs.")] = (
        None
    )
    worst_case: Annotated[
        int, typer.Option(help="Rounds that add the worst of 64 other plants and go on.")
    ] = 0
    method: Annotated[str, typer.Option(help="auto, lm, lbfgs, adam, cma or random.")] = "auto"
    starts: Annotated[int, typer.Option(help="Starting points; the first are the gains now.")] = 2
    budget: Annotated[
        float, typer.Option(help="At most so many units: simulations of the whole training set.")
    ] = 2000.0
    pareto: Annotated[
        bool, typer.Option("--pareto", help="Trade-offs of error, energy and chattering, too.")
    ] = False
    baseline: Annotated[
        str | None, typer.Option(help="Other methods at equal cost, e.g. cma,random.")
    ] = None
    out: Annotated[
        Path | None, typer.Option(help="Folder: gains.toml, history, pictures, verdict.")
    ] = None
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the tuning in --out.")] = (
        False
    )
    scenario: Annotated[
        Path | None, typer.Option(help="TOML file: values, [[spread]], [blocks], as for sweep.")
    ] = None
    words: Settings = field(default_factory=list)
    seed: Annotated[int, typer.Option(help="Of the plants and of the search.")] = 0
    as_json: AsJson = False


def tune(options: TuneOptions) -> None:
    """Better gains by gradients, proven on plants not seen."""
    from jaxstage.system.runtime import configure, cpu_cores
    from tuning.store.prepare import check_folder
    from tuning.tuner.baselines import parse_methods

    out = options.out
    if options.resume and out is None:
        raise ValueError("--resume needs --out DIR: where the tuning was kept")
    methods = parse_methods(options.baseline) if options.baseline is not None else ()
    if out is not None:
        check_folder(out)
    configure(precision="double", cores=cpu_cores(), cache="default")
    from tuning.store import work_folder
    from tuning.tuner import configuration

    text = configuration.configure_tuning(picked(options, configuration.TuningRequest))
    if out is not None:
        work_folder.create(out, configuration.KIND, text, options.resume)
    with work_folder.locked(out, "tuning"):
        _tune(configuration.build(text), methods, options)


def _tune(plan: "TuningPlan", methods: tuple[str, ...], options: TuneOptions) -> None:
    """Tune and test, then write and print what came out."""
    from tuning.app import tune_display
    from tuning.app.messages import print_json
    from tuning.tuner import report
    from tuning.tuner.pictures import pictures, write_rules

    out = options.out
    outcome, extras, pair = _search(plan, methods, options)
    answer = report.as_object(outcome, extras)
    names = []
    if out is not None:
        report.write_files(out, outcome, extras, answer)
        write_rules(out, pair)
        names = [file.name for file in pictures(out, outcome, extras, pair)]
    if options.as_json:
        print_json(answer)
        return
    tune_display.show(answer)
    if out is not None:
        print(f"{tune_display.files_text(answer, names)}: {out}/")


def _search(
    plan: "TuningPlan", methods: tuple[str, ...], options: TuneOptions
) -> "tuple[TuningResult, Extras, BeforeAfter]":
    """The tuning and all that was asked for beside it, with a bar on standard error."""
    from jaxstage.system.files import goes_on
    from tuning.app import tune_display
    from tuning.tuner import baselines, report
    from tuning.tuner.pareto import pareto, trade_off_columns
    from tuning.tuner.pictures import simulate_before_after
    from tuning.tuner.session import run_tuning

    out = options.out
    if options.pareto:
        trade_off_columns(plan)
    try:
        with tune_display.bar(plan.table["budget"]) as watch:
            outcome = run_tuning(plan, out, watch)
            watch.stage("other methods" if methods else "")
            others = baselines.run_baselines(outcome, methods, out)
            watch.stage("trade-offs" if options.pareto else "")
            front = pareto(outcome, plan.table["budget"], out) if options.pareto else None
            watch.stage("the loop itself, before and after")
            before, after = outcome.problem.space.gains, outcome.chosen.gains
            pair = simulate_before_after(plan.case, before, after, recorded=out is not None)
    except KeyboardInterrupt:
        if out is None:
            raise
        raise InterruptedError("every evaluation is kept, --resume goes on") from None
    except OSError as error:
        raise goes_on(error, "every evaluation is kept, --resume goes on") from None
    return outcome, report.Extras(*pair.metrics(), others, front), pair
