"""The adaptive sliding-mode study: its table, energy, divergence, gradients, batches."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from jaxstage.controllers import nonlinear_surface, per_axis
from jaxstage.controllers.parts import damping, reaching
from jaxstage.controllers.parts.damping import FinalDamping
from jaxstage.hardware.sensors import Noisy, encoder, ideal_sensor, noisy
from jaxstage.metrics import (
    between,
    contour,
    effort,
    energy,
    following,
    reaching_gain,
    recorded_command,
    together,
    variance_above,
    windowed,
)
from jaxstage.model.fields import replace
from jaxstage.model.signals import Output
from jaxstage.model.validate import check
from jaxstage.plants import screw_table
from jaxstage.studies.adaptive_smc import values
from jaxstage.studies.adaptive_smc.experiment_claims import matched
from jaxstage.studies.adaptive_smc.experiments import SLOPES, rows
from jaxstage.studies.adaptive_smc.loops import (
    CUTOFF,
    MATCHED,
    TIMING,
    build,
    gain_of,
    law,
    loops,
    notes,
    scene,
)
from jaxstage.studies.experiment import simulate_all

pytestmark = pytest.mark.long

COLUMNS = (
    "max1 max2 mean1 mean2 maxall2 maxfine1 cont_max cont_mean var1 var2 hf1 tv1 E_net E_clip "
    "E_cu kmean1 kmean2"
).split()

#: um, V2, V/s, mWh, 1/s; derived from an independent implementation of the same equations
TABLE = """
smc-s0 | 0.01715 | 0.01725 | 0.008318 | 0.009189 | 7.362 | 0.01719 | 0.01774 | 0.01186 | 1.371 | 1.656 | 0.0003544 | 1.198 | 68.935 | 68.94 | 27.014 | 80 | 80
smc-s0m | 0.01715 | 0.01725 | 0.008318 | 0.009189 | 0.01725 | 0.01719 | 0.01774 | 0.01186 | 1.371 | 1.656 | 0.0003544 | 1.198 | 68.444 | 68.45 | 26.551 | 80 | 80
smc-s1 | 4.471 | 4.215 | 0.3376 | 0.5003 | 7.658 | 4.471 | 4.467 | 0.4726 | 1.543 | 1.96 | 0.001344 | 3.454 | 75.595 | 75.595 | 31.278 | 80 | 80
smc-k120-s1 | 2.992 | 2.826 | 0.222 | 0.3311 | 5.398 | 2.993 | 2.99 | 0.3096 | 1.539 | 1.958 | 0.001452 | 3.407 | 75.728 | 75.729 | 31.404 | 120 | 120
smc-star-s1 | 2.713 | 2.563 | 0.1989 | 0.2955 | 5.33 | 2.715 | 2.711 | 0.2783 | 1.539 | 1.958 | 0.001564 | 3.416 | 75.734 | 75.734 | 31.408 | 80 | 80
smc-star-star-s1 | 3.598 | 3.392 | 0.2683 | 0.3988 | 7.324 | 3.598 | 3.595 | 0.3748 | 1.541 | 1.959 | 0.001417 | 3.451 | 75.598 | 75.599 | 31.277 | 100 | 100
asmc-s1 | 4.438 | 2.836 | 0.3118 | 0.3364 | 7.57 | 4.438 | 4.435 | 0.3601 | 1.543 | 1.958 | 0.001433 | 3.463 | 75.582 | 75.582 | 31.261 | 87.04 | 118.5
asmc-s1-wide | 4.582 | 7.313 | 0.3298 | 0.79 | 7.57 | 4.582 | 7.311 | 0.6624 | 1.543 | 1.961 | 0.00141 | 3.463 | 75.601 | 75.601 | 31.289 | 82.2 | 54.91
smc-s2 | 2.519 | 2.335 | 0.1615 | 0.2317 | 7.126 | 2.519 | 2.517 | 0.23 | 1.537 | 1.957 | 0.00144 | 3.335 | 75.557 | 75.557 | 31.229 | 80 | 80
asmc-s2 | 2.503 | 2.685 | 0.157 | 0.2406 | 7.102 | 2.504 | 2.684 | 0.2341 | 1.537 | 1.957 | 0.001461 | 3.329 | 75.562 | 75.562 | 31.235 | 84.14 | 75.3
smc-s3 | 4.421 | 4.172 | 0.336 | 0.4988 | 6.918 | 4.422 | 4.417 | 0.4707 | 1.548 | 1.964 | 0.003006 | 8.586 | 75.804 | 75.807 | 31.486 | 80 | 80
asmc-s3 | 4.167 | 2.828 | 0.2904 | 0.3141 | 6.878 | 4.17 | 4.164 | 0.3333 | 1.547 | 1.961 | 0.003662 | 9.367 | 75.789 | 75.791 | 31.465 | 92.64 | 126.7
smc-s4 | 2.162 | 2.349 | 1.517 | 1.7 | 3.018 | 3.512 | 1.919 | 0.6046 | 752.6 | 749.9 | 751.1 | 10962 | 13402 | 13402 | 13355 | 80 | 80
smc-k120-s4 | 1.724 | 1.854 | 1.208 | 1.331 | 1.854 | 3.298 | 1.436 | 0.4451 | 1028 | 1023 | 1026 | 12814 | 18282 | 18282 | 18234 | 120 | 120
smc-s5 | 4.748 | 4.388 | 0.319 | 0.4644 | 16.31 | 4.75 | 4.742 | 0.4197 | 1.409 | 1.845 | 0.001399 | 3.393 | 71.54 | 71.571 | 31.105 | 80 | 80
smc-s6 | 4.402 | 4.149 | 0.334 | 0.4948 | 7.477 | 4.402 | 4.398 | 0.4653 | 1.543 | 1.96 | 0.001394 | 3.467 | 75.608 | 75.608 | 31.291 | 80 | 80
smc-s6-printed | 4.54 | 4.281 | 0.3405 | 0.5052 | 7.9 | 4.54 | 4.536 | 0.4786 | 1.543 | 1.96 | 0.001282 | 3.447 | 75.587 | 75.588 | 31.27 | 80 | 80
smc-s7 | 0.4486 | 0.4613 | 0.2196 | 0.2265 | 9.032 | 0.4817 | 0.4281 | 0.1486 | 1.954 | 2.252 | 0.4557 | 266.5 | 81.194 | 81.335 | 37.4 | 80 | 80
smc-star-s7 | 0.3032 | 0.3031 | 0.1492 | 0.1513 | 6.545 | 0.3404 | 0.2731 | 0.1115 | 2.073 | 2.369 | 0.5741 | 302.4 | 83.432 | 83.623 | 39.638 | 80 | 80
asmc-s7 | 0.4123 | 0.3869 | 0.1466 | 0.1363 | 8.742 | 0.4423 | 0.4154 | 0.1324 | 1.807 | 2.107 | 0.3076 | 201 | 78.724 | 78.82 | 34.931 | 4.115 | 4.809
"""  # noqa: E501
ROWS = {
    name.strip(): dict(zip(COLUMNS, map(float, cells), strict=True))
    for name, *cells in (line.split("|") for line in TABLE.strip().splitlines())
}


def tolerance(name, column):
    """Relative. Quantised and switching runs are chaotic: rounding alone moves their digits."""
    scenario = name.removesuffix("-wide").removesuffix("-printed")[-2:]
    if name == "asmc-s7" and column[:3] in ("max", "mea", "con"):
        return 0.1
    if scenario in ("s3", "s4", "s7"):
        return {"s3": 0.03, "s4": 0.01, "s7": 0.01}[scenario]
    return 5e-4 if column.startswith("E_") else 1e-3


def lean(case):
    """The columns of the table and nothing else: metrics cost more than the physics."""
    start, stop = case.window.start, case.window.stop
    late = together(following, contour, effort(CUTOFF), between, reaching_gain(gain_of))
    parts = (
        windowed(late, start, stop, name="late"),
        windowed(together(following, energy), 0, stop, name="whole"),
        recorded_command,
    )
    return js.with_metric(case, together(*parts))


def with_gain(case, value):
    return case._replace(gains=replace(case.gains, reaching=values.steady_gain(value)))


@functools.cache
def runs():
    """Every row, and K = 400 1/s with lam + gam beta = 58 1/s, in few compiled programs."""
    cases = {name: lean(case) for name, case in rows().items()}
    cases["diverging"] = with_gain(cases["smc-s1"], 400.0)
    return simulate_all(cases)


def row(name):
    run = runs()[name]
    late, whole = run.report["late"], run.report["whole"]
    peak, average = (1e6 * late["following"].following_max, 1e6 * late["following"].following_mean)
    command, drawn = late["effort"], whole["energy"]
    above = variance_above(run.rows["recorded_command"][200:4000], values.DT, CUTOFF)
    gain = late["reaching_gain"].reaching_gain_mean
    found = (
        *peak, *average, 1e6 * whole["following"].following_max[1],
        1e6 * late["between"].following_max_between[0], 1e6 * late["contour"].contour_max,
        1e6 * late["contour"].contour_mean, *command.command_variance, above[0],
        command.command_variation[0], drawn.energy_net / 3.6, drawn.energy / 3.6,
        drawn.energy_copper / 3.6, *gain,
    )  # fmt: skip
    return dict(zip(COLUMNS, map(float, found), strict=True))


# --- the table -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROWS)
def test_the_table(name):
    found = row(name)
    for column, expected in ROWS[name].items():
        limit = tolerance(name, column)
        assert found[column] == pytest.approx(expected, rel=limit), (column, found[column])
    assert runs()[name].final.left_path_at == runs()[name].final.non_finite_at == -1


def test_every_row_is_a_loop():
    assert set(ROWS) == set(rows()) <= {entry.name for entry in loops}


def test_energy_in_closed_form():
    """S0m: E_mech = B <r'^2> T, E_cu = R / K^2 (J^2 <r''^2> + B^2 <r'^2>) T, for exact tracking;
    the sampled law comes to it at first order in the control period, within 1e-5 at half of it."""
    w = 2 * np.pi / 20
    speed2, change2 = 2.5 * 5e-3**2 * w**2, 34 * 5e-3**2 * w**4
    inertia, viscosity = values.inertia(), values.viscosity()
    mechanical = viscosity * speed2 * 20
    copper = 0.4 / (values.force_per_volt() / 2) ** 2
    copper = copper * (inertia**2 * change2 + viscosity**2 * speed2) * 20
    np.testing.assert_allclose(mechanical, [73.0366, 77.7765], rtol=1e-6)
    np.testing.assert_allclose(copper, [44.8560, 50.7267], rtol=1e-6)
    usual = runs()["smc-s0m"].report["whole"]["energy"]
    half = replace(TIMING, dt=TIMING.dt / 2)
    fine = js.with_metric(build(law("smc"), MATCHED, half), energy).simulate().report
    for part, exact in (
        ("energy_mechanical", np.sum(mechanical)),
        ("energy_copper", np.sum(copper)),
        ("energy_net", np.sum(mechanical + copper)),
    ):
        off = [getattr(report, part) / exact - 1 for report in (usual, fine)]
        assert 0 < off[1] < 1e-5 and 1.8 < off[0] / off[1] < 2.5, (part, off)


@pytest.mark.parametrize("name", ["smc-s0", "smc-s1", "asmc-s3", "smc-s4", "asmc-s7"])
def test_the_ledger_closes(name):
    """Motor work = friction + load + stored, to 1e-6 of the supply with the usual substeps."""
    run, case = runs()[name], rows()[name]
    drawn, plant = run.report["whole"]["energy"], screw_table()
    # all rows but s0m start at rest
    stored = np.sum(plant.stored(case.scenario.plant, run.final.state))
    left = drawn.energy_mechanical - drawn.energy_dissipated - drawn.energy_load - stored
    assert abs(left) < 1e-6 * drawn.energy_net
    assert drawn.energy >= drawn.energy_net


# --- divergence ------------------------------------------------------------------------------


def test_a_gain_beyond_the_limit_diverges():
    run = runs()["diverging"]
    assert 0 < run.final.left_path_at < 4000 and run.final.non_finite_at == -1
    assert all(np.isnan(leaf).all() for leaf in jax.tree.leaves(run.report))
    warned = notes(with_gain(rows()["smc-s1"], 400.0), {})
    assert any("458 1/s: beyond 2/dt = 400 1/s" in note for note in warned)
    assert not any("beyond" in note for note in notes(rows()["asmc-s1"], {}))


@pytest.mark.parametrize("name", ["smc-s1", "smc-s4"])
def test_psi_as_printed_diverges(name):
    """x_r1' is exactly 0 at the start."""
    case = js.with_metric(rows()[name], following)
    controller = per_axis(nonlinear_surface(damping.raw, reaching.adaptive))
    loop = replace(case.loop, controller=controller)
    gains = replace(case.gains, damping=FinalDamping(final=jnp.full(2, 10.0)))
    run = js.simulate(loop, gains, case.scenario, case.path, 5)
    assert run.final.non_finite_at == 0
    assert all(np.isnan(leaf).all() for leaf in jax.tree.leaves(run.report))


