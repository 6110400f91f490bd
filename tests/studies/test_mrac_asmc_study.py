"""The MRAC / ASMC study, row by row: an independent implementation gave these numbers.

Printed digits are met to half of the last one plus 1e-4 of the value. Rows whose command switches,
or oscillates at half the sampling rate, depend on the last bit of a computer's arithmetic: a start
shifted by 1e-13 mm moves them. They have the spread that such shifts gave:

- SIM1 has an oscillation that takes one of two phases, each with its own figures, to 3e-4;
- SIM2 and the adaptive law without MRAC adapt c from an error that oscillates: 5e-3;
- with MRAC the error is fifty times smaller than without and oscillates as well: 1e-3, and 3e-4 in
  explicit steps, which the independent implementation took too.
"""

import functools

import numpy as np
import pytest

from jaxstage.controllers.adaptive_sliding import sampled_gain
from jaxstage.model.fields import replace
from jaxstage.numerics.smooth import Layer, implicit
from jaxstage.plants import explicit, on_load, two_inertia
from jaxstage.studies.experiment import simulate_all
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.mrac_asmc.experiments import (
    RUN_TIMES,
    ideal_adaptive,
    ideal_cascade,
    ideal_implicit,
    printed_sign,
    rough_adaptive,
    rough_cascade,
    rough_switched,
)
from jaxstage.studies.mrac_asmc.loops import TIMING, build, oscillation, version
from jaxstage.studies.mrac_asmc.loops import law as law_called
from jaxstage.studies.mrac_asmc.traces import (
    adaptive_law,
    gains_of,
    run_metrics,
    switched_law,
    trace,
    traced,
)

pytestmark = pytest.mark.long

SMOOTH = 1e-4
#: SIM2 and the adaptive law without MRAC
SHIFTED = 5e-3
SKIPPED = 8334


def half_digit(printed):
    """Half of the last digit of a printed number."""
    mantissa, _, power = printed.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return 0.5 * 10.0 ** (int(power or 0) - decimals)


def agree(found, printed, share=SMOOTH):
    value = float(printed)
    assert abs(found - value) <= half_digit(printed) + share * abs(value), (found, printed)


@functools.cache
def ideal():
    return run_metrics(*ideal_adaptive()) | run_metrics(*ideal_cascade())


@functools.cache
def rough():
    """One start of each case: the others are for the mean of what is chaotic."""
    adaptive, periods = rough_adaptive()
    found = {}
    for cases in (adaptive, rough_switched(), rough_cascade()):
        found |= run_metrics({k: case for k, case in cases.items() if "/start" not in k}, periods)
    return found


# --- ideal measurement, friction on the load -------------------------------------------------

ROWS = {  # max, mean abs, variance, eps, a, c at the end
    "asmc-mrac": ("0.2448", "0.02430", "1.283e-3", "230.0", "50.00", "397.1"),
    "asmc-mrac-caps": ("0.2604", "0.02650", "1.531e-3", "230.0", "50.00", "300"),
    "sim2": ("7.024", "0.5617", "0.8267", "232.2", "50.01", "89.59"),
    "asmc-caps": ("4.770", "0.1757", "0.2470", "230.7", "50.01", "300"),
}
FIGURES = ("max_um", "mean_um", "variance_um2", "gain_end", "sharpness_end", "slope_end")


@pytest.mark.parametrize("name", ROWS)
def test_rows(name):
    share = 1e-3 if "mrac" in name else SHIFTED
    for key, printed in zip(FIGURES, ROWS[name], strict=True):
        agree(ideal()[name][key], printed, share)


#: (max, variance) of the two phases that the oscillation at half the sampling rate can take
PHASES = ((4.835, 1.482), (4.8232, 1.4815))
#: max of the same two phases with the feed-forward: a start moved by 1e-13 um chooses
AHEAD = (1.8617, 1.8401)


def test_first_simulation():
    found = ideal()["sim1"]
    assert any(
        abs(found["max_um"] / top - 1) < 3e-4 and abs(found["variance_um2"] / spread - 1) < 3e-4
        for top, spread in PHASES
    )
    agree(found["mean_um"], "1.128", 2e-4)
    for key, printed in zip(FIGURES[3:], ("280.3", "36.38", "30"), strict=True):
        agree(found[key], printed)
    agree(found["settled_s"], "1.465", 1e-3)
    agree(found["gain_1.7_s"], "276.3")


def test_cascade_row():
    for key, printed in zip(FIGURES, ("6.941", "0.4939", "1.173"), strict=False):
        agree(ideal()["cascade"][key], printed)


def test_run_times():
    """Mean error over the second half of one period of 1, 2, 4 and 8 s."""
    rows = {
        "asmc-mrac-caps": ("0.6535", "0.178", "0.0107"),
        "asmc-caps": ("108.6", "15.81", "0.1053"),
        "cascade": ("4.365", "1.319", "0.1879"),
    }
    for name, printed in rows.items():
        for time, mean in zip(RUN_TIMES, printed, strict=True):
            share = 1e-3 if name == "cascade" else SHIFTED
            agree(ideal()[f"{name}/{time:g}s"]["mean_um"], mean, share)


