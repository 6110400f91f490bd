"""Wrong uses of several commands and of Python: one line that helps, status 2, nothing written."""

import errno
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pytest

import jaxstage as js
from jaxstage.system import runtime
from jaxstage.system.files import write_text
from tests.helpers.commanding import command as command
from tuning.app.reports.page import Page
from tuning.store import work_folder as folders

pytestmark = pytest.mark.fast
ROOT = Path(__file__).parents[2]
BLANK = Page(
    title="", subtitle="", good=None, verdict=(), facts={}, tables=(), pictures=(), files={},
    settings={},
)  # fmt: skip

#: what stands in the folder where the commands are called
FILES = {
    "other-law.toml": "[gains]\nslope = 1.0\n",
    "crisp.toml": '# found\nlaw = "cmac_sliding[crisp, exact]"\n[gains]\nslope = 1.0\n',
    "broken.toml": "[gains]\nslope = [1.0,\n",
    "unit.toml": '[plant]\nmass = "3 g"\n',
    "spread.toml": '[[spread]]\npath = "plant.mas"\ndistribution = "uniform"\n',
    "blocks.toml": '[blocks]\nsensor = "encodr"\n',
    "thesis/thesis.txt": "mine",
    "file": "mine",
}

WRONG = {
    "a misspelt command": ("runn pi-circle", "unknown command 'runn'; did you mean 'run'?"),
    "a study as a loop": ("run fuzzy-cmac", "is a study: name one of its loops, e.g. sliding-"),
    "a loop as a study": ("compare pi-circle", "'pi-circle' is a loop: `jaxstage compare fuzzy-"),
    "a misspelt study": ("compare fuzy-cmac", "unknown study 'fuzy-cmac'; did you mean 'fuzzy-cm"),
    "a unit": ("run pi-circle --set plant.mass=3g", "units are not written, this one is kg"),
    "a unit of a law": ("run pi-circle --set K=3A", "units are not written, this one is A/m"),
    "a unit of time": ("run pi-circle --set lap_time=1s", "this one is s"),
    "a unit of feed": ("run pi-circle --set feed=1200mm/min", "this one is mm/min"),
    "a unit in a file": ("run pi-circle --scenario unit.toml", "unit.toml:2: plant.mass = 3 g"),
    "two speeds": (
        "run pi-circle --set feed=1200 --set lap_time=1",
        "--set lap_time and --set feed: give one of them",
    ),
    "two parts to score": ("run pi-circle --set scored=1 --set skip=1", "give one of them"),
    "a gain": ("run pi-circle --set K=-1", "gains.proportional_gain (x) [K] = -1 A/m: must be >="),
    "no number": ("run pi-circle --set K=nan", "[K] = nan A/m: must be >= 0 A/m"),
    "another law's gains": (
        "run cascade-circle --gains other-law.toml",
        "other-law.toml:2: unknown setting 'gains.slope'",
    ),
    "gains of another law with the same names": (
        "run dfcmac-circle --gains crisp.toml",
        "crisp.toml:2: these are gains of cmac_sliding[crisp, exact], the law of dfcmac-circle is "
        "cmac_sliding[gaussian, exact]; a file without this line is taken for any law",
    ),
    "half a file": ("run pi-circle --gains broken.toml", "broken.toml: Invalid value (at the end"),
    "a folder as a file": ("run pi-circle --gains thesis", "thesis: Is a directory"),
    "a spread": (
        "sweep pi-circle -n 8 --out new --scenario spread.toml",
        "spread.toml:1: unknown setting 'plant.mas'; did you mean 'plant.mass'?",
    ),
    "a sensor": ("run pi-circle --scenario blocks.toml", "encodr; did you mean 'encoder'?"),
    "a record too long": ("run pi-circle --duration 200000 --out new", "takes 1.02e+03 GB"),
    "a foreign folder": ("sweep pi-circle -n 8 --out thesis", "thesis holds no sweep"),
    "a foreign export": ("export pi-circle --out thesis", "thesis"),
    "a report of a file": ("report file", "file: is not a folder"),
    "a report of nothing": ("report nothing", "nothing: no such folder"),
    "a report of a foreign folder": ("report thesis", "thesis holds nothing to report: none of a"),
    "a device as a file": ("report thesis --out /dev/null", "--out /dev/null: must be a file"),
    "a missing word": ("report", "Missing argument 'folder'"),
}  # fmt: skip


@pytest.fixture
def here(command):
    """The command in a folder with `FILES`."""
    for name, text in FILES.items():
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text(text, encoding="utf-8")
    return command


def tree():
    """Every file and folder here, with what it holds."""
    return {p: p.read_bytes() if p.is_file() else None for p in Path().rglob("*")}


@pytest.mark.parametrize("case", WRONG)
def test_one_line_that_helps(here, case):
    words, says = WRONG[case]
    before = tree()
    answer = here(*words.split())
    assert answer.status == 2 and answer.out == ""
    assert answer.err.startswith("jaxstage: ") and answer.err.count("\n") == 1, answer.err
    assert says in answer.err
    assert tree() == before