# --- gradients and batches -------------------------------------------------------------------

GAINS = (
    "slope", "damping_slope", "switching_gain", "damping.final", "reaching.start",
    "reaching.rate", "reaching.dead_zone",
)  # fmt: skip


def scaled(gains, factors):
    """The gains named in `GAINS` times one factor each."""
    for name, factor in zip(GAINS, factors, strict=True):
        holder, _, field = name.rpartition(".")
        owner = getattr(gains, holder) if holder else gains
        changed = replace(owner, **{field: getattr(owner, field) * factor})
        gains = replace(gains, **{holder: changed}) if holder else changed
    return gains


def smooth_case():
    """ASMC in S2 without jumps: (14) jumps at its floor and at |s| = eps, where the gradient of
    `adaptive_floored` by eps is 0 too. Five substeps, which is cheaper and no less exact here."""
    smoothed = law("asmc")._replace(form=reaching.adaptive_smooth)
    timing = replace(TIMING, substeps=5)
    return js.with_metric(build(smoothed, scene("s2"), timing), together(contour, energy))


SMOOTH_TICKS = 400
#: as many sets of factors as differences of fourth order take
SETS = 4 * len(GAINS)


@functools.cache
def smooth_figures():
    """Contour RMS in um and energy in mWh over 2 s from rest as a function of factors of `GAINS`;
    and compiled, for `SETS` of them, with their slopes in forward mode."""
    case = smooth_case()

    def figures(factors):
        gains = scaled(case.gains, factors)
        report = js.simulate(case.loop, gains, case.scenario, case.path, SMOOTH_TICKS).report
        return jnp.stack([report["contour"].contour_rms * 1e6, report["energy"].energy / 3.6])

    return figures, jax.jit(jax.vmap(lambda x: (figures(x), jax.jacfwd(figures)(x))))