def test_position_feedforward_helps_only_an_error_of_its_size():
    rows = {
        "asmc-mrac-caps-ahead": ("2.121", "1.996"),
        "cascade-ahead": ("4.401", "2.132"),
    }
    assert any(abs(ideal()["sim1-ahead"]["max_um"] / top - 1) < 3e-4 for top in AHEAD)
    agree(ideal()["sim1-ahead"]["mean_um"], "0.9101", 3e-4)
    for name, (top, mean) in rows.items():
        agree(ideal()[name]["max_um"], top, 1e-3)
        agree(ideal()[name]["mean_um"], mean, 1e-3)


def test_a_stiff_switch_oscillates_at_half_the_sampling_rate():
    """a = 50 is beyond 2 J1/J and a = 25 is not: hardly seen in the error, plain in the command."""
    stiff, soft = ideal()["sigmoid-mrac"], ideal()["sigmoid-mrac-soft"]
    agree(stiff["command_step_Nm"], "0.144", 1e-3)
    agree(soft["command_step_Nm"], "8e-5", 1e-3)
    command = stiff["trace"]["command_Nm"][10_000:10_400]
    signs = np.sign(np.diff(command))
    assert (signs[1:] == -signs[:-1]).mean() > 0.99


@pytest.fixture(scope="module")
def small_steps():
    """The adaptive rows in explicit steps of a forty-eighth of a period, with all memory."""

    def shown(memory):
        inner, w = memory.law, memory.weights
        return {
            "gain": inner.switching_gain, "sharpness": inner.sharpness, "slope": inner.slope,
            "model": memory.model, "w2": w.viscous, "w3": w.dry, "w4": w.constant,
        }  # fmt: skip

    cases, _ = ideal_adaptive()
    plant = two_inertia(("x",), on_load, explicit)
    chosen = {}
    for name in ("sim1", *ROWS):
        loop = replace(cases[name].loop, plant=plant, substeps=48, metric=trace(shown))
        chosen[name] = cases[name]._replace(loop=loop)
    return {
        name: {key: np.asarray(row)[:, 0] for key, row in run.rows.items()}
        for name, run in simulate_all(chosen).items()
    }


def test_rows_in_small_steps(small_steps):
    for name, printed in ROWS.items():
        error = small_steps[name]["error"][SKIPPED:] * 1e6
        found = np.abs(error).max(), np.abs(error).mean(), error.var()
        for value, text in zip(found, printed, strict=False):
            agree(value, text, 3e-4 if "mrac" in name else SHIFTED)


def test_trajectories_in_small_steps(small_steps):
    """e and u of tick 10; what adapts, the model and the weights after it; and tick 10417."""
    rows = small_steps
    for name, error, command in (
        ("sim1", "-6.338e-3", "-9.189e-4"),
        ("sim2", "-8.511e-4", "-0.07225"),
        ("asmc-mrac", "-5.849e-4", "-0.07821"),
    ):
        agree(rows[name]["error"][10] * 1e6, error)
        agree(rows[name]["command"][10], command)
    agree(rows["sim2"]["slope"][11], "30.011")
    mrac = rows["asmc-mrac"]
    agree(mrac["model"][10] * values.RATIO, "-0.07064")
    for key, scale, printed in (
        ("w2", 1, "-1.945e-5"), ("w3", values.RATIO, "-0.02785"), ("w4", values.RATIO, "-3.759e-3")
    ):  # fmt: skip
        agree(mrac[key][10] * scale, printed)
    agree(rows["sim1"]["error"][10417] * 1e6, "-1.1674", 3e-4)
    agree(rows["sim1"]["gain"][10417] * values.RATIO, "277.61")
    agree(rows["sim1"]["sharpness"][10417] / values.RATIO, "36.374")
    agree(rows["sim2"]["error"][10417] * 1e6, "-0.6214", SHIFTED)
    agree(rows["sim2"]["slope"][10417], "52.98", SHIFTED)


def test_trajectories_of_laws_that_do_not_adapt():
    error, command = (ideal()["cascade"]["trace"][key] for key in ("error_um", "command_Nm"))
    agree(error[10], "-0.01780")
    agree(command[10], "-1.0321e-3")
    agree(error[10417], "-0.0370")
    trace_of = switched_ideal()["smc1500"]["trace"]
    agree(trace_of["error_um"][10], "-0.4389")
    agree(trace_of["command_Nm"][10], "-0.5849")


def test_the_printed_sign_makes_the_axis_stick():
    found = run_metrics(printed_sign(), {})["sim1-printed"]
    for key, printed in zip(
        FIGURES, ("1998", "997.6", "4.996e5", "11.31", "28.42", "30"), strict=True
    ):
        agree(found[key], printed, 1e-3)


# --- switching -------------------------------------------------------------------------------


