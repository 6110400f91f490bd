"""The fuzzy part: sets, inference, rules as text; the contour error and its two forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxstage.controllers import (
    cross_coupled,
    disturbance_observer,
    fuzzy_pid_contour,
    per_axis,
    pid_contour,
    plus,
    scalar,
    sliding,
    vector,
)
from jaxstage.controllers.fuzzy_pid_contour import rule_strengths
from jaxstage.controllers.parts.contour_error import (
    ContourError,
    Rounding,
    contour_error,
    magnitude,
)
from jaxstage.controllers.parts.fuzzy import (
    consequents,
    degrees,
    infer,
    levels,
    limited,
    membership,
    rules_text,
    seven_sets,
    strengths,
)
from jaxstage.controllers.parts.pid_rules import DERIVATIVE, INTEGRAL, PROPORTIONAL
from jaxstage.model.fields import replace
from jaxstage.model.signals import Measurement, Setpoint
from jaxstage.numerics.smooth import smooth
from jaxstage.references import helical
from jaxstage.studies.fuzzy_ccc import values
from tests.helpers.coupling import path, scene, stage

SETS = jax.tree.map(jnp.asarray, seven_sets())
FUZZY = jax.tree.map(jnp.asarray, values.fuzzy_gains())
pytestmark = pytest.mark.fast


# --- sets and rules ----------------------------------------------------------------------------


def test_memberships():
    at_zero = degrees(SETS, jnp.asarray(0.0))
    expected = [0.0, 1.35630e-5, 0.05555405, 0.8888648, 0.05555405, 1.35630e-5, 0.0]
    np.testing.assert_allclose(at_zero, expected, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(
        degrees(SETS, jnp.asarray(-2.3))[:3], [0.2458614, 0.7453125, 0.008825645], rtol=1e-6
    )
    np.testing.assert_allclose(membership(SETS, jnp.asarray(0.5))[3:5], 0.5, rtol=1e-12)
    np.testing.assert_allclose(SETS.width, 0.6005612043932249, rtol=1e-15)


@jax.jit
def inferred(first, second):
    """Strengths of the rules, and the slopes of what they infer."""

    def gain(a, b):
        return infer(FUZZY.rules.proportional, strengths(SETS, SETS, a, b))

    xi = strengths(SETS, SETS, first, second)
    return xi, jnp.stack(jax.grad(gain, argnums=(0, 1))(first, second))


@settings(max_examples=40, deadline=None)
@given(st.floats(-1e9, 1e9), st.floats(-5, 5))
def test_strengths_are_shares_and_products(first, second):
    """They sum to 1 wherever the inputs are, also where every Gaussian has underflowed."""
    xi, slopes = inferred(jnp.asarray(first), jnp.asarray(second))
    np.testing.assert_allclose(xi.sum(), 1, rtol=1e-12)
    assert (xi >= 0).all() and np.isfinite(slopes).all()
    np.testing.assert_allclose(xi, np.outer(xi.sum(axis=1), xi.sum(axis=0)), atol=1e-15)
    np.testing.assert_allclose(infer(np.full((7, 7), 3.7), xi), 3.7, rtol=1e-12)


@pytest.mark.parametrize(
    ("inputs", "expected"),
    [
        ((0.0, 0.0), (1000.8198, 5000.0000, 7.341602)),
        ((-1.5, 0.5), (1199.7396, 4002.5941, 5.330750)),
        ((-2.9, -2.9), (1799.9778, 1000.0611, 12.142733)),
        ((-2.9, 2.9), (976.39982, 5000.0000, 11.670740)),
    ],
)
def test_gains_of_the_rules_at_the_start(inputs, expected):
    xi = strengths(SETS, SETS, *map(jnp.asarray, inputs))
    rules = FUZZY.rules
    found = [infer(table, xi) for table in (rules.proportional, rules.integral, rules.derivative)]
    np.testing.assert_allclose(found, expected, rtol=2e-7)


def test_a_limited_input_reaches_the_outermost_set_only():
    np.testing.assert_allclose(limited(jnp.asarray([0.0, 1e3, -1e3])), [0, 3, -3])


def test_rules_in_words_and_numbers():
    table = levels("NB ZO\nPS PB")
    np.testing.assert_array_equal(table, [[-3, 0], [1, 3]])
    np.testing.assert_allclose(consequents(10.0, 3.0, "NB ZO\nPS PB"), [[7, 10], [11, 13]])
    for words in (PROPORTIONAL, INTEGRAL, DERIVATIVE):
        assert levels(words).shape == (7, 7)
    with pytest.raises(ValueError, match="unknown set XX: use one of NB, NM"):
        levels("NB XX")
    with pytest.raises(ValueError, match="same length"):
        levels("NB NB\nNB")


def test_rules_are_readable():
    text = rules_text(FUZZY.rules.proportional, "K_P in 1/s2")
    lines = text.splitlines()
    assert lines[0] == "K_P in 1/s2: rows X1, columns X2"
    assert lines[1].split("|")[1].split() == ["NB", "NM", "NS", "ZO", "PS", "PM", "PB"]
    rows = {line.split("|")[0].strip(): line.split("|")[1].split() for line in lines[2:]}
    assert rows["NB"] == ["1800", "1800", "1533", "1533", "1267", "1000", "1000"]
    assert rows["PB"][-1] == "200"
    assert len({len(line) for line in lines[1:]}) == 1, "columns line up"
    numbered = rules_text(np.arange(6.0).reshape(2, 3), "K").splitlines()
    assert [line.split() for line in numbered[2:]] == [
        ["1", "|", "0", "1", "2"], ["2", "|", "3", "4", "5"],
    ]  # fmt: skip


# --- the contour error ---------------------------------------------------------------------------


def pair(error, rate, velocity, acceleration, tangent):
    """Setpoint and measurement with the given following error and rate."""
    place = jnp.asarray([0.3, -0.1, 0.2])
    error, rate, velocity = (jnp.asarray(x, float) for x in (error, rate, velocity))
    setpoint = Setpoint(
        position=place, velocity=velocity, acceleration=jnp.asarray(acceleration, float),
        tangent=jnp.asarray(tangent, float), curvature=jnp.zeros(()),
    )  # fmt: skip
    x, v = place - error, velocity - rate
    return setpoint, Measurement(position=x, velocity=v, drive_position=x, drive_velocity=v)


def test_deviation_and_its_direction():
    velocity = np.array([1.0, 2.0, 2.0])
    found = contour_error(
        *pair([1e-4, 2e-4, -3e-4], np.zeros(3), velocity, np.zeros(3), velocity / 3), 1e-6
    )
    np.testing.assert_allclose(found.deviation, np.array([1, 2, -2.5]) / 9e3, rtol=1e-11)
    size, _, direction = magnitude(found, 1e-12)
    np.testing.assert_allclose(size, 3.726780e-4, rtol=1e-6)
    np.testing.assert_allclose(direction, [0.2981424, 0.5962848, -0.7453560], rtol=1e-6)


def at_start():
    """The contour error of the study at t = 0."""
    begun, along = scene(), jax.tree.map(jnp.asarray, path())
    setpoint = helical(1e-3).sample(along, jnp.asarray(0))
    x = setpoint.position + begun.start.offset
    seen = Measurement(
        position=x, velocity=setpoint.velocity, drive_position=x, drive_velocity=setpoint.velocity
    )
    return setpoint, seen


def test_start_of_the_study():
    found = contour_error(*at_start(), 1e-6)
    np.testing.assert_allclose(
        found.deviation, [100e-6, -7.761155e-6, 48.76477e-6], rtol=1e-6, atol=1e-13
    )
    np.testing.assert_allclose(magnitude(found, 1e-12)[0], 111.52685e-6, rtol=1e-7)
    direction = magnitude(found, 1e-12)[2]
    np.testing.assert_allclose(direction, [0.8966451, -0.06959001, 0.4372469], rtol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_rates_are_the_derivatives(seed):
    """D is normal to the path and the derivative of eps without its tangential part; E' that of E.

    Along arbitrary smooth motions of reference and tool, by differentiation in time.
    """
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 4, 3))

    def curve(c, t):
        return c[0] * jnp.sin(1.3 * t) + c[1] * jnp.cos(0.7 * t) + c[2] * t + c[3] * t**2

    def derivative(f):
        return lambda t: jax.jvp(f, (t,), (1.0,))[1]

    def seen(t):
        reference, tool = (lambda x, c=c: curve(c, x) for c in (a, b))
        v = derivative(reference)(t)
        return contour_error(
            Setpoint(
                position=reference(t), velocity=v, tangent=v / jnp.linalg.norm(v),
                acceleration=derivative(derivative(reference))(t), curvature=0.0,
            ),
            Measurement(
                position=tool(t), velocity=derivative(tool)(t),
                drive_position=tool(t), drive_velocity=derivative(tool)(t),
            ), 1e-9,
        )  # fmt: skip

    t = 0.4
    now, change = jax.jvp(seen, (t,), (1.0,))
    scale = np.abs(now.rate).max() + 1
    assert abs(now.rate @ now.tangent) < 1e-12 * scale
    across = change.deviation - (change.deviation @ now.tangent) * now.tangent
    np.testing.assert_allclose(now.rate, across, atol=1e-9 * scale)
    np.testing.assert_allclose(now.turning, change.tangent, atol=1e-9 * scale)
    size = lambda x: magnitude(seen(x), 1e-3)[0]  # noqa: E731
    np.testing.assert_allclose(magnitude(now, 1e-3)[1], derivative(size)(t), atol=1e-9 * scale)


# --- the laws at one instant ---------------------------------------------------------------------


def test_first_command_of_the_study():
    watched = plus(per_axis(sliding(smooth)), per_axis(disturbance_observer))
    expected = {
        "none": (0.004735398, 0.01005310, 0.01230531),
        "pid": (0.02875881, 0.008811312, 0.01840091),
        "adaptive": (0.04072697, 0.008191123, 0.02144525),
    }
    pairs = {"pid": (pid_contour(), values.pid_gains()), "adaptive": (fuzzy_pid_contour(), FUZZY)}
    setpoint, seen = at_start()

    def first(law, gains):
        gains = jax.tree.map(jnp.asarray, gains)
        return law.control(gains, law.init(gains, setpoint, seen), setpoint, seen, 1e-3)

    bare, _ = first(watched, stage(FUZZY).law)
    np.testing.assert_allclose(bare, expected["none"], rtol=5e-7)
    for name, (contour_law, gains) in pairs.items():
        demand, memory = first(cross_coupled(watched, contour_law), stage(gains))
        np.testing.assert_allclose(demand, expected[name], rtol=5e-7)
    shown = memory.extra
    found = shown.proportional_gain, shown.integral_gain, shown.derivative_gain
    np.testing.assert_allclose(found, (1499.433, 2502.837, 2.213090), rtol=1e-6)


LAWS = {
    "pid": (pid_contour(), values.pid_gains()),
    "pid, scalar": (
        pid_contour(scalar), replace(values.pid_gains(), form=Rounding(rounding=np.array(1e-6)))
    ),
    "fuzzy": (fuzzy_pid_contour(), FUZZY),
    "fuzzy, scalar": (
        fuzzy_pid_contour(scalar), replace(FUZZY, form=Rounding(rounding=jnp.asarray(1e-6)))
    ),
}  # fmt: skip
each_law = pytest.mark.parametrize("name", LAWS)


def ticks(name, setpoint, seen, count=3):
    law, gains = LAWS[name]
    gains = jax.tree.map(jnp.asarray, gains)
    memory, demands = law.init(gains, setpoint, seen), []
    for _ in range(count):
        demand, memory = law.control(gains, memory, setpoint, seen, 1e-3)
        memory = law.settle(gains, memory, demand, demand, 1e-3)
        demands.append(demand)
    return jnp.stack(demands), memory


@each_law
def test_the_coupling_has_no_share_along_the_path(name):
    tangent = np.array([2.0, -1.0, 2.0]) / 3
    setpoint, seen = pair(
        [1e-4, 5e-5, -2e-4], [1e-3, -2e-3, 0.0], 0.1 * tangent, [0.3, 0.1, -0.2], tangent
    )
    demands, _ = ticks(name, setpoint, seen)
    assert np.abs(demands).max() > 1e-2
    assert np.abs(demands @ tangent).max() < 1e-15


@each_law
def test_the_integral_ends_at_the_limit_of_the_drive(name):
    """Back-calculation has one fixed point: the integral alone gives the limit."""
    law, gains = LAWS[name]
    gains = jax.tree.map(jnp.asarray, gains)
    if name.startswith("fuzzy"):  # gains that stay
        still = jax.tree.map(jnp.zeros_like, gains.adaptation)
        gains = replace(gains, adaptation=replace(still, slope=jnp.asarray(30.0)))
    tangent, limit = np.array([0.0, 0.0, 1.0]), jnp.array([0.3, 0.0, 0.0])
    setpoint, seen = pair([1e-3, 0, 0], np.zeros(3), 0.1 * tangent, np.zeros(3), tangent)

    def tick(memory, _):
        demand, memory = law.control(gains, memory, setpoint, seen, 1e-3)
        return law.settle(gains, memory, demand, jnp.clip(demand, -limit, limit), 1e-3), demand

    end, demands = jax.lax.scan(tick, law.init(gains, setpoint, seen), None, length=2000)
    assert (demands[:, 0] > limit[0]).all(), "never at its limit"
    if name.startswith("fuzzy"):
        reached = end.integral_gain * end.learned.error_integral
    else:
        reached = gains.integral_gain * end.integral
    # one period of the error on top
    np.testing.assert_allclose(jnp.ravel(reached)[0], limit[0], rtol=0.03)


@each_law
@pytest.mark.parametrize("case", ["no error", "at rest", "no tangent", "at rest, turning"])
def test_finite_with_its_gradient_where_directions_vanish(name, case):
    zero, tangent = np.zeros(3), np.array([0.0, 0.6, 0.8])
    still = case != "no error"
    setpoint, seen = pair(
        zero if case == "no error" else [1e-4, 0, 0], zero, zero if still else 0.1 * tangent,
        [0, 1.0, 0] if "turning" in case else zero, zero if case == "no tangent" else tangent,
    )  # fmt: skip
    demands, memory = ticks(name, setpoint, seen, count=2)
    slopes = jax.grad(lambda s, m: ticks(name, s, m, count=2)[0].sum(), argnums=(0, 1))(
        setpoint, seen
    )
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((demands, memory, slopes)))
    if case == "no tangent":  # a point: the whole error is contour error
        np.testing.assert_allclose(memory.error.deviation, [1e-4, 0, 0], atol=1e-16)


def test_the_integral_turns_with_the_path():
    """Round a circle with a constant deviation outwards it stays outwards; fixed axes lose it."""
    dt, turn, count = 1e-3, 1.0, 1571
    integral, plain = jnp.zeros(3), jnp.zeros(3)

    def step(kept, k):
        integral, plain = kept
        angle = turn * k * dt
        out = jnp.stack([jnp.cos(angle), jnp.sin(angle), 0.0])
        ahead = jnp.stack([-jnp.sin(angle), jnp.cos(angle), 0.0])
        error = ContourError(deviation=out, rate=0 * out, tangent=ahead, turning=-turn * out)
        integral = integral + dt * vector.rate((), error, integral)
        return (integral, plain + dt * out), None

    (integral, plain), _ = jax.lax.scan(step, (integral, plain), jnp.arange(float(count)))
    np.testing.assert_allclose(integral, [0, count * dt, 0], atol=2e-3 * count * dt)
    np.testing.assert_allclose(plain, [1, 1, 0], atol=2e-3)


def test_large_errors_meet_the_rows_negative_big():
    def xi(size):
        zero = jnp.zeros(3)
        error = ContourError(
            deviation=jnp.asarray([size, 0, 0]), rate=zero, tangent=jnp.eye(3)[2], turning=zero
        )
        return rule_strengths(FUZZY, error)

    assert xi(5e-4)[0].sum() > 0.9 and xi(0.0)[3].sum() > 0.85
    gains = [float(infer(FUZZY.rules.proportional, xi(size))) for size in (0, 2e-5, 5e-5, 2e-4)]
    assert gains == sorted(gains), "K_P rises with the error"