def test_no_words_are_the_help(command):
    answer = command()
    assert answer.status == 0 and answer.err == "" and "Usage: jaxstage" in answer.out
    assert "demo" in answer.out and "doctor" in answer.out


# --- the user's own study -------------------------------------------------------------------

STUDIES = {
    "syntax": ("def f(:\n", ":1: SyntaxError: invalid syntax"),
    "import": ("\nimport nothing_of_this_name\n", ":2: ModuleNotFoundError: No module named"),
    "no study": ("x = 3\n", "must hold study = Study(...)"),
    "another kind": ("study = 3\n", "must hold study = Study(...)"),
    "a definition": (
        "from jaxstage.studies import NamedLoop\nNamedLoop(name='a', sumary='b', build=None)\n",
        ":2: TypeError: NamedLoop.__init__() got an unexpected keyword argument 'sumary'",
    ),
    "a field": (
        "import jaxstage as js\ngains = js.build('pi-circle').gains\njs.replace(gains, slop=1)\n",
        ":3: Pi has no field 'slop'; did you mean 'slope'?",
    ),
}


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_of_ones_own(command, monkeypatch, name):
    text, says = STUDIES[name]
    file = Path(f"own_{name.replace(' ', '_')}.py").resolve()
    file.write_text(text, encoding="utf-8")
    monkeypatch.setenv("JAXSTAGE_STUDIES", str(file))
    answer = command("list")
    assert answer.status == 2 and answer.out == "" and answer.err.count("\n") == 1
    assert answer.err.startswith(f"jaxstage: JAXSTAGE_STUDIES: {file}") and says in answer.err


# --- the disk -------------------------------------------------------------------------------


def full(source, target):
    """`os.replace` on a disk without space."""
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_leaves_what_was_there(tmp_path, monkeypatch):
    """Whatever is written: the old file stands, nothing else does, and the message names it."""
    file = tmp_path / "gains.toml"
    write_text(file, "old")
    monkeypatch.setattr("jaxstage.system.files.os.replace", full)
    with pytest.raises(OSError) as refused:
        write_text(file, "new")
    assert (refused.value.errno, refused.value.filename) == (errno.ENOSPC, str(file))
    assert {f.name: f.read_text() for f in tmp_path.iterdir()} == {"gains.toml": "old"}


def test_a_full_disk_is_one_line_with_the_file(here, monkeypatch):
    monkeypatch.setattr("tuning.app.reports.kinds.page_of", lambda folder: BLANK)
    monkeypatch.setattr("jaxstage.system.files.os.replace", full)
    answer = here("report", "thesis")
    assert answer.status == 2
    assert answer.err == "jaxstage: thesis/report.html: No space left on device\n"
    nowhere = here("report", "thesis", "--out", "nowhere/x.html")
    assert nowhere.err == "jaxstage: nowhere/x.html: No such file or directory\n"
    assert os.listdir("thesis") == ["thesis.txt"] and not Path("nowhere").exists()


@pytest.mark.parametrize(
    ("inside", "words", "says"),
    [
        ("tuning.sweeps.sweep.sweep", "sweep pi-circle -n 8", "finished chunks are kept, --resume"),
        ("tuning.tuner.session.run_tuning", "tune pi-circle", "every evaluation is kept, --resume"),
        ("tuning.app.commands.demo._run", "demo", "`jaxstage demo --out new` goes on"),
    ],
)
@pytest.mark.parametrize("stopped", [KeyboardInterrupt(), OSError(errno.ENOSPC, "No space", "f")])
def test_what_was_stopped_says_how_to_go_on(command, monkeypatch, inside, words, says, stopped):
    def stop(*_, **__):
        raise stopped

    monkeypatch.setattr(inside, stop)
    plan = SimpleNamespace(table={"budget": 1.0})
    monkeypatch.setattr("tuning.tuner.configuration.configure_tuning", lambda request: "")
    monkeypatch.setattr("tuning.tuner.configuration.build", lambda text: plan)
    answer = command(*words.split(), "--out", "new")
    last = answer.err.splitlines()[-1]
    if isinstance(stopped, OSError):
        assert answer.status == 2 and last.startswith("jaxstage: f: No space; ") and says in last
    else:
        assert answer.status == 130 and last.startswith("jaxstage: interrupted; ") and says in last
    assert answer.err.count("jaxstage: ") == 1


def test_interrupted_elsewhere(command, monkeypatch):
    def stop(name):
        raise KeyboardInterrupt

    monkeypatch.setattr("tuning.app.comparison.find_study", stop)
    answer = command("compare", "fuzzy-cmac")
    assert answer.status == 130
    assert answer.err == "jaxstage: interrupted; every file is whole or absent\n"


