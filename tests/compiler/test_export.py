"""The controllers of the studies as C99: the demands of JAX, on a PC and on a Cortex-M4."""

import functools
import hashlib
import json
import re
import shutil
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.c_export import export
from jaxstage.c_export.export import RecordedTicks, c_files
from jaxstage.c_export.law_graph import trace
from jaxstage.c_export.replay import ARM, BOUND
from jaxstage.model.fields import replace
from jaxstage.model.signals import Measurement, Setpoint
from jaxstage.studies import all_studies, build
from tests.compiler.cortex_m4 import machine
from tests.helpers.c_driver import SANE, STRICT, drive, identity, law_files, run, written
from tuning.app import main
from tuning.app.export_folder import recorded

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler here")
CROSS = shutil.which(machine.COMPILER)
needs_cross = pytest.mark.skipif(
    CROSS is None, reason="no arm-none-eabi-gcc (gcc-arm-none-eabi, libnewlib-arm-none-eabi)"
)
needs_machine = pytest.mark.skipif(
    shutil.which("qemu-system-arm") is None, reason="no qemu-system-arm here"
)

#: one loop of each study, and whether its law is told something after its step
LOOPS = {"dfcmac-circle": False, "af-pid-ccc": True, "asmc-mrac": True, "asmc-s4": False}
CLOSED = ("dfcmac-circle", "af-pid-ccc")


@functools.cache
def ticks(name):
    """A loop and 1000 ticks for its law: of the closed loop, or of a machine that sways."""
    case = build(name)
    return case, recorded(case) if name in CLOSED else swaying(case)


def swaying(case):
    """The commanded motion, and a machine that goes round it in ever larger errors."""
    count = np.arange(1000, dtype=np.int32)
    wanted = jax.vmap(case.loop.reference.sample, (None, 0))(case.path, count)
    size, phase = 1e-4 * count[:, None] / 1000, 0.05 * count[:, None]
    position = wanted.position - size * np.sin(phase)
    velocity = wanted.velocity - size * np.cos(phase) * 0.05 / case.loop.dt
    seen = Measurement(
        position=position, velocity=velocity, drive_position=position, drive_velocity=velocity
    )
    return RecordedTicks(wanted, seen, np.zeros_like(position), np.zeros_like(position))


@functools.cache
def texts(name, single=False, axis=None):
    """The C files of a loop."""
    case, rows = ticks(name)
    return c_files(name, case.loop, case.gains, case.scenario, rows, "0", single, axis)


def difference(printed):
    """The relative difference that a replay prints when it passes."""
    assert printed.startswith(b"1000 ticks") and printed.endswith(b"passed\n")
    return float(re.search(rb": (\S+), bound", printed)[1])


# --- the same demands -------------------------------------------------------------------------


@pytest.mark.parametrize("single", [False, True], ids=["double", "single"])
@pytest.mark.parametrize("name", LOOPS)
def test_c_demands_what_jax_demands(name, single, tmp_path):
    """1000 ticks through the Makefile that is exported, sanitizers watching."""
    files = texts(name, single)
    assert ("control_settle" in files["control.h"]) == LOOPS[name]
    written(files, tmp_path)
    printed = run("make", "-s", f"CFLAGS=-O1 -Werror {' '.join(SANE)}", "check", cwd=tmp_path)
    assert BOUND == {False: 1e-12, True: 1e-4}
    assert 0 < difference(printed) <= BOUND[single]


@pytest.mark.parametrize("name", CLOSED)
def test_the_recorded_demands_are_those_of_the_simulation(name):
    case, rows = ticks(name)
    found = export._follow(case.loop, case.gains, case.scenario, rows.setpoint, rows.measurement)
    for ours, theirs in ((found.demand, rows.demand), (found.command, rows.command)):
        scale = np.max(np.abs(theirs))
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * scale)


def test_the_memory_in_c_is_the_memory_in_jax(tmp_path):
    case, rows = ticks("af-pid-ccc")
    _, memory = drive(
        case.loop.controller, case.gains, rows.setpoint, rows.measurement, rows.command,
        case.loop.dt, tmp_path,
    )  # fmt: skip
    wanted = [np.asarray(leaf).reshape(1000, -1) for leaf in jax.tree.leaves(rows.memory)]
    start = 0
    for leaf in wanted:
        ours = memory[:, start : start + leaf.shape[1]]
        start += leaf.shape[1]
        np.testing.assert_allclose(ours, leaf, rtol=1e-10, atol=1e-12 * np.max(np.abs(leaf)))
    assert start == memory.shape[1]


def test_a_wrong_gain_fails_the_check(tmp_path):
    files = texts("dfcmac-circle")
    changed = files["control_gains.c"].replace(".slope = {1.0, 1.0}", ".slope = {1.0, 1.001}")
    assert changed != files["control_gains.c"]
    written(files | {"control_gains.c": changed}, tmp_path)
    run("make", "-s", "replay", cwd=tmp_path)
    assert b"FAILED" in run("./replay", cwd=tmp_path, status=1)


