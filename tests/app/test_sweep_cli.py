"""`jaxstage sweep` and `jaxstage replay`: what they print, keep, take back and refuse."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from jaxstage.metrics import tracking
from tests.helpers.commanding import command as command
from tests.helpers.commanding import few_figures, strict_json
from tests.helpers.documented import undocumented
from tuning.store.gains_file import read_gains
from tuning.store.prepare import prepare
from tuning.store.run_result import write_settings
from tuning.sweeps import replays, store
from tuning.sweeps.configuration import build
from tuning.sweeps.sensitivity import tornado
from tuning.uncertainty.scenario_file import read_scenario

#: two laws, eight plants, 200 ticks
SHORT = ("--set", "lap_time=0.02", "--set", "laps=1", "--set", "scored=0")
SMALL = ("sweep", "pi-circle", "cascade-circle", "-n", "8", "--chunk", "4", *SHORT)
SPEC = ("--spec", "contour_max_um < 60 and finite", "--target", "0.9")


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Loops that report little compile fast."""
    few_figures(monkeypatch)


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """The folder of one sweep, made by the first test that needs it."""
    return tmp_path_factory.mktemp("swept") / "out"


def swept(command, shared):
    """The answer about the shared sweep."""
    if not shared.exists():
        result = command(*SMALL, *SPEC, "--out", shared, "--json")
        assert result.status == 0, result.err
        assert result.json == strict_json((shared / "summary.json").read_text())
    return strict_json((shared / "summary.json").read_text())


def plan_of(shared):
    return build(store.read_configuration(shared))


def test_one_object_that_says_all(command, shared):
    found = swept(command, shared)
    assert found["runs"] == 8 and found["design"] == "sobol" and found["metric"] == "contour_max_um"
    assert found["specification"] == SPEC[1]
    assert [loop["loop"] for loop in found["loops"]] == ["pi-circle", "cascade-circle"]
    rows = store.read(shared, plan_of(shared)).to_pylist()
    for loop in found["loops"]:
        mine = [row["contour_max_um"] for row in rows if row["loop"] == loop["loop"]]
        passed = sum(value < 60 for value in mine)
        assert loop["passed"] == loop["yield"]["count"] == passed and loop["yield"]["of"] == 8
        assert loop["yield"]["low"] < passed / 8 < loop["yield"]["high"] or passed in (0, 8)
        assert loop["statistics"]["mean"]["value"] == pytest.approx(np.mean(mine))
        assert loop["statistics"]["p95"] is None
        assert loop["reasons"]["p95"] == "not enough samples: needs 200 runs"
        assert loop["claim"]["target"] == 0.9
        assert [loop[f"scored_{key}"] for key in ("from_s", "to_s", "laps")] == [0.0, 0.02, 1.0]
    (pair,) = found["comparisons"]
    gap = [
        a["contour_max_um"] - b["contour_max_um"] for a, b in zip(rows[:8], rows[8:], strict=True)
    ]
    assert pair["plants"] == 8 and pair["difference"]["value"] == pytest.approx(np.mean(gap))
    assert pair["better"]["count"] == sum(value < 0 for value in gap)
    worst = max(rows, key=lambda row: row["contour_max_um"])
    assert (found["worst"][0]["loop"], found["worst"][0]["run"]) == (worst["loop"], worst["run"])
    drawn = {file.name for file in shared.glob("*.png")}
    assert drawn == {
        "distribution.png", "pi-circle-parameters.png", "cascade-circle-parameters.png",
        "pi-circle-against-cascade-circle.png",
    }  # fmt: skip


def keys_of(found, inside=()):
    """Every fixed key of an object; keys that are columns or names are not followed."""
    named = ("rank_correlation", "sobol_indices", "bars", "parameters", "figures", "reasons")
    for key, value in found.items():
        yield key
        if key in named:
            value = next(iter(value.values()), None) if value else None
        for inner in value if isinstance(value, list) else [value]:
            if isinstance(inner, dict):
                yield from keys_of(inner)


