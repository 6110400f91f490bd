"""What must not happen, and what is said where it does: faults of ours, readers that go away,
markup in the text of a user, two processes in one folder, damaged and foreign files."""

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from jaxstage.system.files import write_text
from tests.app.test_front import read
from tests.helpers.commanding import command as command
from tests.helpers.commanding import few_figures
from tuning.app import export_folder
from tuning.app.reports.page import Page, html
from tuning.store.work_folder import FolderKind, create, locked, read_configuration

ROOT = Path(__file__).parents[2]
SHORT = ("--set", "lap_time=0.02", "--set", "laps=1", "--set", "scored=0")
CALL = "from tuning.app.main import main; main()"


def raising(error):
    def stop(name):
        raise error

    return stop


# --- whose fault ------------------------------------------------------------------------------


@pytest.mark.fast
def test_a_fault_of_ours_is_told_apart_from_a_wrong_use(command, monkeypatch):
    monkeypatch.setattr("tuning.app.comparison.find_study", raising(TypeError("bad [/operand]")))
    answer = command("compare", "fuzzy-cmac")
    assert answer.status == 70 and answer.out == "" and answer.err.count("\n") == 1
    assert "TypeError: bad [/operand]; this is a fault of jaxstage, please report" in answer.err
    monkeypatch.setenv("JAXSTAGE_TRACEBACK", "1")
    shown = command("compare", "fuzzy-cmac")
    assert shown.status == 70 and "Traceback" in shown.err and "raise error" in shown.err


@pytest.mark.fast
@pytest.mark.parametrize("broken", [lambda name: json.loads("{"), lambda name: np.hsplit([1], 3)])
def test_a_value_that_a_library_refuses_is_a_fault_of_ours(command, monkeypatch, broken):
    monkeypatch.setattr("tuning.app.comparison.find_study", broken)
    answer = command("compare", "fuzzy-cmac")
    assert answer.status == 70 and "this is a fault of jaxstage" in answer.err


@pytest.mark.fast
def test_no_memory_is_no_fault(command, monkeypatch):
    monkeypatch.setattr("tuning.app.comparison.find_study", raising(MemoryError()))
    answer = command("compare", "fuzzy-cmac")
    assert answer.status == 2 and "out of memory: simulate less at once" in answer.err


@pytest.mark.fast
def test_a_very_long_line_is_shortened(command):
    answer = command("run", "x" * 5000)
    assert answer.status == 2 and len(answer.err) < 1100 and " ... " in answer.err


# --- standard output --------------------------------------------------------------------------


def program(tmp_path, out, *words, **variables):
    return subprocess.Popen(
        [sys.executable, "-c", CALL, *words],
        stdout=out,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(tmp_path)} | variables,
    )


def test_a_reader_that_goes_away(tmp_path):
    process = program(tmp_path, subprocess.PIPE, "list")
    process.stdout.close()
    assert process.stderr.read() == "" and process.wait(timeout=60) == 141


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
def test_a_full_disk_below_standard_output(tmp_path):
    with open("/dev/full", "w") as full:
        process = program(tmp_path, full, "--version")
        assert process.stderr.read() == "jaxstage: No space left on device\n"
        assert process.wait(timeout=60) == 2


def test_a_terminal_without_the_letters(tmp_path):
    process = program(tmp_path, subprocess.PIPE, "run", "größe", PYTHONIOENCODING="ascii")
    assert "unknown loop 'gr\\xf6\\xdfe'" in process.stderr.read()
    process.stdout.close()
    assert process.wait(timeout=60) == 2


# --- text of a user ---------------------------------------------------------------------------

OWN = """
import jaxstage as js
from jaxstage.studies import NamedLoop, Study, find
base = find("pi-circle")
said = "[/s] of [m/s] :smile:"
loop = NamedLoop(name="speed", summary=said, build=base.build, timing=base.timing)
study = Study(name="mine", title="Speed loop [m/s] [/s]", source="[bold]nobody", loops=(loop,))
"""


def test_brackets_in_text_of_a_user_are_kept(command, monkeypatch):
    few_figures(monkeypatch)
    Path("own_brackets.py").write_text(OWN)
    monkeypatch.setenv("JAXSTAGE_STUDIES", "own_brackets.py")
    listed = command("list")
    assert listed.status == 0, listed.err
    for text in ("mine  Speed loop [m/s] [/s]", "[bold]nobody", "[/s] of [m/s] :smile:"):
        assert text in listed.out
    ran = command("run", "speed", *SHORT)
    assert ran.status == 0 and "[/s] of [m/s] :smile:" in ran.out


@pytest.mark.fast
def test_backticks_in_a_report_are_code_and_nothing_else_is():
    page = Page(
        title="t",
        subtitle="`jaxstage run <b>` goes on",
        good=None,
        verdict=("a ` alone",),
        facts={},
        tables=(),
        pictures=(),
        files={},
        settings={},
    )
    text = html(page)
    assert "<code>jaxstage run &lt;b&gt;</code> goes on" in text and "a ` alone" in text
    read(text)


