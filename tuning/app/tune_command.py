"""``jaxstage tune``."""

import json
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer


def tune(
    loop: Annotated[str, typer.Argument(help="A loop of `jaxstage list`, e.g. dfcmac-circle.")],
    gains: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAMES|FILE",
            help="Which gains: names (path, symbol, part) to tune, e.g. 'c1=0.1..10,eta:tied'; a "
            "word that ends in .toml is a file of values to start from. Repeatable. The study's "
            "choice if no names are given.",
        ),
    ] = None,
    objective: Annotated[
        str | None,
        typer.Option(help='Sum of weight * figure / scale: "contour_rms_um + 0.1*energy_J".'),
    ] = None,
    goal: Annotated[
        list[str] | None,
        typer.Option(help='What every training run must meet: "contour_max_um < 20". Repeatable.'),
    ] = None,
    risk: Annotated[
        str, typer.Option(help="Over the training runs: mean, worst, or cvar (worst quarter).")
    ] = "mean",
    margin: Annotated[
        float,
        typer.Option(help="Gain margin: trains with 1 -+ this share of the command, too."),
    ] = 0.5,
    surrogate: Annotated[
        str, typer.Option(help="none, or creeping: searches with friction that creeps.")
    ] = "none",
    train: Annotated[
        Path | None, typer.Option(help="TOML file of training and held-out runs.")
    ] = None,
    worst_case: Annotated[
        int, typer.Option(help="Rounds that add the worst of 64 other plants and go on.")
    ] = 0,
    method: Annotated[str, typer.Option(help="auto, lm, lbfgs, adam, cma or random.")] = "auto",
    starts: Annotated[int, typer.Option(help="Starting points; the first are the gains now.")] = 2,
    budget: Annotated[
        float, typer.Option(help="At most so many units: simulations of the whole training set.")
    ] = 2000.0,
    pareto: Annotated[
        bool, typer.Option("--pareto", help="Trade-offs of error, energy and chattering, too.")
    ] = False,
    baseline: Annotated[
        str | None, typer.Option(help="Other methods at equal cost, e.g. cma,random.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder: gains.toml, history, pictures, verdict.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the tuning in --out.")
    ] = False,
    scenario: Annotated[
        Path | None, typer.Option(help="TOML file: values, [[spread]], [blocks], as for sweep.")
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="As for `jaxstage run`. Repeatable."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the plants and of the search.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Better gains by gradients, proven on plants not seen."""
    from jaxstage.system.runtime import configure, cpu_cores
    from tuning.store import prepare as runs
    from tuning.tuner.baselines import parse_methods

    if resume and out is None:
        raise ValueError("--resume needs --out DIR: where the tuning was kept")
    methods = parse_methods(baseline) if baseline is not None else ()
    if out is not None:
        runs.check_folder(out)
    configure(precision="double", cores=cpu_cores(), cache="default")
    from tuning.store import work_folder as folders
    from tuning.tuner import configuration

    text = configuration.configure_tuning(
        configuration.TuningRequest(
            loop=loop, words=tuple(set_ or ()), gains=tuple(gains or ()), scenario=scenario,
            objective=objective, goals=tuple(goal or ()), risk=risk, margin=margin,
            surrogate=surrogate, train=train, method=method, starts=starts, budget=budget,
            worst_case=worst_case, seed=seed,
        )
    )  # fmt: skip
    if out is not None:
        folders.create(out, configuration.KIND, text, resume)
    kept = folders.locked(out, configuration.KIND, "tuning") if out else nullcontext()
    with kept:
        _tune(configuration.build(text), out, methods, pareto, as_json)


def _tune(
    plan: Any, out: Path | None, methods: tuple[str, ...], pareto: bool, as_json: bool
) -> None:
    from jaxstage.system.files import goes_on
    from tuning.app import tune_display as display
    from tuning.tuner import baselines, report
    from tuning.tuner import pareto as trade_offs
    from tuning.tuner.pictures import pictures, simulate_before_after, write_rules
    from tuning.tuner.session import run_tuning

    if pareto:
        trade_offs.trade_off_columns(plan)
    try:
        with display.bar(plan.table["budget"]) as watch:
            outcome = run_tuning(plan, out, watch)
            watch.stage("other methods" if methods else "")
            others = baselines.run_baselines(outcome, methods, out)
            watch.stage("trade-offs" if pareto else "")
            front = trade_offs.pareto(outcome, plan.table["budget"], out) if pareto else None
            watch.stage("the loop itself, before and after")
            before, after = outcome.problem.space.gains, outcome.chosen.gains
            pair = simulate_before_after(plan.case, before, after, recorded=out is not None)
    except KeyboardInterrupt:
        if out is None:
            raise
        raise InterruptedError("every evaluation is kept, --resume goes on") from None
    except OSError as error:
        raise goes_on(error, "every evaluation is kept, --resume goes on") from None
    extras = report.Extras(*pair.metrics(), others, front)
    answer = report.as_object(outcome, extras)
    names = []
    if out is not None:
        report.write_files(out, outcome, extras, answer)
        write_rules(out, pair)
        names = [file.name for file in pictures(out, outcome, extras, pair)]
    if as_json:
        print(json.dumps(answer, indent=2, allow_nan=False))
        return
    display.show(outcome, extras)
    if out is not None:
        print(f"{display.files_text(outcome, names)}: {out}/")