PROGRAM = """
import sys
import jax
from tuning.app import main as cli
from tuning.app import comparison as comparisons
def stop(name):
    def body(i, x):
        for _ in range(200):  # more than what JAX computes at once
            x = jax.numpy.sin(x @ x)
        return x
    jax.jit(lambda n: jax.lax.fori_loop(0, n, body, jax.numpy.ones((8, 8))))(10**9)
    raise KeyboardInterrupt
comparisons.find_study = stop
sys.argv = ["jaxstage", "compare", "fuzzy-cmac"]
cli.main()
"""


def test_interrupted_while_jax_computes(tmp_path):
    """The process ends at once: it neither waits for the computation nor crashes with it."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False, timeout=60,
        env=os.environ | {"PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 130, done
    assert done.stderr == "jaxstage: interrupted; every file is whole or absent\n"


def test_another_configuration_says_what_differs(tmp_path):
    kind = folders.FolderKind("sweep.toml", "sweep", ("seed",))
    folders.create(tmp_path / "new", kind, "seed = 0\n", resume=False)
    with pytest.raises(ValueError, match=r"of another configuration; seed: 0 -> 1$"):
        folders.create(tmp_path / "new", kind, "seed = 1\n", resume=True)
    both = '[[loop]]\nname = "a"\ndt = 1\n[[loop]]\nname = "b"\ndt = 1\n'
    one = '[[loop]]\nname = "a"\ndt = 2\n'
    assert folders.differences(both, one) == ["loop.a.dt: 1 -> 2", "loop.b: given -> none"]
    assert folders.differences("x = 1\n", one) == ["x: 1 -> none", "loop: none -> given"]
    with pytest.raises(ValueError, match="holds this sweep already: --resume goes on with it"):
        folders.create(tmp_path / "new", kind, "seed = 0\n", resume=False)


# --- how JAX runs ---------------------------------------------------------------------------


def test_a_cache_that_cannot_be_written(monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    before = runtime.cache_folder()
    with pytest.warns(UserWarning, match="no cache of compiled programs: /dev/null/jaxstage: Not"):
        js.configure(cache="default")
    assert runtime.cache_folder() == before


def test_warnings_of_libraries_are_one_line(command, monkeypatch):
    def warned(name):
        warnings.warn("first\n  second", stacklevel=2)
        raise ValueError("then refused")

    monkeypatch.setattr("tuning.app.comparison.find_study", warned)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        answer = command("compare", "fuzzy-cmac")
    assert answer.err == "jaxstage: first second\njaxstage: then refused\n"


def test_a_backend_that_is_not_there(command, monkeypatch):
    def missing(name):
        raise RuntimeError("Unable to initialize backend 'cuda': no such device")

    monkeypatch.setattr("tuning.app.comparison.find_study", missing)
    answer = command("compare", "fuzzy-cmac")
    assert answer.status == 2 and answer.err.count("\n") == 1 and "backend 'cuda'" in answer.err


def test_another_number_of_devices_after_jax_has_started():
    jnp.zeros(1)
    with pytest.raises(RuntimeError, match="cores = 77: JAX has already started with") as refused:
        js.configure(cores=77)
    assert "in a new process" in str(refused.value)


def test_a_case_of_another_precision():
    case = js.build("pi-circle")
    with jax.enable_x64(False), pytest.raises(ValueError, match="the path is in double precision"):
        js.simulate(case.loop, case.gains, case.scenario, case.path, 10)


# --- Python ---------------------------------------------------------------------------------

CALLS = {
    "a loop by name": (lambda c: ("pi-circle", c.gains, c.scenario), "loop is a str, must be a Lo"),
    "in another order": (lambda c: (c.loop, c.scenario, c.gains), "scenario is a Pi, must be a Sc"),
    "a word": (
        lambda c: (c.loop, js.replace(c.gains, slope="fast"), c.scenario),
        "gains.slope = 'fast': must be a number or an array",
    ),
    "another law's gains": (
        lambda c: (c.loop, js.build("cascade-circle").gains, c.scenario),
        "Cascade has no 'slope', which pi on pmsm_table[stribeck, sticking] needs",
    ),
    "another machine's scenario": (
        lambda c: (c.loop, c.gains, js.build("none").scenario),
        "plant.force_constant has shape (3,), expected (2,)",
    ),
    "a batch": (
        lambda c: (c.loop, js.replace(c.gains, slope=jnp.ones((4, 2))), c.scenario),
        "gains.slope has shape (4, 2), expected () or (2,)",
    ),
}


@pytest.mark.parametrize("case", CALLS)
def test_python_says_what_is_wrong_where(case):
    made = js.build("pi-circle")
    arguments, says = CALLS[case]
    with pytest.raises(ValueError, match=re.escape(says)):
        js.simulate(*arguments(made), made.path, 10)


def test_batches_of_different_sizes_are_named():
    case = js.build("pi-circle")
    gains = js.replace(case.gains, slope=jnp.ones((4, 2)))
    with pytest.raises(ValueError, match=r"gains\.proportional_gain has 2, gains\.slope has 4"):
        js.rollouts(case.loop, gains, case.scenario, case.path, 10)
