"""Cross-coupled control of the linear-motor stage in continuous time.

The expected figures are those of two independent models of the same equations, at steps of 0.2 ms.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.controllers import scalar, sliding
from jaxstage.controllers.parts.contour_error import Rounding
from jaxstage.model.fields import replace
from jaxstage.numerics.smooth import smooth
from jaxstage.studies.fuzzy_ccc import values
from tests.helpers.continuous import Continuous, run
from tests.helpers.coupling import (
    STEPS,
    constant,
    indices,
    learning,
    none,
    path,
    pid,
    scene,
    stacked,
    stage,
)

DT = 1e-3


class Lane(NamedTuple):
    """One run: gains, scenario and path."""

    gains: object
    scene: object
    path: object


def lane(coupling, begun=None, along=None, **changes):
    return Lane(stage(coupling, **changes), begun or scene(), along or path())


REST = scene(offset=np.zeros(3), velocity=0.0)
FAR = scene(offset=[-1.0, 0.0, -0.5])
OTHER_MASS = (1.2, 0.9, 1.1)
LANES = {
    "none": lane(none()),
    "pid": lane(pid()),
    "frozen": lane(values.fuzzy_gains(adapting=False)),
    "adaptive": lane(learning()),
    "pid, mean gains": lane(constant(1912.626, 4203.653, 7.005114)),
    "rates x 0.25": lane(learning(0.25)),
    "rates x 0.5": lane(learning(0.5)),
    "rates x 2": lane(learning(2.0)),
    "rates x 4": lane(learning(4.0)),
    "rates x 8": lane(learning(8.0)),
    "leak": lane(learning(leak=0.2)),
    "no integral": lane(constant(1000.0, 0.0, 10.0)),
    "K_P 1500": lane(constant(1500.0, 5000.0, 10.0)),
    "K_P 2000": lane(constant(2000.0, 5000.0, 10.0)),
    "K_P 4000": lane(constant(4000.0, 5000.0, 10.0)),
    "mass, pid": lane(pid(), mass=OTHER_MASS),
    "mass, adaptive": lane(learning(), mass=OTHER_MASS),
    "rest, none": lane(none(), REST),
    "rest, pid": lane(pid(), REST),
    "rest, adaptive": lane(learning(), REST),
    "blind, eta 2.5": lane(none(), eta=2.5, observer=False),
    "blind, eta 0.5": lane(none(), eta=0.5, observer=False),
    "point": lane(learning(), along=path(radius=0.0, climb_rate=0.0)),
    "circle": lane(learning(), along=path(climb_rate=0.0)),
    "line": lane(learning(), along=path(turn_rate=0.0)),
    "quiet": lane(learning(), scene(offset=np.zeros(3), load=0.0)),
    "far, none": lane(none(), FAR),
    "far, pid": lane(pid(), FAR),
    "far, adaptive": lane(learning(), FAR),
}


class Result(NamedTuple):
    """A run of 10 s, (steps + 1, ...) each, um and 1/s2, 1/s3, 1/s; demand, memory: the end."""

    error: np.ndarray
    distance: np.ndarray
    estimate: np.ndarray
    gains: np.ndarray
    demand: np.ndarray
    memory: object


def _pick(row):
    shown = row.memory.extra
    gains = jnp.stack([shown.proportional_gain, shown.integral_gain, shown.derivative_gain])
    um = (1e6 * x for x in (row.error, row.distance, row.estimate))
    return *um, gains, (row.demand, row.memory)


def simulated(bench, lanes):
    """name -> `Result` of all lanes, in one batch."""

    @jax.jit
    @jax.vmap
    def many(gains, begun, along):
        begun = replace(begun, key=jax.random.key(0))
        *rows, last = run(bench, gains, begun, along, STEPS, _pick)
        return *rows, *jax.tree.map(lambda x: x[-1], last)

    gains, scenes, paths = zip(*lanes.values(), strict=True)
    scenes = [replace(one, key=()) for one in scenes]
    out = jax.tree.map(np.asarray, many(stacked(gains), stacked(scenes), stacked(paths)))
    return {name: Result(*jax.tree.map(lambda x, i=i: x[i], out)) for i, name in enumerate(lanes)}


@pytest.fixture(scope="module")
def smoothly():
    """Every lane with the tanh switch."""
    return simulated(Continuous(sliding(smooth)), LANES)


# --- the published loops ---------------------------------------------------------------------

#: MAX, MEAN, RMS in um: following error of x, y, z, contour error estimated and true
FIGURES = {
    "none": [
        (100, 13.6001, 16.4908), (12.3309, 7.9027, 8.7442), (50, 5.2998, 6.5897),
        (111.5269, 12.7616, 15.9433), (111.5263, 12.7616, 15.9433),
    ],
    "pid": [
        (100, 10.0301, 12.4393), (15.1861, 5.0236, 6.6085), (50, 2.3182, 3.7343),
        (111.5269, 5.5306, 8.5711), (111.5263, 5.5307, 8.5712),
    ],
    "frozen": [
        (100, 9.8971, 12.2694), (15.0317, 5.0743, 6.6167), (50, 2.3055, 3.6844),
        (111.5269, 5.4107, 8.3068), (111.5263, 5.4108, 8.3068),
    ],
    "adaptive": [
        (100, 9.2564, 11.6852), (14.6093, 5.1145, 6.6367), (50, 2.1060, 3.4705),
        (111.5269, 4.4940, 7.3522), (111.5263, 4.4941, 7.3523),
    ],
    "pid, mean gains": [
        (100, 9.1542, 11.5190), (14.4485, 5.1424, 6.6202), (50, 2.1954, 3.4418),
        (111.5269, 4.4281, 7.0783), (111.5263, 4.4282, 7.0783),
    ],
}  # fmt: skip


@pytest.mark.parametrize("name", FIGURES)
def test_figures_of_the_published_loops(smoothly, name):
    one = smoothly[name]
    signals = np.concatenate([one.error, one.estimate[:, None], one.distance[:, None]], axis=1)
    np.testing.assert_allclose(indices(signals), FIGURES[name], rtol=2e-5)


#: t: following error, true contour error in um; K_P, K_I, K_D
COURSE = {
    0.01: [91.86522, 0.676380, 45.23917, 102.18665, 1389.567, 4885.765, 3.901222],
    0.1: [11.35781, 8.694142, 4.972119, 12.92202, 1125.103, 4497.894, 5.944407],
    1.0: [-18.37627, -0.098479, -0.489796, 6.614996, 1289.348, 4096.592, 6.625179],
    5.0: [-6.995968, -11.150818, -2.134521, 7.006241, 1913.385, 4035.985, 6.607651],
    10.0: [6.670441, 7.225275, -1.346824, 7.111144, 2497.488, 3842.000, 6.635538],
}


def test_course_of_the_adaptive_loop(smoothly):
    one = smoothly["adaptive"]
    for time, expected in COURSE.items():
        k = round(time / DT)
        found = [*one.error[k], one.distance[k], *one.gains[k]]
        # 0.1 nm where an error passes through zero; the step is five times that of the figures
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(one.demand, [-0.018945, 0.283959, 0.165574], atol=1e-6)
    estimate = one.memory.law.extra.estimate.disturbance
    np.testing.assert_allclose(estimate, [-0.020942, 1.705569, 1.309657], atol=1e-6)
    learned = one.memory.extra.learned
    for rules, ends in (
        (learned.proportional, (200.0, 3060.752)),
        (learned.integral, (1000.0, 9000.0)),
        (learned.derivative, (0.66616, 18.0)),
    ):
        np.testing.assert_allclose([rules.min(), rules.max()], ends, rtol=1e-4)
    means = [(g.sum() - (g[0] + g[-1]) / 2) / STEPS for g in one.gains.T]
    np.testing.assert_allclose(means, (1912.626, 4203.653, 7.005114), rtol=1e-5)


# --- variants ----------------------------------------------------------------------------------

#: MEAN, RMS in um of the true contour error
VARIANTS = {
    "rates x 0.25": (5.0959, 7.9807),
    "rates x 0.5": (4.8537, 7.7262),
    "rates x 2": (4.0397, 6.8998),
    "rates x 4": (3.7379, 6.5293),
    "rates x 8": (3.5488, 6.2528),
    "leak": (4.7511, 7.5400),
    "no integral": (7.0864, 9.8251),
    "K_P 1500": (np.nan, 7.6030),
    "K_P 2000": (np.nan, 6.8920),
    "K_P 4000": (np.nan, 5.2615),
    "mass, pid": (5.0763, 8.2282),
    "mass, adaptive": (4.2135, 7.1574),
    "point": (np.nan, 8.1031),
    "circle": (np.nan, 7.3949),
    "line": (np.nan, 7.5950),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_variants(smoothly, name):
    _, mean, rms = indices(smoothly[name].distance)
    expected = VARIANTS[name]
    np.testing.assert_allclose(rms, expected[1], rtol=2e-5)
    assert np.isnan(expected[0]) or np.isclose(mean, expected[0], rtol=3e-5)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("rest, none", (345.574, 18.193, 42.412)),
        ("rest, pid", (219.336, 9.4957, 22.963)),
        ("rest, adaptive", (126.050, 5.8980, 11.950)),
        ("blind, eta 2.5", (631.22, 323.00, 354.33)),
        ("blind, eta 0.5", (1.29839e5, np.nan, 7.2474e4)),
        ("point", (111.8034, np.nan, 8.1031)),
        ("line", (100.0, np.nan, 7.5950)),
    ],
)
def test_starts_and_edges(smoothly, name, expected):
    found = indices(smoothly[name].distance)
    known = ~np.isnan(expected)
    np.testing.assert_allclose(found[known], np.array(expected)[known], rtol=3e-4)


def test_without_disturbance_and_offset_there_is_no_error(smoothly):
    """4e-9 um at steps of 0.2 ms, and fourth order: 625 times that at 1 ms."""
    assert smoothly["quiet"].distance.max() < 4e-9 * 5**4


def test_from_a_metre_beside_the_path(smoothly):
    """Without anti-windup (in the equations there is none) the PID coupling runs away.

    The distances are the local minima downhill, by a dense search along the helix.
    """
    end = {name: smoothly[f"far, {name}"].distance[-1] * 1e-6 for name in ("none", "pid")}
    np.testing.assert_allclose([end["pid"], end["none"]], [75.8515, 0.429678], rtol=3e-4)
    assert smoothly["far, adaptive"].distance[-1] * 1e-6 < 0.2


def test_proportional_rules_drift_by_the_square_of_the_error(smoothly):
    """sum of (theta_P(T) - theta_P(0)) = g_P [int |eps|^2 + Delta |eps|^2 / (2 lam)] / eps_sc^2."""
    one, gains = smoothly["adaptive"], learning()
    drift = np.sum(one.memory.extra.learned.proportional - gains.rules.proportional)
    square = (one.estimate * 1e-6) ** 2
    integral = (square.sum() - (square[0] + square[-1]) / 2) * DT
    a = gains.adaptation
    grown = integral + (square[-1] - square[0]) / (2 * a.slope)
    np.testing.assert_allclose(
        drift, a.proportional_rate * grown / gains.scales.deviation**2, rtol=5e-6
    )
    np.testing.assert_allclose(drift, 5345.4793, rtol=1e-5)
    windows = one.gains[:-1, 0].reshape(5, -1).mean(axis=1)
    np.testing.assert_allclose(windows, (1262, 1611, 1947, 2283, 2460), rtol=1e-3)


def test_estimate_is_the_contour_error(smoothly):
    one = smoothly["adaptive"]
    assert np.abs(one.estimate - one.distance).max() < 0.0043


def test_scalar_form():
    def rounded(coupling):
        return replace(coupling, form=Rounding(rounding=np.array(1e-6)))

    lanes = {"pid": lane(rounded(pid())), "adaptive": lane(rounded(learning()))}
    found = simulated(Continuous(sliding(smooth), form=scalar), lanes)
    for name, expected in (("pid", (1.0982, 6.6153)), ("adaptive", (1.0346, 5.9909))):
        np.testing.assert_allclose(indices(found[name].distance)[1:], expected, rtol=1e-4)
