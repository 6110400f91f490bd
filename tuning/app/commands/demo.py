"""``jaxstage demo``: other commands one after the other, and one report of all that they leave."""

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tuning.app.failures import INTERRUPTED
from tuning.app.shared_options import AsJson

if TYPE_CHECKING:
    from tuning.app.demo.stages import StageTime

#: runs a command by its words, as ``jaxstage`` does
CallCommand = Callable[[Sequence[str]], object]


@dataclass(frozen=True)
class DemoOptions:
    """What ``jaxstage demo`` takes."""

    context: typer.Context
    out: Annotated[
        Path, typer.Option(help="Folder of the demo; the same again goes on with it.")
    ] = Path("demo")
    as_json: AsJson = False


def demo(options: DemoOptions) -> None:
    """Two laws tuned and tested on other plants, one report."""
    from jaxstage.system.files import goes_on
    from jaxstage.system.runtime import configure, cpu_cores
    from tuning.app.messages import print_json
    from tuning.store import work_folder
    from tuning.store.prepare import check_folder

    folder = options.out
    check_folder(folder)
    configure(precision="double", cores=cpu_cores(), cache="default")
    from tuning.app.demo import stages

    def call(words: Sequence[str]) -> None:
        command = options.context.find_root().command
        if command.main(list(words), standalone_mode=False) == INTERRUPTED:
            raise KeyboardInterrupt

    work_folder.create(folder, stages.KIND, stages.configuration(), resume=folder.exists())
    with work_folder.locked(folder, "running a demo"):
        try:
            answer = _run(folder, call)
        except (KeyboardInterrupt, InterruptedError):
            raise InterruptedError(f"`jaxstage demo --out {folder}` goes on") from None
        except OSError as error:
            raise goes_on(error, f"`jaxstage demo --out {folder}` goes on") from None
    if options.as_json:
        print_json(answer)
        return
    print(f"report.html, demo.json, plants.png, what each command printed and left: {folder}/")
    print("\n".join(answer["verdict"]))


def _run(folder: Path, call: CallCommand) -> dict[str, Any]:
    from jaxstage.system.files import write_text
    from tuning.app.demo import answers, stages
    from tuning.app.messages import json_text, progress
    from tuning.app.reports import kinds

    before = stages.ended(folder)
    for number, stage in enumerate(stages.stages(folder), start=1):
        took = before.get(stage.name) if stages.has_answers(stage, folder) else None
        place = f"[{number}/{stages.count()}]"
        earlier = took is not None
        if took is None:
            progress(f"{place} {shlex.join(['jaxstage', *stages.command_of(stage, folder)])}")
            took = stages.run_stage(stage, folder, call)
        progress(f"{place} {stage.name}: {_time(took)}{' earlier' * earlier}")
    try:
        answer = answers.as_object(folder)
    except (LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise ValueError(
            f"{folder}: a stage has left what this version does not write ({error!r}): delete "
            f"{folder / 'stages.json'}, `jaxstage demo --out {folder}` runs all stages again"
        ) from error
    write_text(folder / "demo.json", json_text(answer))
    answers.picture(folder, answer)
    kinds.write(folder, folder / "report.html")
    seconds, processor = answer["seconds"], answer["processor_seconds"]
    progress(f"all stages: {seconds:.0f} s, {processor:.0f} s of a core")
    return answer


def _time(took: "StageTime") -> str:
    return f"{took.seconds:.1f} s, {took.processor_seconds:.1f} s of a core"
