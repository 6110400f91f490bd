"""Settings by name and from files: what a user types reaches the leaf that is meant."""

import os
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as effort
from hypothesis import strategies as st

from jaxstage.hardware.drives import CurrentDrive
from jaxstage.hardware.loads import SineLoad
from jaxstage.hardware.sensors import Encoder
from jaxstage.model.fields import leaves, replace
from jaxstage.model.settings import (
    SCENARIO_PARTS,
    apply,
    known_leaves,
    nearest_name,
    plain_toml,
    read_toml,
    resolve,
    to_toml,
)
from jaxstage.studies.fuzzy_cmac.loops import dfcmac_gains, scenario
from tests.helpers.batteries import cast
from tuning.store import prepare as runs
from tuning.store.gains_file import read_gains
from tuning.uncertainty.case_table import case_of, case_table
from tuning.uncertainty.scenario_file import read_scenario
from tuning.uncertainty.uncertain_space import uncertain_leaves

GAINS = cast(dfcmac_gains())
SCENE = jax.tree.map(
    lambda x: x if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else jnp.asarray(x, jnp.float64),
    replace(
        jax.tree.map(jnp.asarray, scenario()),
        load=SineLoad(**{n: jnp.ones(2) for n in ("amplitude", "frequency", "phase", "bias")}),
        sensor=Encoder(resolution=jnp.asarray(1e-6), bandwidth=jnp.asarray(jnp.inf)),
        drive=CurrentDrive(
            limit=jnp.full(2, jnp.inf), delay=jnp.asarray(1.0), lag=jnp.asarray(0.0)
        ),
    ),
)
KNOWN = known_leaves(GAINS, SCENE)
pytestmark = pytest.mark.fast


def value(name, gains=GAINS, scene=SCENE):
    return np.asarray(known_leaves(gains, scene)[name][1])


# --- names ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "path"),
    [
        ("gains.slope", "gains.slope"),
        ("gains.c1", "gains.slope"),
        ("slope", "gains.slope"),
        ("c1", "gains.slope"),
        ("eta", "gains.switching_gain"),
        ("receptive.m", "gains.receptive.spacing"),
        ("sigma", "gains.receptive.width"),
        ("plant.mass", "plant.mass"),
        ("plant.M", "plant.mass"),
        ("nominal.mass", "gains.nominal.mass"),
        ("nominal.M", "gains.nominal.mass"),
        ("u_max", "drive.limit"),
        ("start.offset", "start.offset"),
        ("bandwidth", "sensor.bandwidth"),
        ("load.A", "load.amplitude"),
    ],
)
def test_by_path_symbol_or_unique_suffix(name, path):
    assert resolve(name, KNOWN) == path


def test_every_setting_is_reached_by_its_path_and_symbol():
    for path, (quantity, _) in KNOWN.items():
        assert resolve(path, KNOWN) == path
        assert resolve(f"{path.rpartition('.')[0]}.{quantity.symbol}", KNOWN) == path


@pytest.mark.parametrize("name", ["mass", "M", "damping", "velocity_"[:-1] + "x", "K_t"])
def test_ambiguous_or_unknown_is_refused(name):
    with pytest.raises(ValueError, match=f"'{name}'"):
        resolve(name, KNOWN)


def test_ambiguity_names_all_candidates():
    with pytest.raises(ValueError, match="'mass' may mean") as caught:
        resolve("mass", KNOWN)
    assert "plant.mass" in str(caught.value) and "gains.nominal.mass" in str(caught.value)


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("gains.slop", "gains.slope"),
        ("plant.mas", "plant.mass"),
        ("swiching_gain", "switching_gain"),
        ("laptime", "lap_time"),
        ("plant.masss", "plant.mass"),
    ],
)
def test_a_misspelt_name_brings_the_nearest(typed, meant):
    with pytest.raises(ValueError, match=f"unknown setting '{typed}'; did you mean '{meant}'"):
        resolve(typed, KNOWN, ("lap_time", "dt"))


