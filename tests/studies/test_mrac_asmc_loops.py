"""The loops of the MRAC / ASMC study: keys, refusals, a lost run, timing, and two axes."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from jaxstage.metrics import columns, tracking
from jaxstage.model.fields import replace
from jaxstage.model.settings import known_leaves, replaced
from jaxstage.plants import explicit, on_load, two_inertia
from jaxstage.simulate.rollout import simulate
from jaxstage.studies.mrac_asmc import values
from jaxstage.studies.mrac_asmc.contouring import RADIUS, circled, contour_errors
from jaxstage.studies.mrac_asmc.loops import law as law_called
from jaxstage.studies.mrac_asmc.loops import loops
from tests.helpers.documented import undocumented
from tuning.store.prepare import execute, prepare

#: the metrics of the published tables: error, chattering, what adapts, change of the command
TABLES = {
    "drive_following_max_um", "drive_following_mean_um", "drive_following_variance_um2",
    "drive_glitch_max_um", "command_variation_Nm_per_s", "energy_copper_J",
}  # fmt: skip
ADAPTED = {"switching_gain_end_m_per_s2", "sharpness_end_s_per_m", "surface_slope_end_1_per_s"}


def test_the_json_of_a_run():
    """Through the command's own path: the cascade with friction on the motor."""
    result = execute(prepare("cascade-motor", []))
    figures = result["metrics"]
    assert figures["drive_following_max_um"]["x"] == pytest.approx(8.190, abs=1.4e-3)
    assert set(figures) >= {*TABLES, "drive_chattering_um"} and result["finite"]
    assert 0 < figures["drive_chattering_um"]["x"] < 0.1
    assert figures["drive_reversals"]["x"] == 3 and not result["notes"]
    assert not any(key.startswith("contour") for key in figures)
    assert not undocumented(figures)


@pytest.mark.fast
def test_every_loop_shows_what_the_tables_have():
    assert len(loops) == 28 and len({loop.name for loop in loops}) == 28
    for loop in loops:
        case = loop.build(replace(loop.timing, duration=1.0, skip=0.5))
        first = case.loop.reference.sample(case.path, jnp.asarray(0))
        keys = set(columns(case.metric.finish(case.metric.init(first)), case.loop.plant))
        assert keys >= TABLES and (keys >= ADAPTED) == ("asmc" in loop.name or "sim" in loop.name)
        assert not undocumented(keys)
        assert loop.name.endswith("-motor") == ("motor" in case.loop.plant.name)
        assert (case.scenario.drive.delay == 1) == ("-r" in loop.name)
        assert [recorded.metric.name for recorded in loop.recorded] == ["recorded_drive_error"]


def short(name="cascade", ticks=3):
    """A case of a few ticks."""
    loop = next(loop for loop in loops if loop.name == name)
    return loop.build(replace(loop.timing, duration=ticks * values.DT, skip=0.0))


def test_a_run_that_blows_up_says_so():
    """Explicit steps of a sixth of a period: flagged, and no figures."""
    case = short(ticks=400)
    loop = replace(case.loop, plant=two_inertia(("x",), on_load, explicit), substeps=6)
    run = js.with_metric(case._replace(loop=loop), tracking).simulate()
    assert run.final.non_finite_at >= 0 and run.final.left_path_at < 0
    assert np.isnan(run.report.ate)


@pytest.mark.fast
@pytest.mark.parametrize(
    ("name", "path", "value"),
    [
        ("sim1", "slope", 0.0), ("sim1", "sharpness", 0.0), ("sim1", "switching_gain", -1e-9),
        ("sim1", "slope_rate", -1.0), ("sim1", "switching_rate", np.nan),
        ("sim1", "sharpness_rate", -1.0), ("sim1", "slope_most", 0.5),
        ("asmc-mrac", "model_rate", 0.0), ("asmc-mrac", "leak", -1.0),
        ("asmc-mrac", "rates.dry", -1.0), ("asmc-mrac", "limits.viscous", -1.0),
        ("asmc-mrac", "dry_width", 0.0), ("cascade", "drive.delay", 2.0),
        ("cascade", "drive.delay", 0.5), ("cascade", "start.offset", np.inf),
    ],
)  # fmt: skip
def test_impossible_values_are_refused(name, path, value):
    case = short(name)
    root = path if path.startswith(("drive", "start")) else f"gains.{path}"
    _, old = known_leaves(case.gains, case.scenario)[root]
    gains, scenario = replaced(case.gains, case.scenario, root, jnp.full_like(old, value))
    with pytest.raises(ValueError, match=root):
        simulate(case.loop, gains, scenario, case.path, 2)


@pytest.mark.fast
def test_a_leak_too_fast_for_the_period_is_refused():
    case = short("asmc-mrac")
    gains = replace(case.gains, leak=jnp.full(1, 2.01 / values.DT))
    with pytest.raises(ValueError, match=r"loop\.dt"):
        simulate(case.loop, gains, case.scenario, case.path, 2)


@pytest.mark.fast
def test_naming_the_laps_drops_the_duration():
    assert prepare("cascade", []).case.window.ticks == 25_000
    laps = prepare("cascade", ["laps=2", "skip=0"]).case.window
    assert (laps.ticks, laps.start) == (2 * 8333, 0)


def test_the_motors_follow_a_circle_better_than_the_load():
    """The contour error is the distance from the circle; the load adds the twist of the shafts."""
    case = circled(law_called("cascade"))
    rows = case.simulate().rows
    errors = contour_errors(case, rows)
    motors = np.abs(np.linalg.norm(rows[1], axis=1) - RADIUS) * 1e6
    np.testing.assert_allclose(errors["motor"], motors, atol=1e-8)
    load, motor = (np.sqrt(np.mean(errors[side][case.window.start :] ** 2)) for side in errors)
    assert 1.1 * motor < load < 3 * motor
