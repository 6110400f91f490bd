"""The kinds of cases: each makes one random case in a folder and says what is wrong with it."""

import functools
import random
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from tests.fuzz.values import TEXTS, VALUES, damaged, misspelt, toml
from tests.fuzz.verdict import HangError, call, faults, limited
from tuning.tuner.options import parse_objective
from tuning.tuner.problem.objective import parse_goals
from tuning.uncertainty.specification import parse

#: (how the case ended, what is wrong with it)
Ended = tuple[str, list[str]]

LOOP = "pi-circle"
#: the shortest run that is compiled once and used by all cases
SHORT = ("--set", "lap_time=0.01", "--set", "laps=1")
SETTINGS = (
    "K", "gains.c1", "plant.mass", "plant.mass.x", "nominal.mass", "lap_time", "laps", "scored",
    "dt", "substeps", "feed", "skip", "reference.radius", "drive.delay", "start.offset", "gains",
    "plant.foo", "",
)  # fmt: skip
COMMANDS = (
    "run", "list", "compare", "tune", "sweep", "replay", "export", "report", "doctor", "precision",
    "frequency", "demo",
)  # fmt: skip
OPTIONS = (
    "--set", "--gains", "--scenario", "--json", "--out", "--duration", "--precision", "-n",
    "--spec", "--goal", "--objective", "--risk", "--margin", "--method", "--starts", "--budget",
    "--design", "--target", "--seed", "--resume", "--worst", "--run", "--axis", "--prefix",
    "--train", "--at", "--sine", "--cut", "--metric", "--workers", "--loop", "--force",
)  # fmt: skip


def argument(draw: random.Random, folder: Path) -> Ended:
    """A command line whose words are right, misspelt or nonsense."""
    command = draw.choice(COMMANDS)
    if draw.random() < 0.1:
        command = misspelt(draw, command)
    words = [command]
    if command in ("run", "tune", "sweep", "export", "frequency"):
        words.append(draw.choice((LOOP, LOOP, LOOP, misspelt(draw, LOOP), draw.choice(TEXTS))))
    elif command not in ("list", "doctor", "demo"):
        words.append(draw.choice(("fuzzy-cmac", "nothing", ".", draw.choice(TEXTS))))
    if command in ("tune", "sweep", "export", "demo"):
        words += ["--out", "out"]
    for _ in range(draw.randrange(1, 4)):
        words += _option(draw)
    # what would really start is not the matter here: the last word is one that none takes
    words.append(draw.choice(("--no-such-option", *("--set", "no.such.value=1") * 3)))
    return faults([w.replace("\x00", "") for w in words], folder)


def _option(draw: random.Random) -> list[str]:
    option = draw.choice(OPTIONS)
    if draw.random() < 0.1:
        option = misspelt(draw, option)
    if option in ("--json", "--resume", "--force"):
        return [option]
    if option == "--set":
        name = draw.choice(SETTINGS)
        return [option, f"{name}={draw.choice(TEXTS)}"]
    return [option, draw.choice(TEXTS)]


def setting(draw: random.Random, folder: Path) -> Ended:
    """One value of a run that is otherwise right; some of them run."""
    name, text = draw.choice(SETTINGS), draw.choice(TEXTS)
    words = ["run", LOOP, *SHORT, "--json", "--set", f"{name}={text}".replace("\x00", "")]
    return faults(words, folder)


GAINS = {"gains": {"proportional_gain": 64.0, "slope": 1.0}}
SCENARIO = {
    "plant": {"load": 0.12, "static": 0.2, "coulomb": 0.1},
    "drive": {"delay": 1, "limit": 5.0, "lag": 1e-4},
    "blocks": {"drive": "current_drive", "sensor": "encoder"},
    "sensor": {"resolution": 1e-7, "bandwidth": 500.0},
    "start": {"offset": [1e-5, 0.0], "velocity": 1.0},
    "key": {"seed": 3},
}
SPREAD = {
    "path": "plant.mass", "distribution": "normal", "mean": 1.0, "deviation": 0.1, "low": 0.7,
    "high": 1.3, "relative": True, "shared": False, "values": [1, 2],
}  # fmt: skip
TRAIN = {
    "train": {"plants": 3, "nominal": True, "seed": 0, "horizons": [1.0], "skip": 0.2},
    "held_out": {"plants": 100, "dealt": True, "design": "sobol", "noise_seeds": 1},
}