def test_every_key_is_documented(command, shared):
    found = swept(command, shared)
    replayed = command("replay", shared, "--run", "3", "--json").json
    extra = ("s1", "s1_error", "st", "st_error", "nominal", "sweep_low", "sweep_high")
    assert not undocumented({*keys_of(found), *keys_of(replayed), *extra})


def test_a_stopped_sweep_goes_on_without_its_words(command, shared):
    whole = swept(command, shared)
    sorted(shared.glob("runs/*/*.parquet"))[1].unlink()
    there = command("replay", shared, "--run", "2", "--json")
    assert [row["identical"] for row in there.json["runs"]] == [True, True]
    absent = command("replay", shared, "--run", "7", "--loop", "cascade-circle", "--json")
    assert absent.json["runs"][0]["identical"] is None
    result = command("sweep", "--resume", "--out", shared, *SPEC)
    assert result.status == 0
    found = strict_json((shared / "summary.json").read_text())
    assert found["simulated"] == 4
    worst = whole["worst"][0]
    assert worst["loop"] == "pi-circle", "not among those that were simulated again"
    assert f"0 lost, worst contour max {worst['value']:.4g} um" in result.err
    for key in ("loops", "comparisons", "worst", "configuration_sha256"):
        assert found[key] == whole[key]
    for text in (
        "8 plants, design sobol, seed 0, double precision; 4 runs simulated",
        "yield >= 0.9",
        "not enough samples: needs 200 runs",
        "pi-circle - cascade-circle on the same 8 plants",
        "jaxstage replay",
    ):
        assert text in result.out, text


def without_pictures(prepared, out):
    """`runs.execute` but for the simulation, which other tests see to."""
    out.mkdir(parents=True)
    write_settings(out, prepared.case, {})


def test_what_is_stored_is_not_given_again(command, shared):
    swept(command, shared)
    result = command("sweep", "--resume", "--out", shared, "-n", "16")
    assert result.status == 2
    assert "-n: --resume without loops takes the stored configuration" in result.err


def test_replay_gives_the_rows_back_and_what_run_takes(command, shared, tmp_path, monkeypatch):
    swept(command, shared)
    monkeypatch.setattr(replays, "execute", without_pictures)
    found = command("replay", shared, "--worst", "2", "--json").json["runs"]
    assert len(found) == 2 and all(row["identical"] for row in found)
    assert found[0]["figures"]["contour_max_um"] >= found[1]["figures"]["contour_max_um"]
    one = command(
        "replay", shared, "--run", "3", "--loop", "pi-circle", "--out", tmp_path / "again"
    )
    assert "identical to its row" in one.out
    folder = tmp_path / "again" / "pi-circle-run-3"
    words = [word for word in SHORT if word != "--set"]
    gains, scenario = read_gains(folder / "gains.toml"), read_scenario(folder / "scenario.toml")
    case = prepare("pi-circle", words, gains, scenario).case
    wanted = replays.machine(plan_of(shared), 0, 3)
    same = jax.tree.map(
        np.array_equal, (case.gains, case.scenario.plant), (wanted.gains, wanted.scenario.plant)
    )
    assert jax.tree.all(same)
    keys = [jax.random.key_data(c.scenario.key) for c in (case, wanted)]
    assert np.array_equal(*keys)


