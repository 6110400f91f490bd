"""The commands of the demo, one after the other; those that have ended are not run again.

DIR/demo.toml             what is run
DIR/stages.json           what has ended, and how long it took
DIR/output.txt            what the commands printed
DIR/run/LOOP              simulated at the published gains
DIR/tune/LOOP             tuned
DIR/published, DIR/tuned  both laws on the same plants, under the published and the tuned gains
"""

import json
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import jax
import tomli_w

from jaxstage import __version__
from jaxstage.system.files import write_text
from tuning.app.messages import json_text
from tuning.store.work_folder import FolderKind
from tuning.tuner.report import ACCEPTED, REFUSED

KIND = FolderKind("demo.toml", "demo", ("jaxstage", "loops", "plants"))
#: the published law, and the industrial cascade on the same machine
LOOPS = ("dfcmac-circle", "cascade-circle")
#: units that the tuning of each law may spend
BUDGET = 1000
#: plants of each sweep, and the seed that they are drawn by: that of the tunings is 0
PLANTS, SEED = 256, 77
#: runs of one file of a sweep: the step of its progress
CHUNK = 128
#: what the laws are judged by
METRIC = "contour_rms_um"
#: added to every command that simulates; tests make the runs shorter by it
WORDS: tuple[str, ...] = ()


class Stage(NamedTuple):
    """One command.

    Args:
        name: of the stage.
        out: its folder in that of the demo.
        words: of the command, without ``--out`` and ``--resume``.
        answers: the JSON file that it ends with where it takes up what its folder holds; a stage
            without a whole one is run again.
    """

    name: str
    out: str
    words: tuple[str, ...]
    answers: str = ""


class StageTime(NamedTuple):
    """A stage that has ended, and its time. command: as a user would type it."""

    command: str
    seconds: float
    processor_seconds: float


def count() -> int:
    """How many stages there are."""
    return 2 * len(LOOPS) + 2


def stages(folder: Path) -> Iterator[Stage]:
    """All of them in order. The last one is made when it is asked for: it needs the gains that the
    tunings have left by then."""
    for loop in LOOPS:
        yield Stage(f"run {loop}", f"run/{loop}", ("run", loop, *WORDS))
    for loop in LOOPS:
        words = ("tune", loop, "--budget", str(BUDGET), *WORDS)
        yield Stage(f"tune {loop}", f"tune/{loop}", words, "tune.json")
    numbers = ("-n", str(PLANTS), "--seed", str(SEED), "--chunk", str(CHUNK))
    sweep = ("sweep", *LOOPS, *numbers, "--metric", METRIC, *WORDS)
    yield Stage("published", "published", sweep, "summary.json")
    files = [("--gains", f"{loop}={gains_file(folder, loop)}") for loop in LOOPS]
    yield Stage(
        "tuned", "tuned", (*sweep, *(word for pair in files for word in pair)), "summary.json"
    )


def gains_file(folder: Path, loop: str) -> Path:
    """The gains that the tuning of a loop ended with, accepted or not."""
    accepted = folder / "tune" / loop / ACCEPTED
    return accepted if accepted.is_file() else accepted.with_name(REFUSED)


def configuration() -> str:
    """What a demo depends on, as text."""
    table = {
        "jaxstage": __version__,
        "jax": jax.__version__,
        "loops": list(LOOPS),
        "budget": BUDGET,
        "plants": PLANTS,
        "seed": SEED,
        "metric": METRIC,
        "words": list(WORDS),
    }
    return tomli_w.dumps(table)


def ended(folder: Path) -> dict[str, StageTime]:
    """The stages that have ended, by name; of a damaged file those that can be read."""
    kept = read_object(folder / "stages.json")
    return {name: StageTime(**one) for name, one in kept.items() if _is_stage_time(one)}


def _is_stage_time(one: Any) -> bool:
    fields = get_type_hints(StageTime)
    same = isinstance(one, dict) and one.keys() == fields.keys()
    return same and all(isinstance(one[name], kind) for name, kind in fields.items())


def has_answers(stage: Stage, folder: Path) -> bool:
    """Whether the answers of a stage are there."""
    return not stage.answers or bool(read_object(folder / stage.out / stage.answers))


def read_object(file: Path) -> dict[str, Any]:
    """A JSON object; empty where there is no file, or a damaged one."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def command_of(stage: Stage, folder: Path) -> list[str]:
    """The words of a stage's command."""
    out = folder / stage.out
    resume = ("--resume",) if stage.answers and out.exists() else ()
    return [*stage.words, "--out", str(out), *resume]


def run_stage(stage: Stage, folder: Path, call: Callable[[Sequence[str]], object]) -> StageTime:
    """Run the command of a stage, keep what it prints and that it has ended.

    call: runs a command by its words, as ``jaxstage`` does; what it raises passes through.
    """
    words = command_of(stage, folder)
    shown = shlex.join(["jaxstage", *words])
    begun, spent = time.perf_counter(), time.process_time()
    with (folder / "output.txt").open("a", encoding="utf-8") as file, redirect_stdout(file):
        print(f"$ {shown}")
        call(words)
        print()
    shown = shown.removesuffix(" --resume")
    seconds, processor = time.perf_counter() - begun, time.process_time() - spent
    stage_time = StageTime(shown, seconds, processor)
    every = ended(folder) | {stage.name: stage_time}
    write_text(
        folder / "stages.json", json_text({name: one._asdict() for name, one in every.items()})
    )
    return stage_time