def _mutated(draw: random.Random, tables: dict[str, dict[str, object]]) -> str:
    lines: list[str] = []
    for table, keys in tables.items():
        if draw.random() < 0.1:
            lines.append(f"{misspelt(draw, table)} = {toml(draw.choice(VALUES))}")
            continue
        head = f"[[{table}]]" if draw.random() < 0.05 else f"[{table}]"
        lines.append(head)
        items = list(keys.items())
        draw.shuffle(items)
        for key, value in items:
            if draw.random() < 0.3:
                value = draw.choice(VALUES)
            if draw.random() < 0.05:
                key = misspelt(draw, key).replace(" ", "").strip(".=") or "x"
            if draw.random() < 0.8:
                lines.append(f"{key} = {toml(value)}")
    return "\n".join(lines) + "\n"


def _spreads(draw: random.Random) -> str:
    text = ""
    for _ in range(draw.randrange(1, 3)):
        text += _mutated(draw, {"spread": SPREAD}).replace("[spread]", "[[spread]]")
    if draw.random() < 0.5:
        pair = {"between": ["plant.mass.x", "plant.mass.y"], "value": 0.8}
        text += _mutated(draw, {"correlation": pair}).replace("[correlation]", "[[correlation]]")
    return text


def file(draw: random.Random, folder: Path) -> Ended:
    """A gains, scenario or training file with wrong values, tables, bytes, depth or encoding."""
    which = draw.choice(("gains", "scenario", "train"))
    text = {
        "gains": lambda: _mutated(draw, GAINS),
        "scenario": lambda: (
            _mutated(draw, SCENARIO) + (_spreads(draw) if draw.random() < 0.5 else "")
        ),
        "train": lambda: _mutated(draw, TRAIN),
    }[which]()
    data = text.encode("utf-8", "surrogatepass")
    if draw.random() < 0.2:
        data = damaged(draw, data)
    if draw.random() < 0.03:
        data = b"x = " + b"[" * 2000 + b"]" * 2000
    (folder / "given.toml").write_bytes(data)
    if which == "train":
        words = ["tune", LOOP, *SHORT, "--train", "given.toml", "--out", "out", "--budget", "0"]
    elif which == "scenario" and draw.random() < 0.5:
        words = ["sweep", LOOP, *SHORT, "-n", "0", "--scenario", "given.toml", "--out", "out"]
    else:
        words = ["run", LOOP, *SHORT, "--json", f"--{which}", "given.toml"]
    return faults(words, folder)


PIECES = (
    "contour_rms_um", "contour_max_um", "finite", "energy_J", "growth", "<", ">", "==", "<=",
    "and", "or", "not", "+", "-", "*", "/", "**", "(", ")", "20", "1e999", "9" * 400, "0",
    ",", ".", "[", "]", "lambda", "__import__('os')", "x", "'a'", "True", "None", "0.1",
)  # fmt: skip
COLUMNS = {"contour_rms_um": float, "contour_max_um": float, "energy_J": float, "finite": bool}


def specification(draw: random.Random, folder: Path) -> Ended:
    """``--spec``, ``--goal`` and ``--objective`` made of pieces of their language: understood, or
    refused by a ValueError in one line."""
    count = draw.choice((1, 2, 3, 5, 9, 3000)) if draw.random() < 0.1 else draw.randrange(1, 9)
    text = " ".join(draw.choice(PIECES) for _ in range(count))
    if draw.random() < 0.05:
        text = draw.choice((" + ", " and ")).join(["contour_rms_um < 1"] * 3000)
    elif draw.random() < 0.5:
        text = f"contour_rms_um {draw.choice(PIECES)} {draw.choice(PIECES)}"
    read = draw.choice(
        (
            lambda: parse(text, COLUMNS),
            lambda: parse_goals(text, COLUMNS),
            lambda: parse_objective(text, COLUMNS),
        )
    )
    try:
        with limited():
            read()
    except ValueError as error:
        said = str(error)
        return "refused", [] if said and "\n" not in said else [f"refusal of {len(said)} letters"]
    except (Exception, HangError) as error:
        return "traceback", [f"traceback: {type(error).__name__}: {str(error)[:120]}"]
    return "done", []