def test_gradient_of_accuracy_and_energy():
    """By seven gains: both modes, and differences of fourth order."""
    figures, many = smooth_figures()
    one, step = jnp.ones(len(GAINS)), 2e-3
    around = [one[None] + k * step * jnp.eye(len(GAINS)) for k in (1, -1, 2, -2)]
    up, down, up2, down2 = many(jnp.concatenate(around))[0].reshape(4, -1, 2)
    differences = (8 * (up - down) - (up2 - down2)) / (12 * step)
    slopes = many(jnp.ones((SETS, len(GAINS))))[1][0]
    np.testing.assert_allclose(jax.jit(jax.jacrev(figures))(one), slopes, rtol=1e-9)
    np.testing.assert_allclose(slopes, differences.T, rtol=1e-6)
    assert (slopes != 0).all()


def test_a_thousand_gain_sets():
    """A batch in tiles gives what another program gives for some of its runs."""
    case, (_, many) = smooth_case(), smooth_figures()
    draw = jnp.asarray(np.random.default_rng(0).uniform(0.7, 1.3, (1000, len(GAINS))))
    gains = jax.vmap(lambda factors: scaled(case.gains, factors))(draw)
    run = js.rollouts(case.loop, gains, case.scenario, case.path, SMOOTH_TICKS, tile=50)
    found = run.report["contour"].contour_rms
    assert found.shape == (1000,) and np.isfinite(found).all() and np.ptp(found) > 1e-7
    some = np.linspace(0, 999, SETS).astype(int)
    np.testing.assert_allclose(found[some] * 1e6, many(draw[some])[0][:, 0], rtol=1e-9)


