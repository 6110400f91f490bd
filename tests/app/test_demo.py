"""`jaxstage demo`: its commands, what it keeps, how it goes on, and its report."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure

from jaxstage.plot.pictures import save
from tests.app.test_front import read
from tests.helpers.commanding import command as command
from tests.helpers.commanding import few_figures, strict_json
from tests.helpers.documented import undocumented
from tuning.app.demo import stages
from tuning.app.main import EXAMPLES

ROOT = Path(__file__).parents[2]
WORDS = ("--set", "lap_time=0.02", "--set", "laps=1", "--set", "scored=0")
FIRST, SECOND = "pi-circle", "pi-star"
#: as much of the answer of a tuning as the demo reads
ANSWER = {
    "method": "random", "n": 1, "units": 80.0,
    "before": {"figures": {"contour_rms_um": 900.0}},
    "after": {"figures": {"contour_rms_um": 800.0}},
    "gains": {
        "gains.slope x": {
            "value": 1.4, "before": 1.0, "low": 0.1, "high": 10.0, "unit": "1/s", "symbol": "c1",
            "at_bound": False,
        },
    },
}  # fmt: skip
GAINS = "[gains]\nslope = [1.4, 1.4]\n"


@pytest.fixture
def small(command, monkeypatch):
    """The demo in a small size. Its sweeps are real; its runs and tunings leave what is given here,
    and the second tuning is refused.

    Returns what was begun, and a list of what stops the next tuning of `SECOND`.
    """
    begun, stops = [], []
    few_figures(monkeypatch)

    def tune(plan, methods, options):
        loop, out = plan.table["loop"], options.out
        if loop == SECOND and stops:
            raise stops.pop()
        begun.append(f"tune {loop}")
        refused = ["a goal is missed"] if loop == SECOND else []
        answer = ANSWER | {"loop": loop, "refused": refused, "accepted": not refused}
        (out / "tune.json").write_text(json.dumps(answer), encoding="utf-8")
        (out / ("refused-gains.toml" if refused else "gains.toml")).write_text(GAINS)
        save(Figure((1, 1)), out / "history.png")

    def run(prepared, out):
        begun.append(f"run {prepared.case.name}")
        out.mkdir(parents=True, exist_ok=True)
        save(Figure((1, 1)), out / "contour.png")
        return {
            "loop": prepared.case.name, "verdict": "", "finite": False, "duration_s": 0.02,
            "laps": 1, "lap_time_s": 0.02, "dt_s": 1e-4, "precision": "double", "notes": [],
        }  # fmt: skip

    monkeypatch.setattr("tuning.app.commands.tune._tune", tune)
    monkeypatch.setattr("tuning.store.prepare.execute", run)
    monkeypatch.setattr(  # what other tests draw
        "tuning.sweeps.pictures.save", lambda drawn, file: save(Figure((1, 1)), file)
    )
    for name, value in (
        ("LOOPS", (FIRST, SECOND)), ("PLANTS", 8), ("CHUNK", 4), ("WORDS", WORDS),
    ):  # fmt: skip
        monkeypatch.setattr(f"tuning.app.demo.stages.{name}", value)
    return begun, stops


def rows_of(folder, loop):
    return pa.concat_tables(pq.read_table(f) for f in sorted((folder / "runs" / loop).glob("*")))


def test_stopped_and_gone_on_with(command, small):
    begun, stops = small
    stops.append(KeyboardInterrupt())
    words = EXAMPLES["demo"].split()[1:]
    folder = Path(words[-1])
    stopped = command(*words)
    assert stopped.status == 130 and f"`jaxstage demo --out {folder}` goes on" in stopped.err
    kept = json.loads((folder / "stages.json").read_text())
    assert list(kept) == ["run pi-circle", f"run {SECOND}", "tune pi-circle"]
    told = command("report", folder)
    assert told.status == 2 and f"`jaxstage demo --out {folder}` finishes it" in told.err
    assert f"Example: {EXAMPLES['demo']}" in command("demo", "--help").out
    ended = command(*words)
    assert ended.status == 0, ended.err
    every = [f"{what} {loop}" for what in ("run", "tune") for loop in ("pi-circle", SECOND)]
    assert begun == every, "no stage runs twice"
    assert kept.items() <= json.loads((folder / "stages.json").read_text()).items()
    found = strict_json((folder / "demo.json").read_text())
    assert ended.out.splitlines()[-3:] == found["verdict"]
    assert "on 8 plants never seen" in found["verdict"][0]
    assert "tuned gains accepted" in found["verdict"][0]
    assert "NOT accepted (a goal is missed)" in found["verdict"][1]
    check_sweeps(folder, found)
    check_report(folder, found)
    again = command(*words, "--json")
    assert again.status == 0 and again.json == found and begun == every
    assert not undocumented({*found, *found["loops"][0], *found["stages"][0]})


def check_sweeps(folder, found):
    """Both gains met the same plants; what is said of them follows from the rows."""
    for loop in found["loops"]:
        name = loop["loop"]
        before, after = (rows_of(folder / when, name) for when in ("published", "tuned"))
        drawn = [c for c in before.column_names if c.startswith("plant_")]
        assert drawn and before.select(drawn).equals(after.select(drawn))
        first, second = (np.mean(rows["contour_rms_um"].to_numpy()) for rows in (before, after))
        assert first != second
        assert loop["plants"]["before"]["value"] == pytest.approx(first, rel=1e-12)
        assert loop["plants"]["change"]["value"] == pytest.approx(second / first - 1, rel=1e-9)
    shares = [np.mean(rows_of(folder / "tuned", loop["loop"])["contour_rms_um"].to_numpy())
              for loop in found["loops"]]  # fmt: skip
    gap = found["comparisons"]["tuned"]["difference"]["value"]
    assert gap == pytest.approx(shares[0] - shares[1], rel=1e-9)


def check_report(folder, found):
    reader = read((folder / "report.html").read_text(encoding="utf-8"))
    shown = reader.text
    places = [shown.index(text) for text in (*found["verdict"], "Before and after", "Pictures")]
    assert places == sorted(places), "verdict first"
    assert {"plants", "contour", "history", f"pi-circle-against-{SECOND}"} <= set(reader.pictures)
    assert reader.captions == len(reader.pictures)
    text = "\n".join(shown)
    for loop in found["loops"]:
        assert (folder / loop["gains"]).read_text(encoding="utf-8").strip() in text
    refused = not found["loops"][1]["accepted"]
    gained = found["loops"][0]["accepted"] and found["loops"][0]["plants"]["change"]["high"] < 0
    colour = "" if gained and refused else "bad"
    assert f'<div class="verdict {colour}">' in (folder / "report.html").read_text(encoding="utf-8")
    assert all(one["command"] in shown for one in found["stages"])


def test_a_folder_that_holds_no_demo_or_another_one(command, small, monkeypatch):
    Path("mine").mkdir()
    Path("mine/thesis.txt").write_text("mine")
    refused = command("demo", "--out", "mine")
    assert (
        refused.status == 2
        and refused.err == "jaxstage: mine holds no demo: there is no demo.toml\n"
    )
    small[1].append(OSError("disk full"))
    failed = command("demo", "--out", "other")
    told = "jaxstage: disk full; `jaxstage demo --out other` goes on\n"
    assert failed.status == 2 and failed.err.endswith(told)
    monkeypatch.setattr("tuning.app.demo.stages.PLANTS", 9)
    refused = command("demo", "--out", "other")
    assert refused.status == 2 and "a demo of another configuration; plants: 8 -> 9" in refused.err


@pytest.mark.parametrize("text", ["[]", "null", "{", '{"run pi-circle": 3}', "\xff", "[" * 9999])
def test_a_damaged_list_of_stages(tmp_path, text):
    """What cannot be read has not ended; the rest counts."""
    took = {"command": "jaxstage run", "seconds": 1.5, "processor_seconds": 2.0}
    (tmp_path / "stages.json").write_bytes(text.encode("latin-1"))
    assert stages.ended(tmp_path) == {}
    both = {"run pi-circle": took, "published": took | {"seconds": "long"}}
    (tmp_path / "stages.json").write_text(json.dumps(both))
    assert stages.ended(tmp_path) == {"run pi-circle": stages.StageTime(**took)}


def test_damaged_answers_are_made_again(command, small):
    begun, _ = small
    assert command("demo", "--out", "d").status == 0
    whole = strict_json(Path("d/demo.json").read_text())
    Path(f"d/tune/{FIRST}/tune.json").write_text("{")
    Path("d/tuned/summary.json").unlink()
    begun.clear()
    again = command("demo", "--out", "d")
    assert again.status == 0 and begun == [f"tune {FIRST}"], again.err
    made = strict_json(Path("d/demo.json").read_text())
    assert made["loops"] == whole["loops"] and made["verdict"] == whole["verdict"]
    Path(f"d/tune/{FIRST}/tune.json").write_text('{"loop": 3}')
    refused = command("demo", "--out", "d")
    assert refused.status == 2 and "delete d/stages.json" in refused.err