@functools.cache
def switched_ideal():
    law, drives = switched_law(), version("")
    gains = {
        "smc1500": gains_of(values.sliding_mode(1500)),
        "smc500": gains_of(values.sliding_mode(500)),
        "smc500-mrac": gains_of(values.sliding_mode(500), True),
    }
    return run_metrics({name: traced(law, g, drives) for name, g in gains.items()}, {})


@pytest.mark.parametrize(
    ("name", "variance", "chattering"),
    [("smc1500", 0.1621, 0.028), ("smc500", 0.0295, 0.008), ("smc500-mrac", 0.0271, 0.0095)],
)
def test_sign_switching_statistics(name, variance, chattering):
    found = switched_ideal()[name]
    assert found["variance_um2"] == pytest.approx(variance, rel=0.1)
    assert found["chattering_um"] == pytest.approx(chattering, rel=0.4)


def test_implicit_switching_against_sign_and_sigmoid():
    """The implicit switch of one layer removes the chattering of sgn at the same switching gain,
    and the command is as smooth as that of a sigmoid below its limit. So it is at the switching
    gain of the sigmoids."""
    law, drives = switched_law(implicit), version("")
    layer = Layer(layer=values.value(1.0))
    cases = {"one": traced(law, gains_of(values.sliding_mode(1500, layer)), drives)}
    runs = run_metrics(cases | ideal_implicit(), {})
    found, sign = runs["one"], switched_ideal()["smc1500"]
    assert found["variance_um2"] < 0.15 * sign["variance_um2"]
    assert found["chattering_um"] < 0.05 * sign["chattering_um"]
    assert found["command_step_Nm"] < 1e-3 * sign["command_step_Nm"]
    soft, stiff = (
        ideal()[name]["command_step_Nm"] for name in ("sigmoid-mrac-soft", "sigmoid-mrac")
    )
    assert found["command_step_Nm"] < 5 * soft
    assert runs["implicit-mrac"]["command_step_Nm"] < min(1.1 * soft, 1e-3 * stiff)


# --- scenario R ------------------------------------------------------------------------------

ROUGH = {  # variance and chattering; the range that four starts within 0.3 um gave
    "smc1500-r": (5.59, 5.67, 0.73),
    "smc500-r": (1.17, 1.20, 0.20),
    "smc500-mrac-r": (1.20, 1.77, 0.19),
    "smc1500-mrac-r": (54.8, 54.8, 3.03),
    "sigmoid-r": (0.955, 0.955, 0.029),
    "sigmoid-mrac-r": (0.119, 0.119, 0.037),
    "asmc-caps-r": (0.76, 0.78, 0.035),
    "asmc-mrac-caps-r": (0.104, 0.119, 0.038),
    "cascade-r": (1.24, 1.24, 0.008),
}


@pytest.mark.parametrize("name", ROUGH)
def test_scenario_r_statistics(name):
    low, high, chattering = ROUGH[name]
    found = rough()[name]
    assert 0.9 * low <= found["variance_um2"] <= 1.1 * high
    assert found["chattering_um"] == pytest.approx(chattering, rel=0.4)


def test_scenario_r_diverges_without_caps():
    found = rough()["asmc-mrac-r"]
    assert 300 < found["max_um"] < 1000
    assert found["sharpness_end"] > 1e4 and found["gain_end"] > 1000
    ends = found["slope_end"], found["gain_end"], found["sharpness_end"]
    figures = {"sampled_gain_end": {"x": sampled_gain(*ends, values.DT)}}
    assert (
        "run away" in oscillation(build(law_called("asmc-mrac"), version("-r"), TIMING), figures)[1]
    )
    capped = rough()["asmc-mrac-caps-r"]
    ends = capped["slope_end"], capped["gain_end"], capped["sharpness_end"]
    figures = {"sampled_gain_end": {"x": sampled_gain(*ends, values.DT)}}
    assert (
        len(oscillation(build(law_called("asmc-mrac-caps"), version("-r"), TIMING), figures)) == 1
    )


def test_scenario_r_run_times_flatten():
    means = [rough()[f"asmc-mrac-caps-r{time}"]["mean_um"] for time in ("", "/8s")]
    assert means == pytest.approx([0.24, 0.27], rel=0.15)


# --- friction on the motor -------------------------------------------------------------------


def test_friction_on_the_motor():
    drives, law = version("-motor"), adaptive_law()
    cases = {
        "sim1": traced(law, gains_of(values.sim1()), drives),
        "sim2": traced(law, gains_of(values.sim2()), drives),
    }
    found = run_metrics(cases, {})
    agree(found["sim1"]["max_um"], "3.022", 1e-3)
    agree(found["sim1"]["mean_um"], "1.088", 1e-3)
    agree(found["sim1"]["gain_end"], "280.6")
    agree(found["sim2"]["max_um"], "4.128", SHIFTED)
    agree(found["sim2"]["mean_um"], "0.630", SHIFTED)
    agree(found["sim2"]["slope_end"], "66.1", SHIFTED)