def test_a_tornado_is_the_slope_times_the_spread(command, shared):
    """Against central differences of a smooth figure."""
    swept(command, shared)
    plan = plan_of(shared)
    case, found = js.with_metric(plan.cases[0], tracking), plan.spaces[0]
    result = tornado(case, found, "ate_um")
    assert result.left_out == () and len(result.bars) == found.dimensions()

    def ate(mass):
        plant = js.replace(case.scenario.plant, mass=jnp.asarray(mass))
        moved = case._replace(scenario=js.replace(case.scenario, plant=plant))
        return float(moved.simulate().report.ate) * 1e6

    nominal, step = np.asarray(case.scenario.plant.mass), np.array([3e-7, 0.0])
    slope = (ate(nominal + step) - ate(nominal - step)) / (2 * step[0])
    bar = next(bar for bar in result.bars if bar.column == "plant_mass_x_kg")
    assert result.nominal == pytest.approx(ate(nominal), rel=1e-9)
    # uniform 0.8..1.2: from 0.82 to 1.18 of the nominal mass
    assert bar.high - bar.low == pytest.approx(slope * 0.36 * nominal[0], rel=1e-3)
    assert (bar.high + bar.low) / 2 == pytest.approx(result.nominal, rel=1e-9)


def test_gains_of_each_loop(command, shared):
    swept(command, shared)
    Path("gains.toml").write_text("[gains]\nslope = 2.0\n")
    result = command(*SMALL, "--gains", "pi-circle=gains.toml", "--resume", "--out", shared)
    assert result.status == 2
    assert result.err.endswith(
        "another configuration; loop.pi-circle.values.gains.slope: [1.0, 1.0] -> [2.0, 2.0]\n"
    )