# --- two processes in one folder --------------------------------------------------------------


@pytest.mark.parametrize(
    "words", [("run", "pi-circle", *SHORT), ("export", "pi-circle"), ("compare", "fuzzy-cmac")]
)
def test_one_process_a_folder(command, monkeypatch, words):
    few_figures(monkeypatch)
    with locked(Path("taken"), "busy"):
        answer = command(*words, "--out", "taken")
    assert answer.status == 2 and answer.err.count("\n") == 1
    assert "another process is" in answer.err and "into taken" in answer.err
    assert not Path("taken").exists(), "nothing was left there"


@pytest.mark.fast
def test_a_lock_keeps_what_was_written(tmp_path):
    with locked(tmp_path / "deep" / "out", "busy"):
        (tmp_path / "deep" / "out" / "file").write_text("kept")
    assert (tmp_path / "deep" / "out" / "file").read_text() == "kept"
    with pytest.raises(KeyError), locked(tmp_path / "other" / "out", "busy"):
        raise KeyError
    assert not (tmp_path / "other").exists()


@pytest.mark.fast
@pytest.mark.parametrize("resume", [False, True])
def test_a_folder_with_nothing_but_an_unfinished_configuration_is_empty(tmp_path, resume):
    """What a process leaves that is killed while it writes its first file."""
    kind = FolderKind("sweep.toml", "sweep", ("seed",))
    (tmp_path / ".sweep.toml.0123456789ab.partial").write_text("see")
    create(tmp_path, kind, "seed = 0\n", resume)
    assert read_configuration(tmp_path, kind) == "seed = 0\n"


# --- exports ----------------------------------------------------------------------------------

FILES = {"a.c": "one", "b.c": "two", "c.h": "three"}


def manifest(files):
    return {"files": {name: export_folder._checksum(text.encode()) for name, text in files.items()}}


@pytest.mark.fast
@pytest.mark.parametrize("after", range(6))
def test_an_export_that_was_stopped_anywhere_runs_again(tmp_path, monkeypatch, after):
    """Over an earlier export: stopped after so many files, then whole, with nothing left over."""
    out, earlier = tmp_path / "c", {"a.c": "old", "z.c": "gone"}
    export_folder.write(out, earlier, manifest(earlier))
    done = []

    def stop(file, text):
        if len(done) == after:
            (out / f".{file.name}.partial").write_text("half")
            raise KeyboardInterrupt
        done.append(file)
        write_text(file, text)

    with monkeypatch.context() as patch:
        patch.setattr(export_folder, "write_text", stop)
        if after < 5:
            with pytest.raises(KeyboardInterrupt):
                export_folder.write(out, FILES, manifest(FILES))
        else:
            export_folder.write(out, FILES, manifest(FILES))
    export_folder.write(out, FILES, manifest(FILES))
    left = {file.name: file.read_text() for file in out.iterdir()}
    assert json.loads(left.pop("export.json")) == manifest(FILES) and left == FILES


@pytest.mark.fast
def test_an_export_stopped_before_its_first_file(tmp_path):
    (tmp_path / ".export.json.x.partial").write_text("{")
    export_folder.write(tmp_path, FILES, manifest(FILES))
    assert {file.name for file in tmp_path.iterdir()} == {*FILES, "export.json"}


@pytest.mark.fast
@pytest.mark.parametrize(
    "name", ["../victim.txt", "{}/victim.txt", "sub/../../victim.txt", "..\\v"]
)
def test_a_foreign_manifest_names_nothing_outside_its_folder(tmp_path, name):
    victim, out = tmp_path / "victim.txt", tmp_path / "c"
    victim.write_text("mine")
    out.mkdir()
    foreign = {"files": {name.format(tmp_path): export_folder._checksum(b"mine")}}
    (out / "export.json").write_text(json.dumps(foreign))
    with pytest.raises(ValueError, match="which is no file of it"):
        export_folder.write(out, FILES, manifest(FILES))
    assert victim.read_text() == "mine" and [f.name for f in out.iterdir()] == ["export.json"]


@pytest.mark.fast
@pytest.mark.parametrize(
    "text", ["[]", "null", "3", '{"files": []}', '{"files": {"a": []}}', "[" * 9999]
)
def test_a_damaged_manifest_is_no_export(command, text):
    Path("c").mkdir()
    Path("c/export.json").write_text(text)
    answer = command("export", "pi-circle", "--out", "c")
    assert answer.status == 2 and "holds no export; choose another one" in answer.err


