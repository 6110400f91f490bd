"""Cross-coupled control of the linear-motor stage as it runs: sampled, the command held."""

import functools

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.controllers import Both, Coupled, fuzzy_pid_contour, pid_contour
from jaxstage.controllers.disturbance_observer import longest_period
from jaxstage.metrics import contour, following, together
from jaxstage.model.fields import replace
from jaxstage.model.validate import check
from jaxstage.numerics.smooth import exact, smooth
from jaxstage.simulate.batch import rollouts
from jaxstage.simulate.rollout import simulate
from jaxstage.studies.fuzzy_ccc import values
from jaxstage.studies.fuzzy_ccc.loops import TIMING, build, coupling, observing
from jaxstage.studies.law import StudyLaw
from tests.helpers.batteries import tracing
from tests.helpers.coupling import constant, learning, none, path, pid, scene, stacked, stage

pytestmark = pytest.mark.long


def loop(dt, switch=smooth, contour_law=None, metric=None, **changes):
    """The loop of the study; without a contour law: that of the adaptive coupling."""
    law = StudyLaw(
        "bench", "", coupling(contour_law or fuzzy_pid_contour(), switch),
        lambda axis: stage(learning()),
    )  # fmt: skip
    made = build(law, "bench", replace(TIMING, dt=dt)).loop
    return replace(made, metric=metric or together(following, contour), **changes)


def many(base, gains, ticks, begun=None, pick=lambda run: run.report):
    """``pick`` of the runs of several gains, in one batch."""
    one = lambda g: pick(simulate(base, g, begun or scene(), path(), ticks))  # noqa: E731
    return jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(stacked(gains)))


# --- against continuous time ------------------------------------------------------------------

PERIODS = (5e-4, 2.5e-4, 1.25e-4)
#: MEAN, RMS in um of the following error of x, y, z and of the true contour error; MAX of e_y
CONTINUOUS = {
    "none": [13.6001, 16.4908, 7.9027, 8.7442, 5.2998, 6.5897, 12.7616, 15.9433, 12.3309],
    "pid": [10.0301, 12.4393, 5.0236, 6.6085, 2.3182, 3.7343, 5.5307, 8.5712, 15.1861],
    "frozen": [9.8971, 12.2694, 5.0743, 6.6167, 2.3055, 3.6844, 5.4108, 8.3068, 15.0317],
    "adaptive": [9.2564, 11.6852, 5.1145, 6.6367, 2.1060, 3.4705, 4.4941, 7.3523, 14.6093],
    "mean gains": [9.1542, 11.5190, 5.1424, 6.6202, 2.1954, 3.4418, 4.4282, 7.0783, 14.4485],
}


@pytest.fixture(scope="module")
def by_period():
    """Figures in um of every loop for each control period, (periods, loops, figures)."""
    gains = [
        stage(coupling)
        for coupling in (
            none(), pid(), values.fuzzy_gains(adapting=False), learning(),
            constant(1912.626, 4203.653, 7.005114),
        )
    ]  # fmt: skip
    table = []
    for dt in PERIODS:
        report = many(loop(dt), gains, round(10 / dt))
        axes, path_ = report["following"], report["contour"]
        np.testing.assert_allclose(axes.following_max[:, [0, 2]], [[1e-4, 5e-5]] * 5)
        np.testing.assert_allclose(path_.contour_max, 111.5263e-6, rtol=1e-5)
        both = np.stack([axes.following_mean, axes.following_rms], axis=-1).reshape(5, 6)
        rest = path_.contour_mean, path_.contour_rms, axes.following_max[:, 1]
        table.append(np.column_stack([both, *rest]) * 1e6)
    return np.stack(table)


def extrapolated(table):
    """To a period of 0 by a parabola through halved periods: the first two orders vanish."""
    first = 2 * table[1:] - table[:-1]
    return (4 * first[1] - first[0]) / 3