SCENARIO = '[[spread]]\npath = "plant.mass"\ndistribution = "normal"\nmean = 1\ndeviation = -0.1\n'
WRONG = {
    "no loop": (["sweep", "--out", "new"], "a sweep needs loops"),
    "misspelt loop": (["sweep", "pi-cirle", "--out", "new"], "did you mean 'pi-circle'"),
    "twice": (["sweep", "pi-circle", "pi-circle", "--out", "new"], "each named once"),
    "no folder": (["sweep", "pi-circle"], "--out DIR is needed"),
    "design": (["sweep", "pi-circle", "--design", "grid", "--out", "new"], "must be one of random"),
    "runs": (["sweep", "pi-circle", "-n", "0", "--out", "new"], "-n 0: must be >= 1"),
    "seed": (["sweep", "pi-circle", "--seed", "-1", "--out", "new"], "--seed -1: must be"),
    "chunk": (["sweep", "pi-circle", "--chunk", "0", "--out", "new"], "--chunk 0: must be >= 1"),
    "column": (
        ["sweep", "pi-circle", "--spec", "contour_mx_um < 2", "--out", "new"],
        "unknown column 'contour_mx_um'; did you mean 'contour_max_um'",
    ),
    "spec": (["sweep", "pi-circle", "--spec", "contour_max_um <", "--out", "new"], "at character"),
    "metric": (["sweep", "pi-circle", "--metric", "ate", "--out", "new"], "no such metric"),
    "target": (["sweep", "pi-circle", "--target", "0.9", "--out", "new"], "needs a --spec"),
    "target 2": (
        ["sweep", "pi-circle", "--target", "2", "--spec", "finite", "--out", "new"],
        "must be > 0 and < 1",
    ),
    "own figure": (
        [
            "sweep",
            "pi-circle",
            "cascade-circle",
            "--spec",
            "sliding_mean_x_mm_per_s < 1",
            "--out",
            "new",
        ],
        "unknown column",
    ),
    "other plants": (["sweep", "pi-circle", "sim1", "--out", "new"], "(sim1)"),
    "precision": (
        ["sweep", "pi-circle", "--precision", "half", "--out", "new"],
        "single or double",
    ),
    "rough": (
        ["sweep", "sliding-circle", "--precision", "single", "--out", "new"],
        "--precision single: ",
    ),
    "setting": (["sweep", "pi-circle", "--set", "slop=1", "--out", "new"], "did you mean"),
    "no scenario": (
        ["sweep", "pi-circle", "--scenario", "no.toml", "--out", "new"],
        "no such file",
    ),
    "spread": (
        ["sweep", "pi-circle", "--scenario", "spread.toml", "--out", "new"],
        "spread.toml:1: plant.mass: deviation = -0.1: must be > 0",
    ),
    "gains": (
        ["sweep", "pi-circle", "cascade-circle", "--gains", "g.toml", "--out", "new"],
        "write LOOP=FILE",
    ),
    "gains of another": (
        ["sweep", "pi-circle", "--gains", "cmac-circle=g.toml", "--out", "new"],
        "is not swept",
    ),
    "gains twice": (
        ["sweep", "pi-circle", "--gains", "a.toml", "--gains", "b.toml", "--out", "new"],
        "pi-circle has a.toml already",
    ),
    "workers": (["sweep", "pi-circle", "--workers", "0", "--out", "new"], "--workers 0: must be"),
    "cores": (["sweep", "pi-circle", "--cores", "0", "--out", "new"], "--cores 0: must be >= 1"),
    "both": (
        ["sweep", "pi-circle", "--workers", "1", "--scheduler", "tcp://x:1", "--out", "new"],
        "give one of them",
    ),
    "foreign": (["sweep", "pi-circle", "--out", "foreign"], "foreign holds no sweep"),
    "resume foreign": (["sweep", "--resume", "--out", "foreign"], "foreign holds no sweep"),
    "resume nothing": (["sweep", "pi-circle", "--resume", "--out", "new"], "new does not exist"),
    "out is a file": (["sweep", "pi-circle", "--out", "spread.toml"], "is not a folder"),
    "replay nothing": (["replay", "new", "--run", "1"], "new does not exist"),
    "replay foreign": (["replay", "foreign", "--run", "1"], "foreign holds no sweep"),
    "replay what": (["replay", "foreign"], "foreign holds no sweep"),
    "other file": (["sweep", "--resume", "--out", "other"], "it has no 'jaxstage'"),
    "other file, loops": (["sweep", "pi-circle", "--out", "other"], "it has no 'jaxstage'"),
    "no TOML": (["replay", "broken", "--run", "1"], "broken/sweep.toml is no configuration"),
    "when lost": (
        ["sweep", "pi-circle", "--spec", "finite or lost_at_s > 1", "--out", "new"],
        "unknown column 'lost_at_s'",
    ),
    "metric is a plant": (
        ["sweep", "pi-circle", "--metric", "plant_mass_x_kg", "--out", "new"],
        "no such metric",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_use_is_one_line_and_writes_nothing(command, case):
    Path("foreign").mkdir()
    Path("foreign/thesis.txt").write_text("mine")
    Path("spread.toml").write_text(SCENARIO)
    for folder, content in (("other", "a = 1\n"), ("broken", "= [\n")):
        Path(folder).mkdir()
        Path(folder, "sweep.toml").write_text(content)
    (name, *words), says = WRONG[case]
    own_timing = "sim1" in words or case == "rough"  # single precision is judged at the timing
    result = command(name, *words, *(SHORT if name == "sweep" and not own_timing else ()))
    assert result.status == 2 and result.out == ""
    assert result.err.startswith("jaxstage: ") and result.err.count("\n") == 1, result.err
    assert says in result.err
    there = sorted(file.name for file in Path().iterdir())
    assert there == ["broken", "foreign", "other", "spread.toml"]
    assert [file.name for file in Path("foreign").iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--run", "8"], "--run 8: must be 0..7"),
        (["--run", "-1"], "--run -1: must be 0..7"),
        (["--worst", "0"], "--worst 0: must be >= 1"),
        (["--run", "1", "--worst", "1"], "give --run ID or --worst K"),
        ([], "give --run ID or --worst K"),
        (["--run", "1", "--loop", "pi"], "--loop pi: one of pi-circle"),
        (["--worst", "1", "--metric", "x"], "--metric x"),
    ],
)
def test_a_wrong_replay_is_one_line(command, shared, words, says):
    swept(command, shared)
    result = command("replay", shared, *words)
    assert result.status == 2 and result.out == "" and says in result.err
    assert result.err.count("\n") == 1