def test_one_axis_is_the_whole_law_for_that_axis(tmp_path):
    files = texts("dfcmac-circle", axis="y")
    assert "control_real slope; /* [1/s] c1" in files["control.h"]
    assert "control_real weights[36];" in files["control.h"]
    written(files, tmp_path)
    assert difference(run("make", "-s", "check", cwd=tmp_path)) <= 1e-12


def test_axes_that_are_coupled_do_not_come_apart():
    with pytest.raises(ValueError, match=r"one axis: memory.extra.error.\w+ of an axis depends"):
        texts("af-pid-ccc", axis="x")


# --- every law --------------------------------------------------------------------------------


#: endings of names that stand for another path or drive, under the same law
SAME_LAW = ("-bowknot", "-heart", "-star", "-helix", "-r", "-motor")


@functools.cache
def laws():
    """A case for every controller and shape of gains of the studies."""
    found = {}
    for entry in (entry for study in all_studies for entry in study.loops):
        if not entry.name.endswith(SAME_LAW):
            stored = entry.name.endswith("-circle")  # a short lap: fewer points to compute
            timing = replace(entry.timing, lap_time=0.05) if stored else entry.timing
            case = entry.build(timing)
            shapes = tuple(leaf.shape for leaf in jax.tree.leaves(case.gains))
            found.setdefault((case.loop.controller, shapes), case)
    return tuple(found.values())


def traced(case, single):
    """The law of a case, scalar by scalar."""
    real = np.float32 if single else np.float64
    axes, none = np.zeros(len(case.loop.plant.axes), real), np.zeros((), real)
    setpoint = Setpoint(
        position=axes, velocity=axes, acceleration=axes, tangent=axes, curvature=none
    )
    seen = Measurement(position=axes, velocity=axes, drive_position=axes, drive_velocity=axes)
    gains = jax.tree.map(lambda x: np.asarray(x, real), case.gains)
    with jax.enable_x64(not single):
        return trace(case.loop.controller, gains, setpoint, seen, case.loop.dt, "A")


