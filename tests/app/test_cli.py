"""The command line: what it prints, what it takes back, and how it refuses."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import pytest

from jaxstage import __version__, loop_names
from jaxstage.metrics.table import split_key
from tests.helpers.commanding import caller, few_figures, strict_json
from tests.helpers.documented import undocumented

ROOT = Path(__file__).parents[2]
#: a run of 200 ticks: one compilation serves all tests with the same loop
SHORT = ("--set", "lap_time=0.5", "--set", "laps=1", "--set", "scored=0")

SHORT_LAP = SHORT[:2]

SCHEMA = {
    "loop": str,
    "version": str,
    "jax": str,
    "precision": str,
    "dt_s": float,
    "duration_s": float,
    "lap_time_s": float,
    "laps": int,
    "scored": int,
    "scored_from_s": float,
    "scored_to_s": float,
    "scored_laps": float,
    "motion": dict,
    "verdict": str,
    "finite": bool,
    "left_path_at": type(None),
    "non_finite_at": type(None),
    "metrics": dict,
    "metrics_whole_run": dict,
    "notes": list,
}


#: figures that are counts or shares: without unit
SHARES = ("reversals", "saturated", "contour_beyond", "reaching_share")


@pytest.fixture
def cache(tmp_path_factory):
    """A cache folder that all of these tests share."""
    return tmp_path_factory.getbasetemp() / "cache"


@pytest.fixture
def jaxstage(monkeypatch, capsys, tmp_path, cache):
    """Call the command line in this process, in an empty folder."""
    kept = {
        name: getattr(jax.config, name)
        for name in (
            "jax_enable_x64",
            "jax_compilation_cache_dir",
            "jax_persistent_cache_min_compile_time_secs",
        )
    }
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))

    yield caller(monkeypatch, capsys)
    for name, value in kept.items():
        jax.config.update(name, value)


def process(*words, cwd, cache):
    """Call the command line as a program of its own."""
    return subprocess.run(
        [sys.executable, "-c", "from tuning.app.main import main; main()", *words],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(cache)},
        check=False,
    )


# --- list, help, version ------------------------------------------------------------------------


@pytest.mark.fast
def test_list_shows_every_loop_and_its_source(jaxstage):
    result = jaxstage("list")
    assert result.status == 0 and result.err == ""
    words = result.out.split()
    assert all(name in words for name in loop_names())
    assert "10.3390/en14227802" in result.out


@pytest.mark.fast
def test_version_and_help(jaxstage):
    assert jaxstage("--version").out.strip() == __version__
    text = jaxstage("run", "--help")
    assert text.status == 0
    for option in (
        "--set",
        "--gains",
        "--scenario",
        "--duration",
        "--precision",
        "--json",
        "--out",
    ):
        assert option in text.out


# --- one JSON object ----------------------------------------------------------------------------


def test_json_is_one_object_of_the_schema(jaxstage):
    result = jaxstage("run", "dfcmac-circle", "--json", *SHORT)
    assert result.status == 0 and result.err == ""
    found = result.json
    assert list(found) == list(SCHEMA)
    for key, kind in SCHEMA.items():
        assert type(found[key]) is kind, key
    assert found["loop"] == "dfcmac-circle" and found["version"] == __version__
    assert found["precision"] == "double" and found["notes"] == []
    assert found["dt_s"] == 1e-4 and found["lap_time_s"] == 0.5
    assert found["duration_s"] == pytest.approx(0.5) and found["laps"] == 1
    assert found["scored"] == 0 and found["finite"] and found["motion"] == {}


def test_figures_are_numbers_or_one_per_axis(jaxstage):
    found = jaxstage("run", "dfcmac-circle", "--json", *SHORT).json
    assert found["metrics"].keys() == found["metrics_whole_run"].keys()
    assert found["metrics"] == found["metrics_whole_run"], "scored=0 is the whole run"
    for key, value in found["metrics"].items():
        numbers = value.values() if isinstance(value, dict) else [value]
        assert not isinstance(value, dict) or list(value) == ["x", "y"], key
        assert all(n is None or type(n) in (int, float) for n in numbers), key
        assert split_key(key)[1] or key.startswith(SHARES), f"{key}: no unit"
    for key in ("ate_um", "tesd_um", "contour_rms_um", "contour_max_um"):
        assert found["metrics"][key] > 0
    assert set(found["metrics"]["command_rms_A"]) == {"x", "y"}


def test_json_and_table_say_the_same(jaxstage):
    found = jaxstage("run", "dfcmac-circle", "--json", *SHORT).json
    text = jaxstage("run", "dfcmac-circle", *SHORT)
    assert text.status == 0
    assert (
        "complete; contour error" in text.out
        and "whole run" in text.out
        and "double precision" in text.out
    )
    assert found["verdict"] in text.out
    assert f"{found['metrics']['contour_rms_um']:.4f}" in text.out
    assert text.out.count("\n") > 20


def test_a_feed_a_scored_lap_and_a_part_lap(jaxstage, monkeypatch):
    """Two laps and a half: the second is scored; the whole run is something else."""
    few_figures(monkeypatch)
    found = jaxstage(
        "run", "pi-circle", "--json", "--set", "feed=300000", "--duration", "0.0785"
    ).json
    # circumference 157.08 mm at 300 m/min = 5 m/s
    assert found["lap_time_s"] == pytest.approx(0.15708 / 5, rel=5e-3)
    assert found["scored"] == 2 and found["laps"] == 2.5
    assert found["duration_s"] == pytest.approx(0.0785)
    assert found["metrics"]["ate_um"] != found["metrics_whole_run"]["ate_um"]


# --- settings -----------------------------------------------------------------------------------


def test_a_setting_by_path_symbol_or_suffix_is_the_same(jaxstage):
    plain = jaxstage("run", "dfcmac-circle", "--json", *SHORT).json["metrics"]
    found = [
        jaxstage("run", "dfcmac-circle", "--json", *SHORT, "--set", f"{name}=2").json["metrics"]
        for name in ("gains.slope", "gains.c1", "slope", "c1")
    ]
    assert found[0] == found[1] == found[2] == found[3] != plain
    per_axis = jaxstage("run", "dfcmac-circle", "--json", *SHORT, "--set", "c1=2, 2").json
    assert per_axis["metrics"] == found[0]


def test_timing_settings(jaxstage, monkeypatch):
    few_figures(monkeypatch)
    words = ("lap_time=0.03", "laps=2", "scored=1", "dt=2e-4", "substeps=2")
    found = jaxstage("run", "pi-circle", "--json", *(w for k in words for w in ("--set", k))).json
    assert found["lap_time_s"] == pytest.approx(0.03)
    assert (found["laps"], found["scored"]) == (2, 1)
    assert found["dt_s"] == 2e-4 and found["duration_s"] == pytest.approx(0.06)


def test_a_changed_plant_says_what_the_law_still_assumes(jaxstage):
    words = ("run", "dfcmac-circle", "--json", *SHORT, "--set", "plant.mass=0.0035,0.003")
    result = jaxstage(*words)
    (note,) = result.json["notes"]
    assert result.err.strip() == f"jaxstage: {note}"
    assert "plant.mass" in note and "nominal.mass = 0.003, 0.0028" in note
    told = jaxstage(*words, "--set", "nominal.mass=0.0035,0.003")
    assert told.json["notes"] == [] and told.err == ""
    assert told.json["metrics"] != result.json["metrics"]
    same = jaxstage("run", "dfcmac-circle", "--json", *SHORT, "--set", "plant.mass=0.003,0.0028")
    assert same.json["notes"] == [], "nothing was changed"


def test_single_precision(jaxstage):
    result = jaxstage("run", "dfcmac-circle", *SHORT, "--precision", "single", "--json")
    assert result.status == 0 and result.json["precision"] == "single"
    double = jaxstage("run", "dfcmac-circle", *SHORT, "--json").json
    assert double["precision"] == "double"
    a, b = result.json["metrics"]["ate_um"], double["metrics"]["ate_um"]
    assert a != b and a == pytest.approx(b, rel=1e-2)


def test_what_out_writes_the_options_take_back(jaxstage):
    """gains.toml and scenario.toml give the identical figures; run.json is what --json prints."""
    words = ("--set", "c1=1.7", "--set", "plant.mass=0.0031,0.0029", "--set", "start.offset=1e-4")
    first = jaxstage("run", "dfcmac-circle", *SHORT, *words, "--out", "deep/out", "--json")
    assert first.status == 0
    out = Path("deep/out")
    written = {file.name for file in out.iterdir()}
    assert {"run.json", "gains.toml", "scenario.toml"} <= written
    assert sum(name.endswith(".png") for name in written) >= 3
    assert not [name for name in written if "partial" in name]
    assert strict_json((out / "run.json").read_text()) == first.json
    back = jaxstage(
        "run", "dfcmac-circle", *SHORT, "--json",
        "--gains", out / "gains.toml", "--scenario", out / "scenario.toml",
    )  # fmt: skip
    assert back.json["metrics"] == first.json["metrics"]
    assert (
        jaxstage("run", "dfcmac-circle", *SHORT, "--json").json["metrics"] != first.json["metrics"]
    )


# --- a run that is lost -------------------------------------------------------------------------


def test_a_lost_run_is_a_result_without_figures(jaxstage, monkeypatch):
    few_figures(monkeypatch)
    words = ("run", "dfcmac-circle", "--set", "dt=1e-3", "--set", "lap_time=1", "--set", "laps=2")
    found = jaxstage(*words, "--json")
    assert found.status == 0
    lost = found.json
    assert type(lost["left_path_at"]) is int and 0 < lost["left_path_at"] < 2000
    assert lost["finite"] is False and lost["non_finite_at"] is None
    for metrics in (lost["metrics"], lost["metrics_whole_run"]):
        for value in metrics.values():
            assert set(value.values() if isinstance(value, dict) else [value]) == {None}
    text = jaxstage(*words)
    assert text.status == 0
    tick = lost["left_path_at"]
    assert f"LOST at t = {tick:.4g} ms (tick {tick} of 2000)" in text.out
    assert "following error above 100 mm" in text.out and lost["verdict"] in text.out
    assert "RMS" not in text.out


# --- wrong uses ---------------------------------------------------------------------------------


def in_folder(name, text):
    Path(name).write_text(text)
    return name


WRONG = {
    "misspelt loop": (["run", "dfcmac-cirle"], "did you mean 'dfcmac-circle'"),
    "unknown command": (["runn", "pi-circle"], "runn"),
    "no loop": (["run"], "loop"),
    "unknown setting": (["run", "pi-circle", "--set", "gains.slop=1"], "did you mean"),
    "ambiguous": (["run", "dfcmac-circle", "--set", "mass=1"], "plant.mass"),
    "no value": (["run", "pi-circle", "--set", "slope"], "NAME=VALUE"),
    "empty value": (["run", "pi-circle", "--set", "slope="], "NAME=VALUE"),
    "not a number": (["run", "pi-circle", "--set", "slope=fast"], "slope=fast"),
    "too many": (["run", "pi-circle", "--set", "slope=1,2,3"], "one number or 2"),
    "two for one": (["run", "pi-circle", "--set", "lap_time=1,2"], "must be one number"),
    "out of range": (["run", "pi-circle", "--set", "plant.mass=-1"], "must be > 0 kg"),
    "nan": (["run", "pi-circle", "--set", "plant.mass=nan"], "plant.mass (x) [M] = nan kg"),
    "friction": (["run", "pi-circle", "--set", "plant.static=0.1"], "must be >= coulomb"),
    "dt": (["run", "pi-circle", "--set", "dt=0"], "dt = 0.0: must be > 0 s"),
    "laps": (["run", "pi-circle", "--set", "laps=1.5"], "must be a whole number"),
    "laps inf": (["run", "pi-circle", "--set", "laps=inf"], "must be a whole number"),
    "substeps": (["run", "pi-circle", "--set", "substeps=0"], "substeps = 0"),
    "scored": (["run", "pi-circle", "--set", "laps=2", "--set", "scored=3"], "1..2"),
    "duration": (["run", "pi-circle", "--duration", "-1"], "duration = -1.0: must be > 0 s"),
    "duration word": (["run", "pi-circle", "--duration", "long"], "--duration"),
    "precision": (["run", "pi-circle", "--precision", "half"], "must be single or double"),
    "option": (["run", "pi-circle", "--fast"], "--fast"),
    "no file": (["run", "pi-circle", "--gains", "missing.toml"], "missing.toml: no such file"),
    "no scenario": (["run", "pi-circle", "--scenario", "no.toml"], "no.toml: no such file"),
    "file is folder": (["run", "pi-circle", "--gains", "."], "."),
    "out is a file": (["run", "pi-circle", "--out", "/dev/null"], "/dev/null"),
    "out in a file": (["run", "pi-circle", "--out", "/dev/null/out"], "not a folder"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_use_is_one_line_and_status_2(jaxstage, case):
    (command, *words), says = WRONG[case]
    first = [] if case == "no loop" else words[:1]
    result = jaxstage(command, *first, *SHORT_LAP, *words[1:], "--json")
    assert result.status == 2
    assert result.out == ""
    assert result.err.startswith("jaxstage: ") and result.err.count("\n") == 1, result.err
    assert says in result.err
    assert "Traceback" not in result.err
    assert list(Path().iterdir()) == [], "something was written"


@pytest.mark.parametrize(
    ("option", "text", "says"),
    [
        ("--gains", "[gains]\nslope = [1.0, \n\nrate == 2\n", "bad.toml: "),
        ("--gains", "[gains]\nslope = -1.0\n", "bad.toml:2: gains.slope (x) [c1] = -1 1/s"),
        ("--gains", "[gains]\n\nslpe = 1.0\n", "bad.toml:3: unknown setting 'gains.slpe'"),
        ("--gains", "[plant]\nmass = 1.0\n", "bad.toml:2: 'plant.mass' is not in [gains]"),
        ("--scenario", "[gains]\nslope = 1\n", "bad.toml:2: 'gains.slope' is not in [plant]"),
        ("--scenario", "[plant]\nmass = 'x'\n", "bad.toml:2: plant.mass = x: must be a number"),
        ("--scenario", "seed = 'x'\n", "bad.toml:1: seed = x: must be a whole number"),
    ],
)
def test_a_bad_file_is_one_line_with_its_place(jaxstage, option, text, says):
    file = in_folder("bad.toml", text)
    result = jaxstage("run", "dfcmac-circle", *SHORT_LAP, option, file, "--json")
    assert result.status == 2 and result.out == ""
    assert result.err.startswith("jaxstage: ") and result.err.count("\n") == 1
    assert says in result.err
    if "==" in text:
        assert "line 4" in result.err
    assert [p.name for p in Path().iterdir()] == ["bad.toml"]


def test_a_folder_without_permission(jaxstage, tmp_path):
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o500)
    if os.access(closed, os.W_OK):
        pytest.skip("this user may write everywhere")
    result = jaxstage("run", "pi-circle", *SHORT, "--out", closed / "out")
    assert result.status == 2 and "no permission" in result.err and result.out == ""


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that refuses files")
def test_a_folder_that_cannot_be_made(jaxstage):
    result = jaxstage("run", "dfcmac-circle", *SHORT, "--json", "--out", "/proc/nowhere/out")
    assert result.status == 2 and result.out == ""
    assert result.err.count("\n") == 1 and "/proc/nowhere" in result.err


# --- as a program ---------------------------------------------------------------------------------


def test_as_a_program(tmp_path, cache):
    """Standard output is the object alone; a wrong use ends with status 2."""
    here = dict(cwd=tmp_path, cache=cache)
    done = process("run", "dfcmac-circle", "--json", *SHORT, "--set", "plant.load=0.2", **here)
    assert done.returncode == 0
    found = strict_json(done.stdout)
    assert found["loop"] == "dfcmac-circle" and found["finite"]
    wrong = process("run", "pi-circl", **here)
    assert wrong.returncode == 2 and wrong.stdout == "" and wrong.stderr.count("\n") == 1


@pytest.mark.fast
def test_figure_names_split_into_name_and_unit():
    assert split_key("contour_rms_um") == ("contour rms", "um")
    assert split_key("command_variation_A_per_s") == ("command variation", "A/s")
    assert split_key("reversals") == ("reversals", "")


@pytest.mark.fast
def test_every_key_is_documented(jaxstage):
    found = jaxstage("run", "dfcmac-circle", "--json", *SHORT).json
    assert not undocumented((*found, *found["metrics"]))