def test_a_wrong_field_of_a_right_table_is_told_what_there_is():
    """Not what shares the table's name and nothing else."""
    with pytest.raises(ValueError, match=r"'plant.foo'; plant has force_constant, mass, damping,"):
        resolve("plant.foo", KNOWN)
    with pytest.raises(ValueError, match=r"did you mean 'plant.mass'"):
        resolve("plant.mas", KNOWN)


def test_nothing_is_near():
    assert nearest_name("zzzzzzzz", ["slope"]) == ""
    with pytest.raises(ValueError, match=r"^unknown setting 'zzzzzzzz'$"):
        resolve("zzzzzzzz", {"gains.slope": KNOWN["gains.slope"]})


@given(st.text(max_size=12))
@effort(deadline=None, max_examples=100)
def test_any_word_is_a_setting_or_refused(name):
    try:
        assert resolve(name, KNOWN) in KNOWN
    except ValueError as error:
        assert name in str(error)


@given(st.sampled_from(sorted(KNOWN)), st.integers(1, 3))
@effort(deadline=None, max_examples=60)
def test_a_suffix_means_one_leaf_or_is_refused(path, length):
    suffix = ".".join(path.split(".")[-length:])
    matches = [p for p in KNOWN if p == suffix or p.endswith("." + suffix)]
    if suffix in KNOWN or len(matches) == 1:
        assert resolve(suffix, KNOWN) == path
    else:
        with pytest.raises(ValueError, match="may mean"):
            resolve(suffix, KNOWN)


# --- values ----------------------------------------------------------------------------------


COUNTED = np.arange(72.0).reshape(2, 4, 3, 3)


@pytest.mark.parametrize(
    ("name", "given_", "expected"),
    [
        ("slope", 2.0, [2, 2]),
        ("slope", [2.0], [2, 2]),
        ("slope", [2.0, 3.0], [2, 3]),
        ("drive.lag", 1e-3, 1e-3),
        ("theta0", 0.5, np.full((2, 4, 3, 3), 0.5)),
        ("theta0", [1.0, 2.0], np.ones((2, 4, 3, 3)) * np.array([1, 2]).reshape(2, 1, 1, 1)),
        ("theta0", COUNTED.tolist(), COUNTED),
        ("start.offset", [1e-3, -1e-3], [1e-3, -1e-3]),
    ],
)  # fmt: skip
def test_a_number_fills_and_a_list_goes_per_axis(name, given_, expected):
    gains, scene, _, (path,) = apply(GAINS, SCENE, {name: given_})
    np.testing.assert_array_equal(value(path, gains, scene), expected)
    others = [p for p in KNOWN if p != path]
    for other in others:
        np.testing.assert_array_equal(value(other, gains, scene), value(other))
    assert np.shape(value(path, gains, scene)) == np.shape(value(path))


@pytest.mark.parametrize(
    ("name", "wrong", "message"),
    [
        ("slope", [1.0, 2, 3], "gains.slope takes one number or 2, got 3 numbers"),
        ("slope", [[1.0, 2]], "gains.slope takes one number or 2, got 2 numbers"),
        ("drive.lag", [1.0, 2], "drive.lag takes one number, got 2 numbers"),
        ("theta0", [1.0, 2, 3], "gains.weights takes one number or 2, or an array"),
        ("slope", "fast", "gains.slope = fast: must be a number, or one number per axis"),
        ("slope", [[1.0], [1.0, 2.0]], "gains.slope = .*: must be a number"),
        ("slope", [], "gains.slope takes one number or 2, got 0 numbers"),
        ("slope", 10**400, "gains.slope = .*: must be a number"),
        ("slope", [{"x": 1.0}], "gains.slope = .*: must be a number"),
    ],
)
def test_wrong_values_name_the_setting(name, wrong, message):
    with pytest.raises(ValueError, match=message):
        apply(GAINS, SCENE, {name: wrong})


def test_later_settings_win_and_precision_stays():
    gains, _, _, paths = apply(GAINS, SCENE, {"gains.c1": 2.0, "slope": 3.0})
    assert paths == ("gains.slope", "gains.slope")
    np.testing.assert_array_equal(gains.slope, [3, 3])
    coarse, _, _, _ = apply(cast(GAINS, jnp.float32), SCENE, {"slope": 0.1})
    assert coarse.slope.dtype == jnp.float32


