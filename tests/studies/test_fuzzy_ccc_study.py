"""The fuzzy cross-coupling study: its loops as a user runs them, its evidence, its pictures."""

import json
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from jaxstage import plot
from jaxstage.controllers.fuzzy_rules import readable
from jaxstage.controllers.parts.fuzzy import seven_sets
from jaxstage.metrics import (
    columns,
    command_change,
    contour,
    contour_gains,
    record,
    together,
    windowed,
)
from jaxstage.model.fields import replace
from jaxstage.plot.contour import magnification
from jaxstage.plot.pictures import VIEWS, _applies
from jaxstage.references import helical
from jaxstage.studies.case import scored
from jaxstage.studies.experiment import simulate_all
from jaxstage.studies.fuzzy_ccc import study, values
from jaxstage.studies.fuzzy_ccc.experiments import (
    SIGNALS,
    _matched,
    estimate_error,
    sign_gains,
    switched,
)
from jaxstage.studies.fuzzy_ccc.loops import TIMING, build, law
from jaxstage.studies.fuzzy_ccc.variants import of_adaptive, of_none, of_pid
from tests.helpers.documented import undocumented
from tuning.app import main as cli

pytestmark = pytest.mark.long

SHORT = replace(TIMING, duration=0.2, dt=1e-3)


def entry(name):
    return next(one for one in study.loops if one.name == name)


@pytest.fixture(scope="module")
def recorded():
    """0.2 s of the adaptive loop with a few figures and all its rows."""
    case = entry("af-pid-ccc").build(SHORT)
    schedule = law("af-pid-ccc").schedule
    light = scored(together(contour, command_change, contour_gains(schedule)), case.window)
    run = js.with_metric(case, together(light, record)).simulate()
    return case, run


# --- loops ---------------------------------------------------------------------------------------


@pytest.mark.fast
@pytest.mark.parametrize("name", ["none", "pid-ccc", "fuzzy-frozen", "af-pid-ccc", "pd"])
def test_each_loop_has_a_short_and_a_long_name(name):
    short, long = (entry(n).build(TIMING) for n in (name, f"{name}-helix"))
    assert (short.name, long.name) == (name, f"{name}-helix")
    assert short.loop == long.loop and short.window == long.window
    assert jax.tree.all(jax.tree.map(np.array_equal, short.gains, long.gains))
    assert short.window.ticks == 50_000 and short.window.start == 0


@pytest.mark.fast
def test_a_lap_is_two_turns_at_any_speed():
    full = entry("none").build(TIMING)
    slow = entry("none").build(replace(TIMING, lap_time=20.0))
    fed = entry("none").build(replace(TIMING, feed=0.06362265 * 6e4))
    ends = [
        case.loop.reference.sample(case.path, jnp.asarray(case.window.ticks)).position
        for case in (full, slow, fed)
    ]
    for end in ends:
        np.testing.assert_allclose(end, [0.05, 0, 0.1], atol=1e-6)
    assert slow.window.ticks == 2 * full.window.ticks == 2 * fed.window.ticks


@pytest.mark.fast
@pytest.mark.parametrize("timing", [{"lap_time": 1e-4}, {"duration": 6e-4, "dt": 1e-3}])
def test_a_period_longer_than_the_run_is_refused(timing):
    with pytest.raises(ValueError, match=r"dt = .* s: must be <= .* s, the length"):
        entry("none").build(replace(TIMING, **timing))


@pytest.mark.fast
@pytest.mark.parametrize("name", ["none", "af-pid-ccc"])
def test_a_switching_gain_below_what_is_left_of_the_load_is_noted(name):
    """|d - d^| is 21, 15 and 12 mm/s2 with the observer of the study."""
    one = entry(name)
    case = one.build(TIMING)
    assert one.notes(case, {}) == ()
    weak = jnp.array([0.02, 0.5, 0.5])
    observed = case.gains if name == "none" else case.gains.law
    observed = replace(observed, law=replace(observed.law, switching_gain=weak))
    gains = observed if name == "none" else replace(case.gains, law=observed)
    (note,) = one.notes(case._replace(gains=gains), {})
    assert note.startswith("x: switching gain 0.02 m/s2 is below the 0.0209 m/s2")


