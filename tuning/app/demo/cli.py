"""``jaxstage demo``."""

import json
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

Call = Callable[[Sequence[str]], object]


def demo(folder: Path, as_json: bool, call: Call) -> None:
    """Run what is missing, then print the verdict. call: runs a command by its words."""
    from jaxstage.system.files import goes_on
    from jaxstage.system.runtime import configure, cpu_cores
    from tuning.store import prepare as runs
    from tuning.store import work_folder as folders

    runs.check_folder(folder)
    configure(precision="double", cores=cpu_cores(), cache="default")
    from tuning.app.demo import stages

    folders.create(folder, stages.KIND, stages.configuration(), resume=folder.exists())
    with folders.locked(folder, stages.KIND, "running a demo"):
        try:
            answer = _run(folder, call)
        except (KeyboardInterrupt, InterruptedError):
            raise InterruptedError(f"`jaxstage demo --out {folder}` goes on") from None
        except OSError as error:
            raise goes_on(error, f"`jaxstage demo --out {folder}` goes on") from None
    if as_json:
        print(json.dumps(answer, indent=2, allow_nan=False))
        return
    print(f"report.html, demo.json, plants.png, what each command printed and left: {folder}/")
    print("\n".join(answer["verdict"]))


def _run(folder: Path, call: Call) -> dict[str, Any]:
    from jaxstage.system.files import write_text
    from tuning.app.demo import answers, stages
    from tuning.app.reports import kinds

    before = stages.ended(folder)
    for number, stage in enumerate(stages.stages(folder), start=1):
        took = before.get(stage.name)
        place = f"[{number}/{stages.count()}]"
        if took is None:
            _tell(f"{place} {shlex.join(['jaxstage', *stages.command_of(stage, folder)])}")
            took = stages.run_stage(stage, folder, call)
        _tell(f"{place} {stage.name}: {_time(took)}{' earlier' if stage.name in before else ''}")
    answer = answers.as_object(folder)
    write_text(folder / "demo.json", json.dumps(answer, indent=2, allow_nan=False) + "\n")
    answers.picture(folder, answer)
    kinds.write(folder, folder / "report.html")
    _tell(f"all stages: {answer['seconds']:.0f} s, {answer['processor_seconds']:.0f} s of a core")
    return answer


def _time(took: Any) -> str:
    return f"{took.seconds:.1f} s, {took.processor_seconds:.1f} s of a core"


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