# --- files -----------------------------------------------------------------------------------

numbers = st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False)


def write(folder, gains, scene):
    sections = {"gains": gains} | {name: getattr(scene, name) for name in SCENARIO_PARTS}
    file = folder / "all.toml"
    file.write_text(to_toml(sections), encoding="utf-8")
    return file


@given(st.lists(numbers, min_size=8, max_size=8))
@effort(deadline=None, max_examples=30)
def test_toml_gives_back_every_bit(tmp_path_factory, drawn):
    source = iter(np.resize(np.array(drawn), 500))

    def fill(x):
        if jnp.issubdtype(x.dtype, jax.dtypes.prng_key):
            return x
        return jnp.asarray(np.array([next(source) for _ in range(x.size)]).reshape(x.shape))

    gains, scene = jax.tree.map(fill, (GAINS, SCENE))
    file = write(tmp_path_factory.mktemp("toml"), gains, scene)
    back = apply(GAINS, SCENE, read_toml(file).values)
    assert set(back[3]) == set(KNOWN)
    for path in KNOWN:
        expected, got = value(path, gains, scene), value(path, *back[:2])
        assert expected.tobytes() == got.tobytes() and expected.shape == got.shape, path


def test_toml_keeps_infinity_and_single_precision(tmp_path):
    gains = jax.tree.map(
        lambda x: jnp.asarray(np.float32(x) / np.float32(3)), cast(GAINS, jnp.float32)
    )
    file = write(tmp_path, gains, SCENE)
    back, scene, _, _ = apply(cast(GAINS, jnp.float32), SCENE, read_toml(file).values)
    assert scene.sensor.bandwidth == jnp.inf and (scene.drive.limit == jnp.inf).all()
    jax.tree.map(np.testing.assert_array_equal, back, gains)


def test_toml_is_readable(tmp_path):
    """Sections and field names as in the paths; plain numbers, one per axis."""
    text = write(tmp_path, GAINS, SCENE).read_text()
    assert "[gains.nominal]" in text and "[plant]" in text
    assert "slope = [\n    1.0,\n    1.0,\n]" in text or "slope = [1.0, 1.0]" in text


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[gains]\nslope = [1.0, 2.0\n", r"\.toml: .*line 2"),
        ("[gains]\nslope 3\n", r"\.toml: .*line 2"),
        ("gains = = 3\n", r"\.toml: .*line 1"),
        ("[gains]\nslope = 1\nslope = 2\n", r"\.toml: .*line"),
    ],
)
def test_broken_toml_names_file_and_line(tmp_path, text, says):
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match=says) as caught:
        read_toml(file)
    assert str(file) in str(caught.value) and "\n" not in str(caught.value)


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "bytes.toml").write_bytes(b"a = '\xff'\n")
    for name in ("missing.toml", ".", "bytes.toml"):
        with pytest.raises(ValueError, match="^" + str(tmp_path)) as caught:
            read_toml(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_line_of_a_setting(tmp_path):
    file = tmp_path / "some.toml"
    file.write_text("# slope = 7\n[gains]\nrate = 3\n'slope' = [1,\n 2]\nplant.mass = 1\n")
    toml = read_toml(file)
    assert toml.place("gains.slope") == f"{file}:4"
    assert toml.place("gains.rate") == f"{file}:3"
    assert toml.place("gains.plant.mass") == f"{file}:6"


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ("[gains]\nrate = 1\nslope = -1\n", 3, r"slope \(x\) \[c1\] = -1 1/s: must be > 0 1/s"),
        ("[gains]\nslop = 1.0\n", 2, "did you mean 'gains.slope'"),
        ("[gains]\nslope = 'fast'\n", 2, "must be a number"),
        ("[gains]\nslope = [1.0, 2.0, 3.0]\n", 2, "takes one number or 2"),
        ("[plant]\nmass = 1.0\n", 2, r"'plant.mass' is not in \[gains\]"),
        ("slope = 1.0\n", 1, r"'slope' is not in \[gains\]"),
        ("[gains]\nrate = inf\n", 2, "must be >= 0"),
    ],
)  # fmt: skip
def test_a_bad_file_names_file_line_and_range(tmp_path, text, line, says):
    file = tmp_path / "gains.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match=says) as caught:
        runs.prepare("dfcmac-circle", ["lap_time=0.01"], gains=read_gains(file))
    assert str(caught.value).startswith(f"{file}:{line}: ")