# --- loops, notes, sensors, claims -----------------------------------------------------------


def test_every_loop_builds_and_is_accepted():
    assert len({entry.name for entry in loops}) == len(loops)
    for entry in loops:
        case = entry.build(entry.timing)
        check(case.loop, case.gains, case.scenario, case.path)
        assert case.name == entry.name and case.window[:3] == (4000, 200, 4000)


def test_a_run_tells_every_figure_of_the_table():
    timing = replace(TIMING, duration=0.5, skip=0.1)
    case = js.build("asmc-s3", timing)
    table = js.columns(case.simulate().report, case.loop.plant)
    wanted = (
        "following_max_um following_mean_um following_max_between_um contour_max_um "
        "contour_mean_um command_variance_V2 command_high_variance_V2 command_variation_V_per_s "
        "energy_J energy_net_J energy_copper_J reaching_gain_mean_1_per_s"
    ).split()
    for key in wanted:
        found = table[key].values() if isinstance(table[key], dict) else [table[key]]
        assert None not in found, key


def test_drive_settings_work():
    """Dead time, lag and limit act, by themselves, on a loop as `jaxstage run` builds it."""
    case = js.with_metric(build(law("asmc"), scene("s1"), TIMING), recorded_command)
    base = case.scenario.drive
    tried = (
        base, replace(base, delay=jnp.ones(())), replace(base, lag=jnp.asarray(2e-3)),
        replace(base, limit=jnp.full(2, 0.2)),
    )  # fmt: skip
    drives = jax.tree.map(lambda *leaves: jnp.stack(leaves), *tried)

    def commands(drive):
        scenario = replace(case.scenario, drive=drive)
        return js.simulate(case.loop, case.gains, scenario, case.path, 100).rows

    plain, *others = jax.jit(jax.vmap(commands))(drives)
    assert np.abs(plain).max() > 0.2
    assert all(np.ptp(other - plain) > 1e-3 for other in others)
    assert np.abs(others[-1]).max() == 0.2