@pytest.mark.fast
def test_a_link_out_of_an_export_is_not_followed(tmp_path):
    out = tmp_path / "c"
    export_folder.write(out, FILES, manifest(FILES))
    (out / "a.c").unlink()
    (tmp_path / "victim.txt").write_text("one")
    (out / "a.c").symlink_to(tmp_path / "victim.txt")
    with pytest.raises(ValueError, match=r"a\.c is not as it was exported"):
        export_folder.write(out, FILES, manifest(FILES))


# --- damaged results --------------------------------------------------------------------------

WHOLE = {
    "run.json": ("run.json",),
    "compare.json": ("compare.json",),
    "summary.json": ("sweep.toml", "summary.json"),
    "tune.json": ("tune.toml", "tune.json"),
    "demo.json": ("demo.toml", "demo.json"),
}
DAMAGED = ("", "{", "[]", "null", "3", '"text"', "{}", '{"loops": 3}', "[" * 9999, "\xff")


@pytest.mark.fast
@pytest.mark.parametrize("name", WHOLE)
@pytest.mark.parametrize("text", DAMAGED, ids=range(len(DAMAGED)))
def test_a_report_names_the_damaged_file(command, name, text):
    Path("results").mkdir()
    for file in WHOLE[name]:
        Path("results", file).write_text("a = 1\n")
    Path("results", name).write_bytes(text.encode("latin-1"))
    answer = command("report", "results")
    assert answer.status == 2 and answer.err.count("\n") == 1
    assert f"{name} is not what this version writes" in answer.err
    assert not Path("results/report.html").exists()


# --- work without bounds ----------------------------------------------------------------------


def test_a_sweep_without_end_is_refused_before_anything_is_drawn(command, monkeypatch):
    """2e7 runs of 1e5 ticks and 1 substep are 2e12 steps; at 1e6 a second and core a day has
    8.6e10."""
    few_figures(monkeypatch)

    def drawn(*_):
        raise AssertionError

    monkeypatch.setattr("tuning.sweeps.configuration._check_draws", drawn)
    words = ("sweep", "pi-circle", *SHORT, "--out", "new", "--cores", "1")
    answer = command(*words, "--set", "lap_time=10", "-n", "20000000")
    assert answer.status == 2 and "2e+12 plant steps, about 23.1 days on 1 cores" in answer.err
    assert "--force simulates them" in answer.err and not Path("new").exists()
    wrong = command(*words, "--spec", "contour_mx_um < 2")
    assert wrong.status == 2 and "did you mean 'contour_max_um'" in wrong.err


@pytest.mark.parametrize("word", ["lap_time=4e3", "feed=1e-4"])
def test_a_lap_that_does_not_fit_is_refused_before_it_is_made(command, monkeypatch, word):
    monkeypatch.setattr("jaxstage.references.timing.memory_bytes", lambda: 16e9)
    answer = command("run", "pi-circle", "--set", word)
    assert answer.status == 2 and "GB while it is made, half the memory here is 8 GB" in answer.err
    assert "must be <= 285.7 s at this dt" in answer.err


# --- files of a user --------------------------------------------------------------------------

GAINS = "[gains]\nslope = -1.0  # größe\n"


@pytest.mark.fast
@pytest.mark.parametrize(
    ("data", "says"),
    [
        (GAINS.encode("utf-8-sig"), "g.toml:2: gains.slope (x) [c1] = -1 1/s"),
        (GAINS.encode("utf-16"), "g.toml: save it as UTF-8"),
        (GAINS.encode("cp1252"), "g.toml: save it as UTF-8"),
        (b"a = " + b"[" * 5000 + b"]" * 5000, "g.toml: tables or lists are nested too deep"),
        (b"[" + b".".join([b"a"] * 5000) + b"]", "g.toml: tables or lists are nested too deep"),
        (b"#" * 10_000_001, "g.toml: larger than 10 MB"),
    ],
)
@pytest.mark.parametrize("option", ["--gains", "--scenario"])
def test_a_file_that_is_no_text(command, option, data, says):
    Path("g.toml").write_bytes(data)
    answer = command("run", "pi-circle", option, "g.toml")
    if option == "--scenario":
        says = says.replace("gains.slope (x) [c1] = -1 1/s", "'gains.slope' is not in [plant]")
    assert answer.status == 2 and says in answer.err and answer.err.count("\n") == 1


@pytest.mark.fast
def test_a_pipe_is_read_once_and_not_waited_for_without_end(command, monkeypatch):
    os.mkfifo("pipe")
    writer = threading.Thread(target=Path("pipe").write_text, args=("[gains]\nslope = -1.0\n",))
    writer.start()
    answer = command("run", "pi-circle", "--gains", "pipe")
    writer.join()
    assert answer.status == 2 and "pipe:2: gains.slope (x) [c1] = -1 1/s" in answer.err
    monkeypatch.setattr("jaxstage.system.files.PATIENCE", 0.2)
    waited = command("run", "pi-circle", "--gains", "pipe")
    assert waited.status == 2 and "a pipe to which nobody has written for 0.2 s" in waited.err
