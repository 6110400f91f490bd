"""The frequency view of published loops: margins, sine sweep beside them, and what is said."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from jaxstage.frequency.linear import linearise
from jaxstage.frequency.response import connected, modal, response
from jaxstage.frequency.sweep import sine_sweep
from jaxstage.hardware.sensors import Encoder, encoder

KEYS = {
    "gm_up_db", "gm_up_Hz", "gm_down_db", "gm_down_Hz", "pm_deg", "pm_Hz", "delay_margin_us",
    "ms", "ms_Hz", "mt", "bandwidth_Hz", "bandwidth_feedback_Hz", "stiffness_min_N_um",
    "stiffness_Hz",
}  # fmt: skip


@pytest.fixture(scope="module")
def cascade():
    case = js.build("cascade-circle")
    return case, js.frequency.view(case, 0.05)


def test_the_cascade_at_speed(cascade):
    _, seen = cascade
    answer = js.frequency.answer(seen)
    assert set(answer) == {
        "loop", "at_m_s", "cut", "steady", "spectral_radius", "axes", "coupled", "sine", "notes",
    }  # fmt: skip
    assert answer["steady"] and answer["loop"] == "cascade-circle" and answer["notes"] == []
    x = answer["axes"]["x"]
    assert set(x) == KEYS
    assert answer["spectral_radius"] == pytest.approx(0.97640, abs=5e-6)
    assert x["pm_deg"] == pytest.approx(67.306, abs=5e-4)
    assert 2 * np.pi * x["pm_Hz"] == pytest.approx(4241.0, abs=0.05)
    assert x["ms"] == pytest.approx(1.263, abs=5e-4)
    assert x["delay_margin_us"] == pytest.approx(np.radians(x["pm_deg"]) / 4241.0 * 1e6, rel=1e-4)
    assert answer["coupled"]["ms"] == pytest.approx(
        max(a["ms"] for a in answer["axes"].values()), rel=1e-9
    )
    assert x["stiffness_min_N_um"] > 0 and x["bandwidth_feedback_Hz"] > 0


def test_axes_of_a_table_do_not_hear_each_other(cascade):
    _, seen = cascade
    matrix = js.frequency.sensitivity(seen.model)(seen.omega)
    assert np.abs(matrix[:, 0, 1]).max() < 1e-12


def test_a_sine_sweep_shows_the_linear_view_where_the_loop_is_smooth(cascade):
    _, seen = cascade
    case = seen.case
    swept = sine_sweep(
        case.loop, case.gains, case.scenario, case.path, 0, [1e-2, 0.1], [2, 12, 60, 250, 900]
    )
    linear = js.frequency.sensitivity(seen.model)(swept.omega)[:, 0, 0]
    assert not swept.lost.any()
    assert np.abs(swept.sensitivity / linear - 1).max() < 1e-6
    assert swept.harmonics.max() < 1e-5


def test_a_stuck_axis_is_said_and_the_sweep_frees_it():
    """At rest dry friction holds: S = 1; a sine of 1 A breaks it loose."""
    seen = js.frequency.view(js.build("cascade-circle"), 0.0)
    answer = js.frequency.answer(seen)
    assert answer["axes"]["x"]["pm_deg"] is None and answer["axes"]["x"]["ms"] == 1
    assert sum("sticks: L = 0" in note for note in answer["notes"]) == 2
    case = seen.case
    swept = sine_sweep(
        case.loop, case.gains, case.scenario, case.path, 0, [1e-3, 1.0], [4, 24, 120, 500]
    )
    assert np.allclose(np.abs(swept.sensitivity[0]), 1, atol=1e-9)
    assert np.abs(swept.sensitivity[1]) == pytest.approx([0.308, 0.349, 0.728, 1.108], abs=0.02)
    assert swept.harmonics[1].max() > 1e-3, "what is not linear has harmonics"


def test_the_fuzzy_cmac_adapts_and_switches():
    seen = js.frequency.view(js.build("dfcmac-circle"), 0.05)
    answer = js.frequency.answer(seen)
    x = answer["axes"]["x"]
    assert x["pm_deg"] == pytest.approx(21.38, abs=5e-3)
    assert 2 * np.pi * x["pm_Hz"] == pytest.approx(2007.4, abs=0.1)
    assert x["ms"] == pytest.approx(2.697, abs=5e-4)
    assert x["ms_Hz"] == pytest.approx(321.9, abs=0.5)
    assert not answer["steady"]
    said = " ".join(answer["notes"])
    assert "not steady" in said and "is invisible to a linearisation" in said
    small = connected(seen.model)
    assert len(small.a) < len(seen.model.a) / 2, "cells that are not active are left out"
    few = seen.omega[::400]
    whole = np.asarray(response(seen.model.between("cut", "cut"), jnp.asarray(few)))
    assert np.abs(modal(seen.model.between("cut", "cut")).at(few) - whole).max() < 1e-8


def test_many_plants_at_once(cascade):
    """A batch of linearisations is the single ones."""
    _, seen = cascade
    moved = seen.case

    def model(factor):
        plant = js.replace(moved.scenario.plant, mass=moved.scenario.plant.mass * factor)
        scenario = js.replace(moved.scenario, plant=plant)
        return linearise(moved.loop, moved.gains, scenario, moved.path, 50).a

    factors = jnp.asarray([0.8, 1.0, 1.25])
    batch = jax.jit(jax.vmap(model))(factors)
    for i, factor in enumerate(factors):
        assert np.allclose(batch[i], model(factor), rtol=1e-12, atol=1e-15)


def test_the_position_cut_of_a_cascade_is_its_outer_loop():
    """S of the position loop differs from that at the input; both are of one closed loop."""
    case = js.build("cascade-circle")
    inner, outer = (js.frequency.view(case, 0.05, cut) for cut in ("input", "position"))
    assert outer.radius == pytest.approx(inner.radius, rel=1e-12)
    x = js.frequency.answer(outer)["axes"]["x"]
    assert x["ms"] < js.frequency.answer(inner)["axes"]["x"]["ms"] or x["pm_deg"] > 67.4


@pytest.mark.fast
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"at": (0.1, 0.1, 0.1)}, "3 speeds for 2 axes (x, y)"),
        ({"at": float("nan")}, "must be finite"),
        ({"at": 0.05, "cut": "middle"}, "must be one of input, position"),
        ({"at": 0.05, "band": (1.0, 5000.0)}, "half the sampling rate"),
        ({"at": 0.05, "band": (0.0, 100.0)}, "must be 0 < from < to"),
    ],
)
def test_wrong_uses(words, said):
    with pytest.raises(ValueError) as error:
        js.frequency.view(js.build("pi-circle"), **words)
    assert said in str(error.value)


def test_a_lost_operating_motion_is_named():
    case = js.build("pi-circle")
    weak = case._replace(loop=js.replace(case.loop, path_limit=1e-9))
    with pytest.raises(ValueError, match="left the path at tick"):
        js.frequency.view(weak, 0.05)


@pytest.mark.fast
@pytest.mark.parametrize(("amplitudes", "turns"), [([0.0], [3]), ([-1.0], [3]), ([1.0], [0])])
def test_wrong_sines(amplitudes, turns):
    case = js.build("pi-circle")
    with pytest.raises(ValueError, match="must be"):
        sine_sweep(case.loop, case.gains, case.scenario, case.path, 0, amplitudes, turns)


def test_the_model_for_other_tools(cascade):
    """python-control and scipy give the same response."""
    _, seen = cascade
    few = np.array([30.0, 300.0, 3000.0])
    ours = modal(seen.model).at(few)
    theirs = js.frequency.to_control(seen.model, seen.axes)
    assert theirs.input_labels[:2] == ["cut_x", "cut_y"]
    assert np.abs(np.moveaxis(theirs(np.exp(1j * few * seen.model.dt)), -1, 0) - ours).max() < 1e-9
    scipys = js.frequency.to_scipy(seen.model)
    assert np.array_equal(scipys.A, np.asarray(seen.model.a)) and scipys.dt == seen.model.dt


def test_an_encoder_is_exact_in_the_linear_view_only():
    """A quantised signal has slope 0: the view says that it left this out, the sweep does not."""
    case = js.build("pi-circle")
    sensor = Encoder(resolution=jnp.asarray(1e-6), bandwidth=jnp.asarray(jnp.inf))
    coarse = case._replace(
        loop=js.replace(case.loop, sensor=encoder),
        scenario=js.replace(case.scenario, sensor=sensor),
    )
    seen = js.frequency.view(coarse, 0.05)
    assert seen.case.scenario.sensor.resolution == 1e-6
    notes = js.frequency.answer(seen)["notes"]
    assert sum("the encoder's resolution is 0 in the linear view" in note for note in notes) == 1
    assert js.frequency.answer(js.frequency.view(case, 0.05))["notes"] == []
    swept = [
        sine_sweep(c.loop, c.gains, c.scenario, c.path, 0, [1e-3], [20, 300])
        for c in (seen.case, js.frequency.view(case, 0.05).case)
    ]
    assert swept[0].harmonics.max() > 100 * swept[1].harmonics.max()
