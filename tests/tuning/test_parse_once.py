"""Files of the user are read once, whole, and mean the same in any order."""

import os
import threading

import numpy as np
import pytest

from tests.helpers.reads import counted
from tuning.app.comparison import other_gains
from tuning.store.gains_file import read_gains
from tuning.store.prepare import prepare
from tuning.sweeps.configuration import SweepRequest, configure_sweep
from tuning.tuner.configuration import TuningRequest, configure_tuning
from tuning.uncertainty.scenario_file import read_scenario

SHORT = ("lap_time=0.02", "laps=1", "scored=0")
SCENARIO = """
seed = 3
[plant]
damping = 0.11
[[spread]]
path = "plant.mass"
distribution = "uniform"
low = 0.9
high = 1.1
[[spread]]
path = "plant.damping"
distribution = "uniform"
low = 0.5
high = 1.5
[[correlation]]
between = ["plant.mass", "plant.damping"]
value = 0.5
"""
GAINS = "[gains]\nproportional_gain = 64.0\n"
TRAIN = """
[train]
plants = 1
horizons = [0.01]
[[train.contour]]
loop = "pi-circle"
set = ["lap_time=0.02", "laps=1", "scored=0"]
[held_out]
plants = 2
[[held_out.contour]]
loop = "pi-star"
set = ["lap_time=0.02", "laps=1", "scored=0"]
"""


@pytest.fixture
def files(tmp_path):
    for name, text in (("scenario", SCENARIO), ("gains", GAINS), ("train", TRAIN)):
        (tmp_path / f"{name}.toml").write_text(text)
    return {name: tmp_path / f"{name}.toml" for name in ("scenario", "gains", "train")}


def run(files):
    prepare("pi-circle", SHORT, read_gains(files["gains"]), read_scenario(files["scenario"]))


def sweep(files):
    configure_sweep(
        SweepRequest(
            loops=("pi-circle", "pi-star"),
            runs=4,
            words=SHORT,
            gains={"pi-circle": files["gains"]},
            scenario=files["scenario"],
        )
    )


def tune(files):
    configure_tuning(
        TuningRequest(
            "pi-circle",
            SHORT,
            (str(files["gains"]), "K"),
            files["scenario"],
            train=files["train"],
        )
    )


def compare(files):
    other_gains({"pi-circle": files["gains"]}, SHORT)


@pytest.mark.parametrize(
    ("command", "names"),
    [
        (run, ("gains", "scenario")),
        (sweep, ("gains", "scenario")),
        (tune, ("gains", "scenario", "train")),
        (compare, ("gains",)),
    ],
)
def test_every_file_is_opened_once(files, command, names):
    with counted() as opened:
        command(files)
    assert {name: opened[str(files[name])] for name in names} == dict.fromkeys(names, 1)


def test_a_pipe_is_a_file(tmp_path):
    """What can be read only once is read whole, for values and for the places of errors."""
    pipe = tmp_path / "gains.toml"
    os.mkfifo(pipe)

    def written(text):
        threading.Thread(target=pipe.write_text, args=(text,), daemon=True).start()
        return read_gains(pipe)

    case = prepare("pi-circle", SHORT, written(GAINS)).case
    assert np.asarray(case.gains.proportional_gain).tolist() == [64.0, 64.0]
    with pytest.raises(ValueError, match=rf"{pipe}:2: gains\.proportional_gain \(x\) .*= -1 "):
        prepare("pi-circle", SHORT, written(GAINS.replace("64.0", "-1")))


@pytest.mark.parametrize("keys", [("coulomb", "static"), ("static", "coulomb")])
def test_the_order_of_keys_does_not_matter(tmp_path, keys):
    """Both frictions are raised, the one of motion beyond what the one at rest was."""
    before = np.max(np.asarray(prepare("sliding-circle", SHORT).case.scenario.plant.static))
    values = {"coulomb": 2 * before, "static": 3 * before}
    file = tmp_path / "scenario.toml"
    file.write_text("[plant]\n" + "".join(f"{key} = {values[key]}\n" for key in keys))
    plant = prepare("sliding-circle", SHORT, scenario=read_scenario(file)).case.scenario.plant
    assert np.asarray(plant.static).tolist() == [3 * before] * 2
    assert np.asarray(plant.coulomb).tolist() == [2 * before] * 2
    file.write_text(f"[plant]\ncoulomb = {2 * before}\n")
    with pytest.raises(ValueError, match=rf"{file}:2: plant\.static .*: must be >= coulomb"):
        prepare("sliding-circle", SHORT, scenario=read_scenario(file))


def test_a_value_is_set_once(tmp_path):
    file = tmp_path / "gains.toml"
    file.write_text("[gains]\nproportional_gain = 1.0\nK = 2.0\n")
    with pytest.raises(ValueError, match=rf"{file}:3: gains\.proportional_gain is set twice"):
        prepare("pi-circle", SHORT, read_gains(file))
