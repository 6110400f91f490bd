"""`jaxstage tune`: what it prints, keeps, takes up again and refuses."""

import csv
import os
import signal
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from tests.app.test_front import read
from tests.helpers.commanding import command as command
from tests.helpers.commanding import strict_json
from tests.helpers.documented import undocumented
from tuning.store.gains_file import read_gains, read_tuned
from tuning.store.prepare import prepare
from tuning.tuner.search.pareto_front import non_dominated

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
#: 200 ticks, two training runs, three held-out ones
TRAIN = """
[train]
plants = 1
[[train.contour]]
loop = "pi-circle"
set = ["lap_time=0.02", "laps=1", "scored=0"]
[held_out]
plants = 3
[[held_out.contour]]
loop = "pi-star"
set = ["lap_time=0.04", "laps=1", "scored=0"]
"""
WORDS = ("--set", "lap_time=0.02", "--set", "laps=1", "--set", "scored=0", "--train", "train.toml")
SMALL = (
    "tune",
    "pi-circle",
    *WORDS,
    "--gains",
    "c1,K:tied",
    "--method",
    "random",
    "--starts",
    "1",
    "--budget",
    "80",
    "--margin",
    "0",
)
EXTRAS = ("--baseline", "cma", "--pareto")


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory):
    """Compiled programs, shared by the calls of this file and the processes that it starts."""
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}
    folder = tmp_path_factory.mktemp("cache")
    for name, value in zip(names, (str(folder), 0.1), strict=True):
        jax.config.update(name, value)
    yield folder
    for name, value in before.items():
        jax.config.update(name, value)


@pytest.fixture(autouse=True)
def training_file(command):
    """In the folder where the command is called."""
    Path("train.toml").write_text(TRAIN)


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """The folder of one tuning, made by the first test that needs it."""
    return tmp_path_factory.mktemp("tuned") / "out"


def tuned(command, shared):
    """The answer about the shared tuning."""
    if not shared.exists():
        result = command(*SMALL, *EXTRAS, "--out", shared, "--json")
        assert result.status == 0, result.err
        assert result.json == strict_json((shared / "tune.json").read_text())
    return strict_json((shared / "tune.json").read_text())


def test_one_object_that_says_all(command, shared):
    found = tuned(command, shared)
    assert found["loop"] == "pi-circle" and found["method"] == "random" and found["n"] == 3
    assert 64 < found["units"] <= 80 and found["seconds"] > 0
    assert found["before"]["objective"] == pytest.approx(1.0)
    assert found["after"]["objective"] < 1 and found["accepted"] == (not found["refused"])
    held_out = found["held_out"]
    assert held_out["figure"] == "contour_rms_um" and held_out["runs"] == 3
    assert held_out["lost"] == held_out["lost_before"] == 0
    for key in ("before", "after", "change"):
        assert held_out[key]["low"] <= held_out[key]["value"] <= held_out[key]["high"]
    means = [held_out["figures"]["contour_rms_um"][key] for key in ("before", "after")]
    assert means == pytest.approx([held_out[key]["value"] for key in ("before", "after")])
    slopes = [found["gains"][f"gains.slope {axis}"] for axis in "xy"]
    assert all(one["before"] == 1.0 and one["unit"] == "1/s" for one in slopes)
    both = [found["gains"][f"gains.proportional_gain {axis}"] for axis in "xy"]
    ratios = [one["value"] / one["before"] for one in both]
    assert ratios[0] == pytest.approx(ratios[1], rel=0.1) and ratios[0] != 1.0, "tied"
    for one in (*slopes, *both):
        assert one["low"] <= one["value"] <= one["high"]
    validation = [found["diagnostics"][name] for name in ("exact", "half_step", "longer")]
    assert all(trial["lost"] == 0 and trial["before"] > 0 for trial in validation)
    assert found["scored"].keys() == {"loop", "training", "held_out"}
    for parts in found["scored"].values():
        assert all(part["scored_to_s"] > part["scored_from_s"] >= 0 for part in parts) and parts
    (other,) = found["baselines"]
    assert other["method"] == "cma" and other["objective"] <= 1
    assert other["units"] == pytest.approx(found["units"], rel=0.3)


def keys_of(found):
    """Every fixed key of an object; keys that are columns or labels are not followed."""
    named = ("figures", "gains", "gradient_error", "weights", "reference")
    for key, value in found.items():
        yield key
        if key in ("figures", "gradient_error", "weights", "reference") and value:
            continue
        if key in named:
            value = next(iter(value.values()), None) if value else None
        for inner in value if isinstance(value, list) else [value]:
            if isinstance(inner, dict):
                yield from keys_of(inner)


def test_every_key_is_documented(command, shared):
    assert not undocumented(keys_of(tuned(command, shared)))


