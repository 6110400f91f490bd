"""``jaxstage compare``: a paper's claims against this simulation."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from tuning.app import completion
from tuning.app.shared_options import AsJson


@dataclass(frozen=True)
class CompareOptions:
    """What ``jaxstage compare`` takes."""

    study: Annotated[
        str,
        typer.Argument(
            help="A study of `jaxstage list`, e.g. fuzzy-cmac.", autocompletion=completion.studies
        ),
    ]
    as_json: AsJson = False
    out: Annotated[
        Path | None, typer.Option(help="Folder for claims.png, the figures, compare.json.")
    ] = None
    verdicts: Annotated[
        bool, typer.Option("--verdicts", help="Print claim = verdict as TOML, nothing else.")
    ] = False
    gains: Annotated[
        list[str],
        typer.Option(metavar="LOOP=FILE", help="A loop with these gains, too. Repeatable."),
    ] = field(default_factory=list)


def compare(options: CompareOptions) -> None:
    """A paper's claims, each with a computed verdict."""
    from jaxstage.system.runtime import configure, cpu_cores

    configure(precision="double", cores=cpu_cores(), cache="default")
    from jaxstage.studies import compare as compare_study
    from tuning.app import comparison
    from tuning.app.messages import print_json, progress
    from tuning.store.prepare import check_folder
    from tuning.store.work_folder import locked

    study = comparison.find_study(options.study)
    files = comparison.gains_files(study, options.gains)
    if options.out is not None:
        check_folder(options.out)
    with locked(options.out, "comparing"):
        others = comparison.other_gains(files)
        compared = compare_study(study, lambda text: progress(f"simulating {text}"))
        answer = comparison.as_object(compared, others)
        drawn = [] if options.out is None else comparison.draw(compared, options.out, answer)
    if options.verdicts:
        import tomli_w

        print(tomli_w.dumps({j.id: j.verdict for j in compared.claims}), end="")
    if options.as_json:
        print_json(answer)
    if not (options.as_json or options.verdicts):
        comparison.show(study, answer)
        if options.out is not None:
            names = ", ".join(file.name for file in drawn)
            print(f"{names}, compare.json: {options.out}/")