@functools.cache
def _finished(kind: str) -> Path:
    """A folder that a command left, made once."""
    made = Path(tempfile.mkdtemp(prefix=f"jaxstage-fuzz-{kind}-"))
    words = {
        "run": ["run", LOOP, *SHORT, "--out", str(made / "out")],
        "sweep": ["sweep", LOOP, *SHORT, "-n", "8", "--out", str(made / "out")],
        "export": ["export", LOOP, "--out", str(made / "out")],
    }[kind]
    status, _, err = call(words)
    assert status == 0, err
    return made / "out"


def state(draw: random.Random, folder: Path) -> Ended:
    """A folder of results with one file damaged, lost or foreign, and a command that reads it."""
    kind = draw.choice(("run", "sweep", "sweep", "sweep", "export"))
    shutil.copytree(_finished(kind), folder / "out")
    files = sorted(f for f in (folder / "out").rglob("*") if f.is_file() and f.suffix != ".png")
    chosen = draw.choice(files)
    what = draw.random()
    if what < 0.75:
        chosen.write_bytes(damaged(draw, chosen.read_bytes()))
    elif what < 0.9:
        chosen.unlink()
    else:
        chosen.unlink()
        chosen.mkdir()
    if kind == "sweep":
        verbs = (
            ["sweep", "--resume", "--out", "out", "--json"],
            ["replay", "out", "--worst", "1", "--json"],
            ["report", "out"],
        )
    elif kind == "run":
        verbs = (["report", "out"], ["run", LOOP, *SHORT, "--gains", "out/gains.toml", "--json"])
    else:
        verbs = (["export", LOOP, "--out", "out"],)
    return faults(draw.choice(verbs), folder)


STUDY = """
import jaxstage as js
from jaxstage.studies import Study, NamedLoop, find
base = find("pi-circle")
study = Study(name="mine", title={title}, source="mine", references=("circle",), loops={loops},
              spreads={spreads}, experiments=(), claims=())
{end}
"""


def own_study(draw: random.Random, folder: Path) -> Ended:
    """A study of the user's own whose parts have wrong types, or whose file does not run."""
    loop = "NamedLoop(name='mine-circle', summary='mine', build={build}, timing=base.timing)"
    builds = ("base.build", "lambda timing: None", "lambda timing: 1/0", "3")
    loops = draw.choice(("3", "[1]", "()", "None", f"({loop.format(build=draw.choice(builds))},)"))
    text = STUDY.format(
        title=draw.choice(("'mine'", "'Speed loop [m/s]'", "'[/s]'", "3", "None")),
        loops=loops,
        spreads=draw.choice(("()", "()", "3", "[1]", "None")),
        end=draw.choice(("", "", "exit(3)", "raise KeyError('x')", "study = 3", "del study", "(")),
    )
    (folder / "mine.py").write_text(text)
    import os

    before = os.environ.get("JAXSTAGE_STUDIES")
    os.environ["JAXSTAGE_STUDIES"] = str(folder / "mine.py")
    try:
        words = draw.choice((["list"], ["run", "mine-circle", *SHORT, "--json"]))
        return faults(words, folder)
    finally:
        if before is None:
            del os.environ["JAXSTAGE_STUDIES"]
        else:
            os.environ["JAXSTAGE_STUDIES"] = before


#: kind -> what makes a case of it, and its share of all
KINDS: dict[str, tuple[Callable[[random.Random, Path], Ended], float]] = {
    "arguments": (argument, 0.3),
    "settings": (setting, 0.1),
    "files": (file, 0.3),
    "specifications": (specification, 0.15),
    "state": (state, 0.1),
    "studies": (own_study, 0.05),
}