def test_run_on_the_command_line(monkeypatch, capsys):
    words = ["run", "af-pid-ccc", "--duration", "0.2", "--set", "dt=1e-3", "--json"]
    monkeypatch.setattr("jaxstage.system.runtime.configure", lambda **_: None)
    monkeypatch.setattr(sys, "argv", ["jaxstage", *words])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    found = json.loads(capsys.readouterr().out)
    assert not stopped.value.code and found["finite"] and found["notes"] == []
    metrics = found["metrics"]
    assert metrics["contour_max_um"] == pytest.approx(111.5263, rel=1e-6)
    assert metrics["following_max_um"]["x"] == pytest.approx(100.0)
    for key in (
        "contour_tangent_rms_um", "command_variation_A_per_s", "command_change_rms_A",
        "contour_proportional_mean_1_per_s2", "contour_integral_end_1_per_s3",
        "contour_derivative_end_1_per_s", "sliding_mean_mm_per_s", "energy_J",
    ):  # fmt: skip
        assert metrics[key] is not None, key
    assert not undocumented(metrics)


def test_rules_are_readable_before_and_after(recorded):
    case, run = recorded
    text = readable(case.gains, run.final.memory)
    assert text is not None
    assert "X1 = 3 tanh(-E / 50 um), X2 = 3 tanh(-E' / 2 mm/s)" in text
    assert "sets of X2: centres -3 -2 -1 0 1 2 3, width 0.6006" in text
    blocks = dict(block.split("\n", 1) for block in text.strip().split("\n\n")[1:])
    assert len(blocks) == 6
    for symbol, unit, field in (
        ("K_P", "1/s2", "proportional"), ("K_I", "1/s3", "integral"), ("K_D", "1/s", "derivative"),
    ):  # fmt: skip
        for when, rules in (
            ("start", case.gains.extra.rules),
            ("end", run.final.memory.extra.learned),
        ):
            block = blocks[f"{symbol} in {unit}, at the {when}: rows X1, columns X2"]
            numbers = [line.split("|")[1].split() for line in block.splitlines()[1:]]
            np.testing.assert_allclose(np.array(numbers, float), getattr(rules, field), rtol=6e-4)
    begun, ended = (
        blocks[f"K_P in 1/s2, at the {w}: rows X1, columns X2"] for w in ("start", "end")
    )
    assert begun != ended, "nothing was learned"
    bare = entry("none").build(SHORT)
    assert readable(bare.gains, run.final.memory.law) is None


# --- metrics -------------------------------------------------------------------------------------


def test_figures_of_gains_and_command(recorded):
    case, run = recorded
    rows, figures = run.rows["record"], columns(run.report["scored"], case.loop.plant)
    change = np.diff(rows.command, axis=0)
    np.testing.assert_allclose(
        list(figures["command_change_rms_A"].values()), np.sqrt((change**2).mean(axis=0))
    )
    gain = rows.memory.extra.proportional_gain
    assert figures["contour_proportional_mean_1_per_s2"] == pytest.approx(gain.mean())
    assert figures["contour_proportional_end_1_per_s2"] == pytest.approx(gain[-1])
    part = windowed(command_change, 50, 120)
    acc, _ = jax.lax.scan(
        lambda a, s: part.update(a, s, case.loop.dt),
        part.init(jax.tree.map(lambda x: x[0], rows.setpoint)), rows,
    )  # fmt: skip
    inside = np.sqrt((change[50:119] ** 2).mean(axis=0))
    np.testing.assert_allclose(part.finish(acc).command_change_rms, inside)


# --- experiments ---------------------------------------------------------------------------


@pytest.mark.fast
def test_matched_axes_are_alike_and_disturbed_as_before():
    case = build(law("af-pid-ccc"), "af", TIMING)
    found = _matched(case)
    for tree in (found.gains.law, found.scenario.plant, found.gains.command_per_acceleration):
        assert all((leaf == leaf[0]).all() for leaf in jax.tree.leaves(tree))
    for one in (case, found):
        disturbed = one.scenario.load.amplitude / one.scenario.plant.mass
        np.testing.assert_allclose(disturbed, [20 / 12, 15 / 8, 2.0])
    assert jax.tree.all(jax.tree.map(np.array_equal, case.gains.extra, found.gains.extra))