def test_the_gains_are_taken_back(command, shared):
    """The file holds what was found, to the last bit, for `run` and to start from."""
    found = tuned(command, shared)
    (file,) = shared.glob("*gains.toml")
    assert file.name == ("gains.toml" if found["accepted"] else "refused-gains.toml")
    words = [word for word in WORDS[:6] if word != "--set"]
    gains = prepare("pi-circle", words, gains=read_gains(file)).case.gains
    slopes = [found["gains"][f"gains.slope {axis}"]["value"] for axis in "xy"]
    assert np.array_equal(gains.slope, slopes)
    assert [one.symbol for one in read_tuned(file)] == ["K", "c1"]
    started = command(*SMALL, "--gains", file, "--gains", "c1", "--budget", "0")
    assert "--budget 0" in started.err, "a file and names together are understood"


def test_history_and_pictures(command, shared):
    found = tuned(command, shared)
    with (shared / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    best = [float(row["objective"]) for row in rows]
    assert best == sorted(best, reverse=True) and float(rows[-1]["units"]) == found["units"]
    assert (
        best[-1] == pytest.approx(found["after"]["objective"]) or found["diagnostics"]["share"] < 1
    )
    with (shared / "baseline.csv").open() as file:
        methods = {row["method"] for row in csv.DictReader(file)}
    assert methods == {"random", "cma"}
    drawn = {file.name for file in shared.glob("*.png")}
    assert drawn == {
        "error.png",
        "history.png",
        "parameters.png",
        "held-out.png",
        "baseline.png",
        "pareto.png",
    }


def test_trade_offs(command, shared):
    """What is on the front, the suggestion, and gains to go with every point."""
    front = tuned(command, shared)["pareto"]
    columns = ["contour_rms_um", "energy_J", "chattering_A"]
    assert front["columns"] == columns
    points = np.array([[one["figures"][c] for c in columns] for one in front["points"]])
    kept = [one["on_front"] for one in front["points"]]
    assert kept == non_dominated(points).tolist() and 0 <= front["hypervolume"] < 1
    assert front["units"] <= 80 and front["note"] is None, "random search has no dear first step"
    (suggested,) = [i for i, one in enumerate(front["points"]) if one["suggested"]]
    assert kept[suggested]
    shares = np.array([[one["weights"][c] for c in columns] for one in front["points"][1:]])
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)
    for column, corner in zip(columns, np.eye(3), strict=True):
        nearest = int(np.argmax(shares @ corner)) + 1
        start = front["points"][0]["figures"][column]
        assert front["points"][nearest]["figures"][column] <= start * (1 + 1e-9), column
    with (shared / "pareto" / "pareto.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["on_front"] == "True" for row in rows] == kept
    words = [word for word in WORDS[:6] if word != "--set"]
    for i in range(len(points)):
        prepare("pi-circle", words, gains=read_gains(shared / "pareto" / f"gains-{i}.toml"))


def test_the_same_again_goes_on_and_another_configuration_says_what_differs(
    command, shared, monkeypatch
):
    whole = tuned(command, shared)
    monkeypatch.setattr("tuning.tuner.pictures.pictures", lambda *_: [])
    kept = sorted((shared / "journal" / "round-0").glob("*.npz"))
    kept[-1].unlink()
    refused = command(*SMALL, "--out", shared)
    assert refused.status == 2 and "holds this tuning already: --resume" in refused.err
    result = command(*SMALL, *EXTRAS, "--out", shared, "--resume")
    assert result.status == 0, result.err
    again = strict_json((shared / "tune.json").read_text())
    for key in (
        "gains",
        "after",
        "held_out",
        "units",
        "baselines",
        "pareto",
        "configuration_sha256",
    ):
        assert again[key] == whole[key], key
    for text in ("pi-circle", "random, 3 parameters", "held out", "slope x", "tune.json"):
        assert text in result.out, text
    other = command(*SMALL, "--seed", "3", "--resume", "--out", shared)
    assert other.status == 2 and other.err.count("\n") == 1
    assert "holds a tuning of another configuration; seed: 0 -> 3; " in other.err


REFUSED = """refused = ["with half the step 1 runs are lost"]
[gains]
slope = 3.0
"""


def test_refused_gains_are_marked_wherever_they_go(command):
    """`run` and its files, `sweep` and its answer, `compare`; and not where they were accepted."""
    Path("refused-gains.toml").write_text(REFUSED)
    Path("plain.toml").write_text("[gains]\nslope = 3.0\n")
    mark = "refused-gains.toml: these gains were REFUSED by their tuning: with half the step 1 runs"
    result = command("run", "pi-circle", *WORDS[:6], "--gains", "refused-gains.toml", "--out", "a")
    assert result.status == 0 and mark in result.err and "REFUSED gains. " in result.out
    written = strict_json(Path("a/run.json").read_text())
    assert any(mark in note for note in written["notes"])
    assert read_gains(Path("a/gains.toml")).refused == ("with half the step 1 runs are lost",)
    plain = command("run", "pi-circle", *WORDS[:6], "--gains", "plain.toml", "--json")
    assert "REFUSED" not in plain.out + plain.err
    swept = command(
        "sweep", "pi-circle", *WORDS[:6], "-n", "4", "--gains", "refused-gains.toml", "--out", "s"
    )
    assert swept.status == 0 and "pi-circle: these gains were REFUSED" in swept.out + swept.err
    answer = strict_json(Path("s/summary.json").read_text())
    assert any("pi-circle: these gains were REFUSED" in note for note in answer["notes"])
    Path("wrong.toml").write_text("refused = 1\n[gains]\nslope = 3.0\n")
    wrong = command("run", "pi-circle", "--gains", "wrong.toml")
    assert wrong.status == 2 and "wrong.toml:1: refused must be a list of reasons" in wrong.err


# --- reports -------------------------------------------------------------------------------------


def test_the_report_of_a_tuning(command, shared):
    found = tuned(command, shared)
    assert command("report", shared).status == 0
    reader = read((shared / "report.html").read_text(encoding="utf-8"))
    shown = reader.text
    first = "Accepted: the gains" if found["accepted"] else f"NOT accepted: {found['refused'][0]}"
    order = (first, "contour rms", "objective", "Gains", "Pictures", "What the", "Settings")
    places = [next(i for i, text in enumerate(shown) if text.startswith(t)) for t in order]
    assert places == sorted(places), "verdict first"
    held = next(text for text in shown if "on 3 plants never seen" in text)
    assert f"{100 * found['held_out']['change']['value']:+.1f} %" in held
    assert (
        set(reader.pictures) == {file.stem for file in shared.glob("*.png")} >= {"error", "history"}
    )
    assert reader.captions == len(reader.pictures)
    for label, one in found["gains"].items():
        row = shown.index(label.removeprefix("gains."))
        assert shown[row + 1 : row + 4] == [one["symbol"], f"{one['value']:.4g}", one["unit"]]
        assert shown[row + 5] == f"{one['before']:.4g}"
    (file,) = shared.glob("*gains.toml")
    assert file.read_text(encoding="utf-8").strip() in "\n".join(shown)
    assert f"jaxstage {found['version']}, jax {jax.__version__}" in shown
    assert shown[shown.index("seed") + 1] == "0"


def test_a_stopped_tuning_is_told_to_go_on(command, tmp_path):
    (tmp_path / "tune.toml").write_text("jaxstage = 0\n", encoding="utf-8")
    answer = command("report", tmp_path)
    assert answer.status == 2 and "with --resume finishes it" in answer.err


# --- kill -9 -------------------------------------------------------------------------------------

PROGRAM = """
import os, signal, sys
from pathlib import Path
import jax
jax.config.update("jax_enable_x64", True)
from tuning.tuner import configuration
from tuning.tuner import session
folder, last = Path(sys.argv[1]), int(sys.argv[2])
def step(now):
    if now.progress.step == last:
        os.kill(os.getpid(), signal.SIGKILL)
plan = configuration.build((folder / "tune.toml").read_text())
groups = configuration.groups_of(plan, configuration.runs_of(plan, "train"))
problem = configuration.problem_of(plan, groups)
watch = session.Observer(step, lambda text: None, other_plants=False)
(only,) = session.train_rounds(plan, problem, folder, watch)
print(only.tuned.z.tobytes().hex(), only.tuned.simulations)
"""


def process(folder, last, cache):
    """A process that trains into a folder and is killed after a step; -1: it is not."""
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, str(folder), str(last)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT), "JAX_COMPILATION_CACHE_DIR": str(cache)},
    )