def test_sampled_figures_converge_to_those_of_continuous_time(by_period):
    expected = np.array(list(CONTINUOUS.values()))
    found = extrapolated(by_period)
    np.testing.assert_allclose(found[:, :-1], expected[:, :-1], rtol=3e-5)
    np.testing.assert_allclose(found[:, -1], expected[:, -1], rtol=5e-4)  # a peak, between ticks


def test_the_first_order_is_all_that_one_halving_removes(by_period):
    """What is left of RMS e_x then falls by four with each halving: the second order."""
    left = 2 * by_period[1:, :, 1] - by_period[:-1, :, 1] - [row[1] for row in CONTINUOUS.values()]
    assert (np.abs(left[0]) > 2e-3).all(), "nothing to see"
    np.testing.assert_allclose(left[0] / left[1], 4, atol=0.4)


# --- switching ---------------------------------------------------------------------------------


def _switched(sample):
    error = sample.setpoint.position - sample.output.position
    return error, sample.command, sample.nearest.distance


def chattering(base, cases):
    """After 1 s, (cases, axes): variation (A/s), RMS change (A), RMS error (um); contour error."""
    dt = base.dt
    rows = many(base, list(cases.values()), round(10 / dt) + 1, pick=lambda run: run.rows)
    error, command, distance = rows
    begin = round(1 / dt)
    change = np.diff(command[:, begin:], axis=1)
    figures = np.stack([
        np.abs(change).sum(axis=1) / 9.0,
        np.sqrt((change**2).mean(axis=1)),
        np.sqrt((error[:, begin:] ** 2).mean(axis=1)) * 1e6,
    ], axis=1)  # fmt: skip
    return dict(zip(cases, zip(figures, distance * 1e6, strict=True), strict=True))


CASES = {
    "eta 2.5, blind": stage(none(), eta=2.5, observer=False, switch=()),
    "eta 0.25": stage(none(), eta=0.25, switch=()),
    "eta 0.25, blind": stage(none(), eta=0.25, observer=False, switch=()),
    "eta 0.25, pid": stage(pid(), eta=0.25, switch=()),
    "eta 0.25, adaptive": stage(learning(), eta=0.25, switch=()),
}
CHATTERING = {
    (1e-3, "eta 2.5, blind"): [
        (695.50, 430.79, 300.77), (0.9149, 0.5881, 0.4344), (112.66, 107.69, 96.84),
    ],
    (1e-3, "eta 0.25"): [
        (114.19, 77.27, 61.07), (0.11732, 0.07884, 0.06198), (1.652, 1.303, 1.853),
    ],
    (1e-3, "eta 0.25, blind"): [
        (0.832, 0.417, 0.231), (0.003892, 0.001933, 0.001339), (37606, 64450, 76808),
    ],
    (2e-4, "eta 2.5, blind"): [
        (3457.9, 2140.6, 1492.4), (0.9113, 0.5854, 0.4321), (22.56, 21.35, 19.23),
    ],
    (2e-4, "eta 0.25"): [
        (568.51, 384.66, 303.64), (0.11686, 0.07849, 0.06165), (0.2923, 0.1954, 0.2132),
    ],
}  # fmt: skip


@functools.cache
def switched(dt):
    base = loop(dt, exact, metric=tracing(_switched), path_limit=np.inf)
    if dt == 1e-3:
        return chattering(base, CASES)
    bare = {name: CASES[name].law for name in ("eta 2.5, blind", "eta 0.25")}
    return chattering(replace(base, controller=observing(exact)), bare)


@pytest.mark.parametrize(("dt", "name"), CHATTERING)
def test_chattering(dt, name):
    """The sign's sequences depend on rounding, their figures hardly: 2 %."""
    np.testing.assert_allclose(switched(dt)[name][0], CHATTERING[dt, name], rtol=0.02)