@pytest.mark.fast
def test_a_feed_is_constant_feed():
    """26.7 mm in 13.4 s: the feed sets the time, in every scenario."""
    case = build(law("smc"), scene("s1"), replace(TIMING, feed=300.0))
    step = jax.jit(case.loop.reference.sample)
    for tick in (0, 400, 1501):
        speed = np.linalg.norm(step(case.path, jnp.asarray(tick)).velocity)
        np.testing.assert_allclose(speed, 300 / 6e4, rtol=1e-12)
    assert case.window.lap == round(13.364893 * 5e-3 / (300 / 6e4) / values.DT)


@pytest.mark.fast
@pytest.mark.parametrize(
    ("changes", "message"),
    [({"skip": 20.0}, "skip = 20 s: must be < the run"), ({"dt": 0.0}, "dt = 0.0: must be > 0"),
     ({"lap_time": -1.0}, "lap_time = -1.0: must be > 0"), ({"substeps": 0}, "substeps = 0")],
)  # fmt: skip
def test_impossible_timing_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        js.build("smc-s1", replace(TIMING, **changes))


@pytest.mark.fast
def test_notes():
    assert "no switching" in notes(rows()["smc-s1"], {})[0]
    assert notes(rows()["smc-s2"], {}) == ()


def test_noise_has_its_size_and_its_seed():
    sensor, params = noisy(ideal_sensor), Noisy(noise=jnp.asarray(2e-6), sensor=())
    x, v = jnp.array([1e-3, -2e-3]), jnp.array([0.1, 0.2])
    output = Output(position=x, velocity=v, drive_position=x, drive_velocity=v)

    def read(key):
        return sensor.read(params, (), key, output, values.DT)[0]

    seen = jax.jit(jax.vmap(read))(jax.random.split(jax.random.key(1), 4000))
    off = np.concatenate([seen.position - x[None], seen.drive_position - x[None]], axis=1)
    np.testing.assert_allclose(np.std(off, axis=0), 2e-6, rtol=0.05)
    np.testing.assert_allclose(np.corrcoef(off.T), np.eye(4), atol=0.06)
    assert (seen.velocity == v[None]).all()
    again = read(jax.random.split(jax.random.key(1), 4000)[7])
    np.testing.assert_array_equal(again.position, seen.position[7])
    assert noisy(encoder) is noisy(encoder)


@pytest.mark.fast
def test_energy_at_matched_accuracy():
    """By hand: error 100 / slope and energy 70 + slope / 10; ASMC at 2 um is matched by 50 1/s."""

    def run(error, drawn):
        return {"following_mean_um": {"x": error / 2, "y": error / 2}}, {"energy_J": drawn}

    evidence = {}
    for slope in SLOPES["s1"]:
        late, whole = run(100 / slope, 70 + slope / 10)
        evidence |= {f"smc-s1/slope-{slope:g}/late": late, f"smc-s1/slope-{slope:g}/whole": whole}
    evidence["asmc-s1/late"], _ = run(2.0, 0.0)
    slope, drawn = matched(evidence, "s1")
    assert slope == pytest.approx(50.0) and drawn == pytest.approx(75.0)
    evidence["asmc-s1/late"], _ = run(0.5, 0.0)
    assert matched(evidence, "s1") is None, "beyond the slopes tried"