def test_killed_in_the_middle_it_ends_at_the_same_gains(command, shared, cache, tmp_path):
    """`kill -9` after the second step; another process goes on from what was kept."""
    found = tuned(command, shared)
    whole = sorted((shared / "journal" / "round-0").glob("*.npz"))
    folder = tmp_path / "killed"
    folder.mkdir()
    (folder / "tune.toml").write_text((shared / "tune.toml").read_text())
    killed = process(folder, 2, cache)
    assert killed.returncode == -signal.SIGKILL and killed.stdout == ""
    kept = sorted((folder / "journal" / "round-0").glob("*.npz"))
    assert 2 < len(kept) < len(whole), "it was killed in the middle"
    before = [file.read_bytes() for file in kept]
    finished = process(folder, -1, cache)
    assert finished.returncode == 0, finished.stderr
    assert [file.read_bytes() for file in kept] == before, "nothing was simulated twice"
    z, simulations = finished.stdout.split()
    assert float(simulations) == pytest.approx(found["units"], abs=0.05)
    every = sorted((folder / "journal" / "round-0").glob("*.npz"))
    assert [file.name for file in every] == [file.name for file in whole]
    for mine, other in zip(every[2:], whole[2:], strict=True):
        with np.load(mine) as a, np.load(other) as b:
            np.testing.assert_allclose(a["objective"], b["objective"], rtol=1e-10)
    assert np.isfinite(np.frombuffer(bytes.fromhex(z))).all()