def test_ideal_sliding_absorbs_the_coupling():
    """With the sign the equivalent control takes up what a coupling adds: it helps nothing."""
    found = [
        (np.sqrt((distance**2).mean()), distance.mean())
        for name in ("eta 0.25", "eta 0.25, pid", "eta 0.25, adaptive")
        for distance in [switched(1e-3)[name][1]]
    ]
    expected = [(8.2017, 2.897), (8.1832, 4.024), (8.3402, 4.526)]
    np.testing.assert_allclose(found, expected, rtol=0.02)


# --- laws that must agree -----------------------------------------------------------------------


def own_loop():
    """The PID coupling itself, however far it strays."""
    return loop(PERIODS[0], contour_law=pid_contour(), path_limit=np.inf)


def test_equal_rules_are_a_pid_coupling_and_bounds_of_zero_are_none(by_period):
    """Controllers of their own give the figures of 10 s of the fuzzy one, to rounding."""
    gains, base = stage(values.pid_gains()), loop(PERIODS[0])
    own = simulate(own_loop(), gains, scene(), path(), 20_000)
    without = replace(base, controller=observing(smooth))
    bare = simulate(without, gains.law, scene(), path(), 20_000)
    for lane, report in ((1, own.report), (0, bare.report)):
        found = [*report["following"].following_rms, report["contour"].contour_rms]
        expected = by_period[0, lane, [1, 3, 5, 7]]
        np.testing.assert_allclose(np.array(found) * 1e6, expected, rtol=1e-9)


def test_from_far_beside_the_path_it_comes_back():
    """0.3 m off the drive is at its limit for long; the integral does not wind up."""
    far = scene(offset=[-0.3, 0.0, -0.15])
    run = simulate(own_loop(), stage(values.pid_gains()), far, path(), 20_000)
    assert np.linalg.norm(run.final.memory.extra.error.deviation) < 2e-5


# --- gradients ---------------------------------------------------------------------------------


def test_gradient_of_every_consequent():
    """All 147, of the mean square of the true contour error over 0.2 s, against differences."""
    base, gains = loop(1e-3, metric=contour), jax.tree.map(jnp.asarray, stage(learning()))

    def score(rules):
        coupling = replace(gains.extra, rules=rules)
        run = simulate(base, replace(gains, extra=coupling), scene(), path(), 200)
        return run.report.contour_rms**2 * 1e12

    flat, back = jax.flatten_util.ravel_pytree(gains.extra.rules)
    steps = 1e-3 * jnp.diag(flat)
    both = jax.value_and_grad(lambda x: score(back(x)))
    around = flat[None] + jnp.concatenate(
        [jnp.zeros((1, 147)), steps, -steps]
    )  # one program for all
    values_, slopes = jax.jit(lambda x: jax.lax.map(both, x, batch_size=59))(around)
    reverse, up, down = slopes[0], values_[1:148], values_[148:]
    differences = (up - down) / (2 * jnp.diag(steps))
    assert flat.size == 147 and np.isfinite(reverse).all()
    relative = np.abs(reverse * flat)
    assert (relative > 1e-4 * relative.max()).sum() > 20, "few rules were met"
    # rules that are never met have a gradient of next to nothing, and differences of rounding
    np.testing.assert_allclose(
        reverse * flat, differences * flat, rtol=1e-5, atol=1e-8 * relative.max()
    )


# --- bad input ---------------------------------------------------------------------------------

NAN = float("nan")


def _with(gains, dotted, value):
    first, _, rest = dotted.partition(".")
    inner = getattr(gains, first)
    return replace(gains, **{first: _with(inner, rest, value) if rest else np.asarray(value)})


