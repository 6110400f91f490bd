"""``jaxstage frequency``: its table, its JSON, its files, its refusals."""

import csv

import numpy as np
import pytest

from tests.helpers.commanding import command as command
from tests.helpers.documented import undocumented


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    return tmp_path_factory.mktemp("frequency") / "view"


def test_the_json_is_that_of_the_folder(command, drawn):
    """One object, keys as documented, and a table of responses beside it."""
    words = ("--at", "0.05", "--sine", "0.01", "--axis", "x", "--out", drawn, "--json")
    answer = command("frequency", "cascade-circle", *words).json
    assert answer["at_m_s"] == {"x": 0.05, "y": 0.05} and answer["cut"] == "input"
    keys = {*answer, *answer["axes"]["x"], *answer["coupled"], *answer["sine"][0]}
    assert not undocumented(keys)
    x = answer["axes"]["x"]
    assert x["gm_up_db"] is None and x["gm_down_db"] < 0 < x["pm_deg"] < 90
    assert {row["axis"] for row in answer["sine"]} == {"x"}
    assert all(abs(row["s"] / row["s_linear"] - 1) < 1e-5 for row in answer["sine"])
    names = {"bode.png", "nyquist.png", "sensitivity.png", "frequency.json", "response.csv"}
    assert {file.name for file in drawn.iterdir()} == names
    with (drawn / "response.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    s = np.array([complex(float(r["S_x_re"]), float(r["S_x_im"])) for r in rows])
    gain = np.array([complex(float(r["L_x_re"]), float(r["L_x_im"])) for r in rows])
    assert np.allclose(s * (1 + gain), 1, rtol=1e-9)
    assert np.abs(s).max() == pytest.approx(x["ms"], rel=1e-6)


@pytest.mark.fast
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--at", "fast"), "--at fast: must be numbers with commas"),
        (("--at", "1,2,3"), "3 speeds for 2 axes (x, y)"),
        (("--axis", "w"), "--axis w: must be one of x, y"),
        (("--cut", "output"), "cut = output: must be one of input, position"),
        (("--at", "0.05", "--from", "7000"), "half the sampling rate"),
        (("--at", "0.05", "--sine", "-1"), "must be > 0"),
    ],
)
def test_wrong_uses_are_one_line(command, words, said):
    answer = command("frequency", "pi-circle", *words)
    assert answer.status == 2 and said in answer.err and answer.err.count("\n") == 1