# --- refusals ------------------------------------------------------------------------------------

WRONG = {
    "loop": (["pi-cirle"], "unknown loop 'pi-cirle'; did you mean 'pi-circle'"),
    "no loop": ([], "Missing argument"),
    "gain": (["pi-circle", "--gains", "slop"], "did you mean"),
    "no gain": (["pi-circle", "--gains", "c1:fixed"], "nothing to tune"),
    "bounds": (["pi-circle", "--gains", "c1=9..3"], "low = 9 must be below high = 3"),
    "outside": (["pi-circle", "--gains", "c1=2..3"], "gains.slope = 1 is outside its box 2..3"),
    "form": (["pi-circle", "--gains", "c1=2"], "--gains c1=2: must be NAME"),
    "gains file": (["pi-circle", "--gains", "no.toml"], "no.toml: no such file"),
    "metric": (
        ["pi-circle", "--objective", "contour_rmz_um"],
        "unknown metric 'contour_rmz_um'; did you mean 'contour_rms_um'",
    ),
    "goal": (
        ["pi-circle", "--goal", "contour_mx_um < 3"],
        "unknown column 'contour_mx_um'; did you mean 'contour_max_um'",
    ),
    "no goal": (["pi-circle", "--goal", "contour_max_um"], "--goal"),
    "surrogate": (["pi-circle", "--surrogate", "soft"], "--surrogate soft: must be one of none"),
    "no friction": (["none", "--surrogate", "creeping"], "has no dry friction that sticks"),
    "risk": (["pi-circle", "--risk", "best"], "--risk best: must be one of mean, worst, cvar"),
    "method": (["pi-circle", "--method", "cmaa"], "--method cmaa; did you mean 'cma'"),
    "baseline": (["pi-circle", "--baseline", "cma,sgd"], "--baseline sgd"),
    "twice": (["pi-circle", "--baseline", "cma,cma"], "a method stands twice"),
    "budget": (["pi-circle", "--budget", "0"], "--budget 0: must be 1..1e6 simulations"),
    "first step": (
        ["pi-circle", "--budget", "20", "--worst-case", "1"],
        "--budget 20: must be 68..1e6 simulations for a first step with 4 numbers, --starts 2, 2 "
        "rounds",
    ),
    "starts": (["pi-circle", "--starts", "0"], "--starts 0: must be 1..16"),
    "margin": (["pi-circle", "--margin", "1"], "--margin 1: must be in 0..1"),
    "rounds": (["pi-circle", "--worst-case", "-1"], "--worst-case -1: must be 0..20"),
    "seed": (["pi-circle", "--seed", "-1"], "--seed -1: must be"),
    "train": (["pi-circle", "--train", "bad.toml"], "bad.toml:2: [train] unknown key 'plant'"),
    "other law": (["cmac-circle", *WORDS], "cmac-circle and pi-circle have different laws"),
    "resume": (["pi-circle", "--resume"], "--resume needs --out DIR"),
    "nothing": (["pi-circle", "--resume", "--out", "new"], "new does not exist"),
    "foreign": (["pi-circle", "--out", "foreign"], "foreign holds no tuning"),
    "a file": (["pi-circle", "--out", "bad.toml"], "is not a folder"),
    "diverges": (
        ["pi-circle", "--gains", "wild.toml", "--gains", "c1"],
        "before tuning 1 of 4 training runs are lost, the first, pi-circle 3, at",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_use_is_one_line_and_writes_nothing(command, case):
    Path("foreign").mkdir()
    Path("foreign/thesis.txt").write_text("mine")
    Path("bad.toml").write_text("[train]\nplant = 3\n")
    Path("wild.toml").write_text("[gains]\nproportional_gain = 1e6\n")
    words, says = WRONG[case]
    own = "--train" in words or words[:1] != ["pi-circle"]
    words = [*words, *(() if own else WORDS)]
    before = {file: file.read_bytes() for file in Path().rglob("*") if file.is_file()}
    result = command("tune", *words)
    assert result.status == 2 and result.out == ""
    told = result.err.splitlines()[-1]
    assert told.startswith("jaxstage: ") and says in told, result.err
    assert before == {file: file.read_bytes() for file in Path().rglob("*") if file.is_file()}