@functools.cache
def every_law(folder, single):
    """All laws in one folder, each under its own prefix."""
    for number, case in enumerate(laws()):
        law = traced(case, single)
        what = identity(case.loop.controller, law.axes, single, f"law{number}")
        files = law_files(law, what)
        assert all(text.isascii() for text in files.values())
        written(files, folder)
    return sorted(file.name for file in folder.glob("*.c"))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Where the laws lie in double and in single precision."""
    return {single: tmp_path_factory.mktemp("laws") for single in (False, True)}


@pytest.mark.parametrize("single", [False, True], ids=["double", "single"])
def test_every_law_of_the_studies_is_c99(single, folders):
    files = every_law(folders[single], single)
    assert len(laws()) >= 27 and len(files) == 2 * len(laws())
    promoted = ["-Wdouble-promotion"] if single else []
    for compiler in filter(shutil.which, ("gcc", "clang")):
        run(compiler, *STRICT, *promoted, "-fsyntax-only", *files, cwd=folders[single])


@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler here")
def test_the_headers_can_be_used_from_c_plus_plus(folders):
    every_law(folders[False], False)
    headers = sorted(file.name for file in folders[False].glob("*.h"))
    text = "".join(f'#include "{name}"\n' for name in headers)
    strict = ("-std=c++11", "-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only")
    run("g++", *strict, "-x", "c++", "-", cwd=folders[False], given=text.encode())


def test_the_float_build_knows_no_double(folders):
    every_law(folders[True], True)
    for file in folders[True].glob("*.[ch]"):
        code = re.sub(r"/\*.*?\*/", "", file.read_text(encoding="utf-8"), flags=re.DOTALL)
        assert not re.findall(r"\bdouble\b|\b\d+\.\d*(?:e[+-]?\d+)?(?![\def])", code)
        assert not re.findall(r"\b(?:exp|tanh|sqrt|floor|fabs)\(", code)


@needs_cross
def test_every_law_builds_for_a_cortex_m4(folders):
    files = every_law(folders[True], True)
    small = ["-Os", *ARM.split(), "-Wdouble-promotion", "-c"]
    run(CROSS, *STRICT, *small, *files, cwd=folders[True])
    symbols = run("arm-none-eabi-nm", "-u", *Path(folders[True]).glob("*.o"), cwd=folders[True])
    called = {line.split()[1].decode() for line in symbols.splitlines() if b" U " in line}
    assert called == {"expf", "tanhf", "sqrtf", "floorf"}  # no __aeabi_d..., no malloc


@needs_cross
@needs_machine
@pytest.mark.parametrize("name", LOOPS)
def test_the_law_runs_on_a_cortex_m4(name, tmp_path):
    written(texts(name, single=True), tmp_path)
    machine.build(tmp_path, "replay.c")
    printed = machine.emulate(tmp_path).encode()
    assert difference(printed) <= BOUND[True]


# --- what is refused --------------------------------------------------------------------------


def test_gains_that_are_no_numbers_are_refused():
    case, rows = ticks("dfcmac-circle")
    gains = replace(case.gains, slope=jnp.array([1.0, jnp.nan]))
    with pytest.raises(ValueError, match=r"gains.slope \(y\) \[c1\] = nan 1/s: must be > 0"):
        c_files("a loop", case.loop, gains, case.scenario, rows, "0")
    single = replace(rows, demand=rows.demand.astype(jnp.float32))
    with pytest.raises(ValueError, match="double precision"):
        c_files("a loop", case.loop, case.gains, case.scenario, single, "0")


@pytest.fixture
def command(monkeypatch, capsys, tmp_path):
    """The command line in this process, which has already started JAX, in an empty folder."""
    monkeypatch.setattr("jaxstage.system.runtime.configure", lambda *_, **__: None)
    monkeypatch.chdir(tmp_path)

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["jaxstage", "export", *map(str, words)])
        with pytest.raises(SystemExit) as stopped:
            main.main()
        captured = capsys.readouterr()
        return stopped.value.code or 0, captured.out, captured.err

    return call


def test_the_command_writes_what_passes_its_own_check(command, tmp_path):
    status, out, err = command("dfcmac-circle", "--out", "c", "--precision", "single")
    assert (status, err) == (0, "") and "1000 ticks" in out
    folder = tmp_path / "c"
    assert difference(run("make", "-s", "check", cwd=folder)) <= BOUND[True]
    manifest = json.loads((folder / "export.json").read_text())
    assert manifest["files"].keys() | {"export.json", "replay"} == {
        f.name for f in folder.iterdir()
    }
    text = (folder / "README.txt").read_text()
    assert "control_step(&gains, &memory, &setpoint, &measurement, demand);" in text
    # once more over its own files, with another gain and another name
    status, _, err = command("dfcmac-circle", "--out", "c", "--set", "gains.c1=2", "--prefix", "xy")
    assert (status, err) == (0, "") and not (folder / "control.c").exists()
    assert ".slope = {2.0, 2.0}, /* 1/s */" in (folder / "xy_gains.c").read_text()
    # never over what somebody wrote
    (folder / "xy.c").write_text("my own\n")
    before = {f.name: f.read_bytes() for f in folder.iterdir()}
    status, out, err = command("dfcmac-circle", "--out", "c")
    assert (status, out) == (2, "") and "xy.c is not as it was exported" in err
    assert before == {f.name: f.read_bytes() for f in folder.iterdir()}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("dfcmac", "--out", "c"), "unknown loop 'dfcmac'; did you mean"),
        (("dfcmac-circle",), "--out DIR is needed"),
        (("dfcmac-circle", "--out", "c", "--lang", "rust"), "--lang rust: must be c"),
        (("dfcmac-circle", "--out", "c", "--precision", "half"), "must be single or double"),
        (("dfcmac-circle", "--out", "c", "--axis", "z"), "axis 'z': must be one of x, y"),
        (("dfcmac-circle", "--out", "c", "--prefix", "2x"), "prefix '2x': must be a name in C"),
        (("dfcmac-circle", "--out", "c", "--set", "gains.c1=nan"), "must be > 0 1/s"),
        (("dfcmac-circle", "--out", "c", "--set", "start.offset=1"), "lost at its first tick"),
        (("dfcmac-circle", "--out", "full"), "not empty and holds no export"),
        (("dfcmac-circle", "--out", "full/a.txt/c"), "full/a.txt is not a folder"),
    ],
)
def test_a_wrong_use_is_one_clear_line(words, said, command, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a.txt").write_text("mine")
    status, out, err = command(*words)
    assert (status, out) == (2, "")
    assert said in err and err.count("\n") == 1
    assert not (tmp_path / "c").exists()
    assert (tmp_path / "full" / "a.txt").read_text() == "mine"


@pytest.mark.parametrize(
    "name", ["../victim.c", "{folder}/victim.c", "c/../../victim.c", "sub/own.c", "..", "sub"]
)
def test_a_foreign_manifest_deletes_nothing(name, command, tmp_path):
    """A manifest with right checksums, of files that no export writes."""
    name = name.format(folder=tmp_path)
    out, text = tmp_path / "c", b"mine\n"
    (out / "sub").mkdir(parents=True)
    files = [tmp_path / "victim.c", out / "sub" / "own.c", out / "notes.md"]
    for file in files:
        file.write_bytes(text)
    sums = {name: hashlib.sha256(text).hexdigest()}
    (out / "export.json").write_text(json.dumps({"files": sums}))
    status, printed, err = command("dfcmac-circle", "--out", "c")
    assert (status, printed) == (2, "")
    assert err.count("\n") == 1 and (
        "is no file of it" in err or "sub is not as it was exported" in err
    )
    assert [file.read_bytes() for file in files] == [text] * 3 and len([*out.iterdir()]) == 3


def test_a_link_in_the_folder_is_not_followed(command, tmp_path):
    victim, out = tmp_path / "victim.c", tmp_path / "c"
    victim.write_text("mine")
    out.mkdir()
    (out / "control.c").symlink_to(victim)
    (out / "export.json").write_text('{"files": {}}')
    status, _, err = command("dfcmac-circle", "--out", "c")
    assert status == 2 and err.count("\n") == 1
    assert victim.read_text() == "mine" and (out / "control.c").is_symlink()