@pytest.mark.parametrize("seed", ["1.5", "-1", "'a'", "[1]", "true", "99999999999999999999"])
def test_a_bad_seed_names_file_line_and_range(tmp_path, seed):
    file = tmp_path / "scenario.toml"
    file.write_text(f"# draws\nseed = {seed}\n")
    with pytest.raises(ValueError, match=r"seed = .*must be a whole number") as caught:
        runs.prepare("dfcmac-circle", ["lap_time=0.01"], scenario=read_scenario(file))
    assert str(caught.value).startswith(f"{file}:2: ")


def test_both_files_give_back_a_case(tmp_path):
    """Gains and scenario written, read, and applied to the same loop: the same leaves, the seed."""
    words = ["lap_time=0.01", "c1=2", "plant.mass=0.0031,0.0029", "laps=1"]
    case = runs.prepare("dfcmac-circle", words).case
    case = case._replace(scenario=replace(case.scenario, key=jax.random.key(2**31 + 7)))
    from tuning.store.run_result import write_settings

    write_settings(tmp_path, case, {})
    back = runs.prepare(
        "dfcmac-circle", ["lap_time=0.01", "laps=1"], read_gains(tmp_path / "gains.toml"),
        read_scenario(tmp_path / "scenario.toml"),
    ).case  # fmt: skip
    jax.tree.map(np.testing.assert_array_equal, back.gains, case.gains)
    for name in SCENARIO_PARTS:
        one, other = getattr(back.scenario, name), getattr(case.scenario, name)
        jax.tree.map(np.testing.assert_array_equal, one, other)
    assert (jax.random.key_data(back.scenario.key) == jax.random.key_data(case.scenario.key)).all()


@pytest.mark.parametrize(
    ("loop", "name", "path"),
    [
        ("smc-s1", "radius", "reference.radius"),
        ("smc-s5", "reference.r", "reference.radius"),
        ("pd", "reference.R", "reference.radius"),
        ("sim1", "reference.amplitude", "reference.amplitude"),
    ],
)
def test_the_size_of_a_motion_is_a_setting(loop, name, path):
    """It reaches the setpoints, what a sweep and a tuning keep of the case, and nothing else."""
    before = runs.prepare(loop, ["lap_time=2"]).case
    case = runs.prepare(loop, ["lap_time=2", f"{name}=0.03"]).case
    old, new = (known_leaves((), one.scenario, one.path)[path][1] for one in (before, case))
    assert new == 0.03 != old
    first, later = (
        np.asarray(one.loop.reference.sample(one.path, jnp.asarray(90)).position)
        for one in (before, case)
    )
    np.testing.assert_allclose(later[:2] / first[:2], 0.03 / old, rtol=1e-12)
    table = case_table(case)
    assert path in uncertain_leaves(case), "a spread may name it"
    assert table["values"][path] == 0.03 and case_of(table, {}).path == case.path
    assert case.window == before.window
    jax.tree.map(np.testing.assert_array_equal, case.gains, before.gains)


@pytest.mark.parametrize(
    ("loop", "words", "says"),
    [
        ("smc-s1", ["radius=-0.01"], r"reference\.radius \[r\] = -0\.01 m: must be > 0 m"),
        ("smc-s1", ["radius=1cm"], "units are not written, this one is m"),
        ("smc-s5", ["feed=600", "radius=0.01"], "--set feed and --set reference.radius: the feed"),
        ("sim1", ["period=2"], "unknown setting 'period'"),
        ("pi-circle", ["radius=0.01"], "unknown setting 'radius'"),
    ],
)
def test_a_bad_size_is_one_line(loop, words, says):
    with pytest.raises(ValueError, match=says) as caught:
        runs.prepare(loop, words)
    assert "\n" not in str(caught.value)