#: RMS in um of the true contour error after 10 s, the laws integrated in continuous time
VARIANTS = {
    "af-pid-ccc/rates-0.25": 7.9807, "af-pid-ccc/rates-8": 6.2528, "af-pid-ccc/leak": 7.5400,
    "af-pid-ccc/mass": 7.1574, "af-pid-ccc/rest": 11.950,
    "pid-ccc/no-integral": 9.8251, "pid-ccc/K_P-1500": 7.6030, "pid-ccc/K_P-2000": 6.8920,
    "pid-ccc/K_P-4000": 5.2615, "pid-ccc/mass": 8.2282, "pid-ccc/rest": 22.963,
    "none/blind": 354.33, "none/rest": 42.412,
}  # fmt: skip


def test_variants_are_met_by_the_loops_of_the_study():
    """Sampled at 1 ms in place of continuous: a wrong number in a variant shows, 2 % does not."""
    cases = {}
    for name, make in (("none", of_none), ("pid-ccc", of_pid), ("af-pid-ccc", of_adaptive)):
        cases |= make(entry(name).build(TIMING))
    cases = {name: cases[name] for name in VARIANTS}
    coarse = {
        name: case._replace(
            loop=replace(case.loop, reference=helical(1e-3), metric=contour, dt=1e-3),
            window=case.window._replace(ticks=10_000),
        )
        for name, case in cases.items()
    }
    assert len({case.loop for case in coarse.values()}) == 3, "variants share the loops"
    found = {name: run.report.contour_rms * 1e6 for name, run in simulate_all(coarse).items()}
    for name, expected in VARIANTS.items():
        assert found[name] == pytest.approx(expected, rel=0.02), name


def test_the_observer_is_judged_by_its_own_record():
    """With the sign and a small gain the estimate is within 2 % of the load's amplitude."""
    timing = replace(TIMING, dt=1e-3, duration=2.5, skip=1.0)
    case = switched("small", None, sign_gains(0.25), timing)
    rows = js.with_metric(case, SIGNALS).simulate().rows
    signals = jax.tree.map(np.asarray, rows)
    found = estimate_error({"small gain, observer/signals": signals})
    assert all(0.002 < share < 0.02 for share in found)
    off = signals | {"estimate_m_per_s2": signals["estimate_m_per_s2"] + 0.1 * 20 / 12}
    assert estimate_error({"small gain, observer/signals": off})[0] > 0.09


# --- pictures ------------------------------------------------------------------------------


def texts(figure):
    found = [text.get_text() for text in figure.texts]
    for ax in figure.axes:
        found += [text.get_text() for text in ax.texts]
        found += [ax.get_xlabel(), ax.get_ylabel(), ax.get_title()]
    return " ".join(found)


@pytest.fixture(scope="module")
def shown(recorded):
    case, run = recorded
    return plot.view(case, run.report["scored"], run.rows["record"])


def test_the_path_in_space_is_drawn_off_by_the_magnified_error(shown):
    figure = plot.space(shown)
    (ax,) = figure.axes
    factor = magnification(shown)
    assert f"× {factor:,.0f}" in texts(figure)
    tool = next(line for line in ax.lines if "tool" in str(line.get_label()))
    first = np.array([axis[0] for axis in tool.get_data_3d()]) / 1e3
    aside = np.linalg.norm(first - shown.nearest[0]) / factor
    np.testing.assert_allclose(aside, shown.distance[0], rtol=1e-6)
    with pytest.raises(ValueError, match="three axes"):
        plot.space(shown._replace(axes=("x", "y")))


def test_scheduled_gains_are_drawn(shown):
    words = texts(plot.schedule(shown))
    assert all(name in words for name in ("K_P in 1/s²", "K_I in 1/s³", "K_D in 1/s"))
    assert VIEWS["schedule"] is plot.schedule and VIEWS["space"] is plot.space
    assert shown.schedule.shape == (200, 3)
    none = shown._replace(schedule=None, axes=("x", "y"))
    with pytest.raises(ValueError, match="schedules no contour gains"):
        plot.schedule(none)
    for view, applies in ((shown, True), (none, False)):
        assert _applies("schedule", view) == _applies("space", view) == applies


def test_sets_and_rules_are_drawn():
    sets = jax.tree.map(jnp.asarray, seven_sets())
    figure = plot.memberships(sets, "E")
    heights = [line.get_ydata().max() for line in figure.axes[0].lines]
    np.testing.assert_allclose(heights, 1, atol=1e-4)
    assert "NB" in texts(figure) and "PB" in texts(figure)
    rules = jnp.asarray(values.fuzzy_gains().rules.proportional)
    words = texts(plot.rule_surface(sets, sets, rules, "K_P in 1/s2"))
    assert words.count("1800") == 4 and "200" in words