BAD_GAINS = [
    ("law.law.nominal.mass", (12.0, 0.0, 5.0)),
    ("law.law.nominal.force_constant", (50.0, -1.0, 40.0)),
    ("law.law.slope", (0.0, 12.0, 15.0)),
    ("law.law.switching_gain", (0.5, 0.5, -0.1)),
    ("law.law.switch.width", (5e-3, 0.0, 5e-3)),
    ("law.law.slope", (10.0, 12.0)),
    ("law.extra.disturbance_gain", (0.0, 1.0, 1.0)),
    ("law.extra.velocity_gain", (1e3, -1e3, 1e3)),
    ("command_per_acceleration", (0.2, 0.0, 0.1)),
    ("extra.adaptation.slope", 0.0),
    ("extra.scales.deviation", 0.0),
    ("extra.scales.rate", -1.0),
    ("extra.scales.integral", 0.0),
    ("extra.rounding", 0.0),
    ("extra.rest_speed", 0.0),
    ("extra.bounds.integral_most", -1.0),
    ("extra.rules.derivative", np.full((7, 7), NAN)),
    ("extra.adaptation.leak", np.inf),
]
BAD_SCENARIO = [
    ("plant.mass", (12.0, 8.0, 0.0)),
    ("plant.force_constant", (0.0, 50.0, 40.0)),
    ("plant.damping", (-1.0, 8.0, 12.0)),
    ("plant.mass", (12.0, 8.0)),
    ("load.amplitude", (NAN, 0.0, 0.0)),
    ("drive.limit", (10.0, 0.0, 10.0)),
    ("start.offset", (np.inf, 0.0, 0.0)),
]


@pytest.mark.fast
@pytest.mark.parametrize(("where", "value"), BAD_GAINS, ids=[w for w, _ in BAD_GAINS])
def test_bad_gains_are_refused(where, value):
    with pytest.raises(ValueError, match=where.replace(".", r"\.")):
        simulate(loop(1e-3), _with(stage(learning()), where, value), scene(), path(), 10)


@pytest.mark.fast
@pytest.mark.parametrize(("where", "value"), BAD_SCENARIO, ids=[w for w, _ in BAD_SCENARIO])
def test_bad_scenarios_are_refused(where, value):
    with pytest.raises(ValueError, match=where.replace(".", r"\.")):
        simulate(loop(1e-3), stage(learning()), _with(scene(), where, value), path(), 10)


@pytest.mark.fast
def test_a_period_that_the_observer_cannot_bear_is_refused():
    gains = stage(learning())
    with pytest.raises(ValueError, match=r"loop\.dt = 0\.005 s: must be <= 0\.004 s"):
        simulate(loop(5e-3), gains, scene(), path(), 10)
    check(loop(4e-3), gains, scene(), path())


@pytest.mark.fast
@pytest.mark.parametrize(("k1", "k2"), [(250e3, 1e3), (1e5, 1e3), (1e6, 1e3), (1e-30, 1e3)])
def test_longest_period_of_the_observer(k1, k2):
    """There the Euler step has its first eigenvalue of modulus 1; real poles and complex ones."""
    gains = replace(
        values.observer_gains(values.nominal()), disturbance_gain=jnp.asarray(k1),
        velocity_gain=jnp.asarray(k2),
    )  # fmt: skip
    dt = float(longest_period(gains))
    for share, stable in ((0.999, True), (1.001, False)):
        step = np.eye(2) + share * dt * np.array([[0, k1], [-1, -k2]])
        radius = np.abs(np.linalg.eigvals(step)).max()
        assert (radius <= 1) == stable


@pytest.mark.fast
def test_one_slow_observer_of_a_batch_is_refused():
    """A population whose second member needs a shorter period; the error says which period."""
    gains = stage(learning())
    fast = jnp.stack([jnp.full(3, 250e3), jnp.full(3, 4e6)])
    watcher = replace(gains.law.extra, disturbance_gain=fast)
    varied = replace(gains, law=replace(gains.law, extra=watcher))
    shared = jax.tree.map(lambda _: None, watcher)
    axes = Coupled(
        law=Both(law=None, extra=replace(shared, disturbance_gain=0)), extra=None,
        command_per_acceleration=None,
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"must be <= 0\.00025 s"):
        rollouts(loop(1e-3), varied, scene(), path(), 10, in_axes=(axes, None, None))