NUMBERS = st.floats(allow_nan=False) | st.integers(-9, 9).map(float) | st.booleans()
ARRAYS = st.recursive(
    st.lists(NUMBERS, max_size=30), lambda x: st.lists(x, max_size=3), max_leaves=9
)
TEXTS = st.text() | st.lists(st.text(), max_size=3) | st.just("[\n  1.0,\n]")


@given(st.dictionaries(st.text(max_size=9), NUMBERS | ARRAYS | TEXTS, max_size=3))
@effort(max_examples=80, deadline=None)
def test_written_as_toml_it_reads_back_the_same(values):
    table = {"own": values, "all": [values, {"inner": values}]}
    assert tomllib.loads(plain_toml(table)) == table


def test_rows_of_an_array_stand_on_lines():
    rows = plain_toml({"weights": np.zeros((2, 2, 3)).tolist(), "mass": [3e-3, -0.5], "none": []})
    inner = "    [\n" + 2 * "        [0.0, 0.0, 0.0],\n" + "    ],\n"
    assert rows == f"weights = [\n{2 * inner}]\nmass = [0.003, -0.5]\nnone = []\n"
    long = plain_toml({"knots": np.linspace(-1, 1, 60).tolist()})
    assert max(map(len, long.splitlines())) < 100 and long.count("\n") < 20


def test_every_leaf_has_a_symbol_or_is_no_setting():
    assert all(q.symbol for _, q, _ in leaves(GAINS)), "a setting without symbol"


# --- what a file may be ----------------------------------------------------------------------

WHOLE = "1" * 400


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("[gains]\nmass = 1.0\n# \u00fc\n".encode("cp1252"), r": save it as UTF-8"),
        ("[gains]\n".encode("utf-16"), r": save it as UTF-8"),
        ("[gains]\n".encode("utf-16-le"), r": save it as UTF-8"),
        (b"x = " + b"[" * 2000 + b"]" * 2000, r": tables or lists are nested too deep"),
        (b"x = " + b"1" * 5000, r": a whole number has too many digits"),
        (b"#" * 10_000_001, r": larger than 10 MB"),
    ],
    ids=["cp1252", "utf-16", "utf-16 without a mark", "deep", "digits", "large"],
)
def test_a_file_that_is_no_settings_is_one_line(tmp_path, content, says):
    file = tmp_path / "gains.toml"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=says) as caught:
        read_toml(file)
    assert str(caught.value).startswith(str(file)) and "\n" not in str(caught.value)


def test_a_byte_order_mark_is_read(tmp_path):
    file = tmp_path / "gains.toml"
    file.write_bytes(b"\xef\xbb\xbf[plant]\r\nmass = 2.5\r\n")
    toml = read_toml(file)
    assert toml.values == {"plant.mass": 2.5}
    assert toml.place("plant.mass") == f"{file}:2"


def test_an_open_pipe_is_read_once():
    """As the shell gives it: ``--gains <(...)``."""
    reader, writer = os.pipe()
    try:
        os.write(writer, b"[plant]\nmass = 2.5\n")
        os.close(writer)
        assert read_toml(Path(f"/dev/fd/{reader}")).values == {"plant.mass": 2.5}
    finally:
        os.close(reader)


def test_a_device_without_end_is_refused():
    with pytest.raises(ValueError, match="/dev/zero: larger than 10 MB"):
        read_toml(Path("/dev/zero"))


@pytest.mark.parametrize(
    "value", [True, "200", [1.0, True], int(WHOLE), [["1", "2"]], 1j, None], ids=str
)
def test_only_numbers_are_settings(value):
    with pytest.raises(ValueError, match=r"plant.mass = .*: must be a number, or one") as caught:
        apply(GAINS, SCENE, {"plant.mass": value})
    assert len(str(caught.value)) < 120
