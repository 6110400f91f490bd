"""The sliding law with a nonlinear surface: psi, its rate, the reaching gains, the law itself."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstage.controllers import RigidAxis, nonlinear_surface, per_axis
from jaxstage.controllers.parts import damping, error_rate, reaching
from jaxstage.controllers.parts.damping import BoundedDamping, FinalDamping
from jaxstage.controllers.parts.reaching import AdaptiveGain, FixedGain, IntegralGain
from jaxstage.model.fields import replace
from jaxstage.model.validate import check_leaves
from jaxstage.numerics.smooth import SmoothWidth, exact, sat, smooth
from jaxstage.plants import screw_table
from jaxstage.studies.adaptive_smc import values
from tests.helpers.batteries import seen, setpoint

DT = 5e-3
TEN, BLURRED = FinalDamping(final=10.0), BoundedDamping(final=10.0, speed=1e-3)


def on_device(tree):
    return jax.tree.map(lambda x: jnp.asarray(x, float), tree)


# --- psi -------------------------------------------------------------------------------------

#: measured and commanded velocity in mm/s
SPEEDS = ((0, 1), (0.5, 1), (1, 1), (1.2, 1), (1, 0))
PSI = {
    "raw": (0, 1.652962, 10, 18.74370),
    "bounded_below": (3.775407, 5.052989, 10, 13.89288, 37.18282),
    "bounded": (3.775407, 5.052989, 10, 10, 10),
    "constant": (10, 10, 10, 10, 10),
}


@pytest.mark.fast
@pytest.mark.parametrize("form", PSI)
def test_values_of_psi(form):
    params = on_device(TEN if form in ("raw", "constant") else BLURRED)
    psi = functools.partial(getattr(damping, form).apply, params)
    for (v, wanted), expected in zip(SPEEDS, PSI[form], strict=False):
        got = psi(jnp.asarray(wanted * 1e-3), jnp.asarray(v * 1e-3))
        np.testing.assert_allclose(got, expected, rtol=4e-7, atol=1e-15)


@pytest.mark.fast
def test_psi_as_printed_has_no_value_at_a_reversal():
    with pytest.raises(ValueError, match="commanded velocity of 0"):
        damping.raw.apply(on_device(TEN), jnp.asarray(0.0), jnp.asarray(1e-3))
    inside = jax.jit(damping.raw.apply)(on_device(TEN), jnp.asarray(0.0), jnp.asarray(0.0))
    assert np.isnan(inside)


@pytest.mark.fast
@pytest.mark.parametrize("wanted", [-2e-3, 0.0, 1e-3])
def test_psi_is_smooth_at_rest_and_at_reversals(wanted):
    for form in (damping.bounded, damping.bounded_below):
        psi = functools.partial(form.apply, on_device(BLURRED))
        slope = jax.grad(psi, argnums=(0, 1))
        assert np.isfinite(slope(jnp.asarray(wanted), jnp.asarray(0.0))).all()
        h = 1e-8
        numeric = (psi(wanted + h, 5e-4) - psi(wanted - h, 5e-4)) / (2 * h)
        exactly = slope(jnp.asarray(wanted), jnp.asarray(5e-4))[0]
        np.testing.assert_allclose(exactly, numeric, rtol=1e-5, atol=1e-4)


# --- reaching gains --------------------------------------------------------------------------

SURFACES = np.array([3e-5, -2e-5, 1e-5, -5e-6, 0.0, 1.4e-5, 4e-4, -1e-6])


def course(law, params, surfaces=SURFACES):
    """K before each update, and after the last."""
    params = on_device(params)
    gains = [law.start(params)]
    for s in surfaces:
        gains.append(law.update(params, gains[-1], jnp.asarray(s), DT))
    return np.array(gains)


def adaptive_by_hand(start, rate, eps, alpha, mu, cap, surfaces=SURFACES):
    gains = [start]
    for s in np.abs(surfaces):
        change = rate * s * np.sign(s - eps) if gains[-1] > alpha else mu
        gains.append(min(max(gains[-1] + DT * change, 0.0), cap))
    return np.array(gains)


@pytest.mark.fast
def test_adaptive_gain():
    values = dict(start=80.0, rate=3e7, dead_zone=1.4e-5, floor=1.0, recovery=10.0, cap=100.0)
    got = course(reaching.adaptive, AdaptiveGain(**values))
    np.testing.assert_allclose(got, adaptive_by_hand(*values.values()), rtol=1e-14)
    assert got.max() == 100.0
    assert (course(reaching.adaptive, AdaptiveGain(**(values | {"rate": 0.0}))) == 80.0).all()


@pytest.mark.fast
def test_adaptive_gain_at_its_floor():
    """As printed it drops below alpha, even to 0, and recovers with mu; floored it stays."""
    values = dict(start=1.05, rate=3e7, dead_zone=1.0, floor=1.0, recovery=10.0, cap=100.0)
    small = np.full(9, 1e-5)
    got = course(reaching.adaptive, AdaptiveGain(**values), small)
    np.testing.assert_allclose(got, adaptive_by_hand(*values.values(), small), rtol=1e-14)
    assert got.min() == 0.0 and (np.diff(got) > 0).any()
    floored = course(reaching.adaptive_floored, AdaptiveGain(**values), small)
    assert (floored[1:] == 1.0).all()


@pytest.mark.fast
def test_only_the_smooth_gain_has_a_gradient_by_eps():
    params = on_device(
        AdaptiveGain(start=80.0, rate=3e7, dead_zone=1.4e-5, floor=1.0, recovery=10.0, cap=100.0)
    )

    def after(law, surface, eps=1.4e-5):
        return law.update(replace(params, dead_zone=eps), jnp.asarray(80.0), surface, DT)

    slope = jax.grad(after, argnums=2)
    floored, smooth_form = reaching.adaptive_floored, reaching.adaptive_smooth
    assert slope(floored, 2e-5, 1.4e-5) == 0
    got, h = slope(smooth_form, 2e-5, 1.4e-5), 1e-9
    numeric = (after(smooth_form, 2e-5, 1.4e-5 + h) - after(smooth_form, 2e-5, 1.4e-5 - h)) / 2 / h
    np.testing.assert_allclose(got, numeric, rtol=1e-6)
    assert after(smooth_form, 1.4e-5) == 80.0
    for far in (1e-8, 1e-3):
        np.testing.assert_allclose(after(smooth_form, far), after(floored, far), rtol=1e-3)
    assert slope(smooth_form, 0.0, 0.0) == 0


@pytest.mark.fast
def test_floored_gain_is_the_printed_one_above_the_floor():
    params = AdaptiveGain(
        start=80.0, rate=3e7, dead_zone=1.4e-5, floor=1.0, recovery=10.0, cap=100.0
    )
    same = course(reaching.adaptive_floored, params)
    np.testing.assert_array_equal(same, course(reaching.adaptive, params))
    slope = jax.grad(lambda k: reaching.adaptive_floored.update(params, k, 1e-5, DT))
    assert slope(50.0) == 1.0


@pytest.mark.fast
def test_integral_gain_only_rises():
    got = course(reaching.integral, IntegralGain(start=80.0, rate=0.8e12, cap=100.0))
    expected = np.minimum(80 + np.cumsum(np.concatenate([[0.0], DT * 0.8e12 * SURFACES**2])), 100)
    np.testing.assert_allclose(got, expected, rtol=1e-14)
    assert got[-1] == 100.0


@pytest.mark.fast
def test_fixed_gain():
    assert (course(reaching.fixed, FixedGain(start=80.0)) == 80.0).all()


# --- error rate ------------------------------------------------------------------------------


@pytest.mark.fast
def test_differenced_error_rate():
    """The first sample takes r' - y', the others the difference of the errors."""
    moves = [(0.010, 0.3, 0.0), (0.012, 0.5, 0.1), (0.011, -0.2, 0.4)]
    memory, rates = error_rate.differenced.init(jnp.asarray(0.0)), []
    for r, v, y in moves:
        wanted, got = setpoint([r], [v], [0.0]), seen([0.001 * y], [y])
        one = jax.tree.map(lambda x: x[0] if x.ndim else x, (wanted, got))
        rate, memory = error_rate.differenced.of(memory, *one, DT)
        rates.append(float(rate))
        assert error_rate.measured.of((), *one, DT)[0] == v - y
    errors = [r - 0.001 * y for r, _, y in moves]
    np.testing.assert_allclose(rates, [0.3, *(np.diff(errors) / DT)], rtol=1e-13)


# --- the law ---------------------------------------------------------------------------------

WANTED = dict(position=[2e-3, -1e-3], velocity=[1.5e-3, -2e-3], acceleration=[4e-3, 3e-3])
STATE = dict(position=[2.01e-3, -1.02e-3], velocity=[1.2e-3, -1.4e-3])


def gains(reaching_gain, switch=(), psi=BLURRED, q=0.01, mass_error=0.8):
    base = values.gains(reaching_gain, q=q, switch=switch, mass_error=mass_error)
    return on_device(replace(base, damping=psi))


def one_tick(law, params, last=WANTED, now=WANTED):
    """Demand and memory of a tick that sees ``now`` after a start at ``last``."""
    law, measured = per_axis(law), seen(**STATE)
    memory = law.init(params, setpoint(**last), measured)
    return law.control(params, memory, setpoint(**now), measured, DT)


def by_hand(psi, switched, extra=0.0, mass_error=0.8, slope=40.0, gain=80.0, q=0.01):
    """(12) in numpy: command in V and sliding variable; extra: sigma gam psi' e in m/s2."""
    r, v, a = (np.array(WANTED[k]) for k in ("position", "velocity", "acceleration"))
    y, w = np.array(STATE["position"]), np.array(STATE["velocity"])
    steep = slope + 1.8 * psi
    s = (v - w) + steep * (r - y)
    asked = a + steep * (v - w) + gain * s + q * switched(s) + extra
    force = mass_error * values.inertia() * asked + values.viscosity() * w
    return force / values.force_per_volt(), s


def clipped_psi(velocity=STATE["velocity"]):
    v, w = np.array(WANTED["velocity"]), np.array(velocity)
    ratio = np.minimum((w**2 + 1e-6) / (v**2 + 1e-6), 1)
    return 10 / (1 - np.exp(-1)) * (np.exp(ratio - 1) - np.exp(-1))


@pytest.mark.fast
@pytest.mark.parametrize(
    ("switch", "params", "switched"),
    [
        (exact, (), np.sign),
        (smooth, SmoothWidth(width=1e-3), lambda s: np.tanh(s / 1e-3)),
        (sat, SmoothWidth(width=1e-3), lambda s: np.clip(s / 1e-3, -1, 1)),
    ],
    ids=["exact", "smooth", "sat"],
)
def test_the_law(switch, params, switched):
    demand, memory = one_tick(
        nonlinear_surface(switch=switch), gains(FixedGain(start=80.0), params)
    )
    expected, surface = by_hand(clipped_psi(), switched)
    np.testing.assert_allclose(demand, expected, rtol=1e-13)
    np.testing.assert_allclose(memory.surface, surface, rtol=1e-13)
    np.testing.assert_allclose(memory.damping, clipped_psi(), rtol=1e-13)
    assert (memory.reaching == 80.0).all()


@pytest.mark.fast
def test_the_surface_is_linear_with_constant_psi():
    law = nonlinear_surface(damping=damping.constant)
    demand, _ = one_tick(law, gains(FixedGain(start=80.0), psi=TEN))
    expected, _ = by_hand(np.full(2, 10.0), np.sign)
    np.testing.assert_allclose(demand, expected, rtol=1e-13)


@pytest.mark.fast
@pytest.mark.parametrize("sign", [1, -1])
def test_differenced_psi(sign):
    """psi' from the last two ticks, and its sign in the command."""
    law = nonlinear_surface(damping_rate=damping.differenced(sign))
    slow = WANTED | {"velocity": [1.45e-3, -2.1e-3]}
    demand, memory = one_tick(law, gains(FixedGain(start=80.0)), last=slow)
    before = one_tick(nonlinear_surface(), gains(FixedGain(start=80.0)), now=slow)[1].damping
    error = np.array(WANTED["position"]) - np.array(STATE["position"])
    extra = sign * 1.8 * (memory.damping - before) / DT * error
    assert np.abs(extra).min() > 1e-6
    np.testing.assert_allclose(demand, by_hand(clipped_psi(), np.sign, extra)[0], rtol=1e-12)
    still, _ = one_tick(law, gains(FixedGain(start=80.0)))
    np.testing.assert_allclose(still, by_hand(clipped_psi(), np.sign)[0], rtol=1e-13)


@pytest.mark.fast
@pytest.mark.parametrize("sign", [1, -1])
def test_modelled_psi_solves_the_loop(sign):
    """psi' of the law is the rate of psi on the motion that its own command causes (nominally)."""
    law = nonlinear_surface(damping=damping.bounded_below, damping_rate=damping.modelled(sign))
    params = gains(FixedGain(start=80.0), mass_error=1.0)
    demand, _ = one_tick(law, params)
    w, v = np.array(STATE["velocity"]), np.array(WANTED["velocity"])
    axis = params.nominal
    moved = (axis.force_constant * demand - axis.damping * w) / axis.mass
    h = 1e-6

    def psi(t):
        ratio = ((w + moved * t) ** 2 + 1e-6) / (
            (v + np.array(WANTED["acceleration"]) * t) ** 2 + 1e-6
        )
        return 10 / (1 - np.exp(-1)) * (np.exp(ratio - 1) - np.exp(-1))

    rate = (psi(h) - psi(-h)) / (2 * h)
    error = np.array(WANTED["position"]) - np.array(STATE["position"])
    expected, _ = by_hand(psi(0.0), np.sign, sign * 1.8 * rate * error, mass_error=1.0)
    np.testing.assert_allclose(demand, expected, rtol=1e-9)
    without = by_hand(psi(0.0), np.sign, mass_error=1.0)[0]
    assert np.abs(demand / without - 1).min() > 1e-5


@pytest.mark.fast
def test_modelled_psi_stays_finite():
    """The denominator 1 - psi_y' sigma gam e is kept 0.1 from 0, with its sign."""
    params = on_device(BLURRED)
    psi = functools.partial(damping.bounded_below.apply, params)
    wanted, speed, asked = jnp.asarray(0.0), jnp.asarray(1e-3), jnp.asarray(2e-3)
    steep = jax.grad(psi, argnums=1)(wanted, speed)
    for gap, kept in ((1.0, 1.0), (0.05, 0.1), (-0.05, -0.1), (-2.0, -2.0)):
        motion = damping.Motion(wanted, jnp.asarray(0.0), speed, asked, (1 - gap) / steep)
        got = damping.modelled().of(psi, motion, jnp.asarray(0.0), DT)
        np.testing.assert_allclose(got, steep * asked / kept, rtol=1e-9)


@pytest.mark.fast
def test_the_new_gain_is_used_from_the_next_sample_on():
    law = per_axis(nonlinear_surface(reaching=reaching.adaptive))
    params = gains(values.adaptive_gain(rate=3e5, dead_zone=1.4e-5))
    wanted, measured = setpoint(**WANTED), seen(**STATE)
    memory = law.init(params, wanted, measured)
    first, memory = law.control(params, memory, wanted, measured, DT)
    assert (memory.reaching == 80.0).all()
    memory = law.settle(params, memory, first, first, DT)
    size = np.abs(memory.surface)
    rise = 3e5 * size * np.sign(size - 1.4e-5) * DT
    np.testing.assert_allclose(memory.reaching, 80 + rise, rtol=1e-13)
    second, _ = law.control(params, memory, wanted, measured, DT)
    expected, _ = by_hand(clipped_psi(), np.sign, gain=80 + rise)
    np.testing.assert_allclose(second, expected, rtol=1e-12)


# --- bad input -------------------------------------------------------------------------------

GOOD = gains(values.adaptive_gain(), SmoothWidth(width=1e-4))
BAD = [
    ("slope", 0.0), ("slope", np.nan), ("damping_slope", -1.0), ("switching_gain", -1.0),
    ("damping.final", -1.0), ("damping.speed", 0.0), ("reaching.start", -1.0),
    ("reaching.rate", -1.0), ("reaching.dead_zone", -1.0), ("reaching.floor", -1.0),
    ("reaching.recovery", -1.0), ("reaching.cap", 0.0), ("switch.width", 0.0),
    ("nominal.mass", 0.0), ("nominal.damping", -1.0), ("nominal.force_constant", 0.0),
]  # fmt: skip


def refused(params, name, value):
    shared = jax.tree.map(lambda _: -1, params)
    check_leaves(screw_table(), params, "gains", shared, per_axis=True)
    holder, _, field = name.rpartition(".")
    worse = jnp.array([1.0, value])
    inner = replace(getattr(params, holder), **{field: worse}) if holder else worse
    bad = replace(params, **{holder or field: inner})
    with pytest.raises(ValueError, match=rf"gains\.{name} \(y\)"):
        check_leaves(screw_table(), bad, "gains", shared, per_axis=True)


@pytest.mark.fast
@pytest.mark.parametrize(("name", "value"), BAD, ids=[f"{n}={v}" for n, v in BAD])
def test_bad_gains_are_refused(name, value):
    refused(GOOD, name, value)


@pytest.mark.fast
def test_bad_gains_of_the_other_forms_are_refused():
    refused(gains(values.fixed_gain(), psi=TEN), "damping.final", -1.0)
    refused(gains(values.fixed_gain()), "reaching.start", -1.0)
    refused(gains(values.integral_gain()), "reaching.rate", -1.0)


@pytest.mark.fast
@pytest.mark.parametrize("rate", [damping.differenced, damping.modelled])
def test_a_sign_is_one_of_two(rate):
    assert rate(1).sign == 1 and rate(-1).sign == -1
    with pytest.raises(ValueError, match="sign = 0: must be 1"):
        rate(0)


@pytest.mark.fast
def test_equal_choices_are_one_definition():
    assert nonlinear_surface(damping_rate=damping.modelled()) is nonlinear_surface(
        damping_rate=damping.modelled()
    )
    assert isinstance(GOOD.nominal, RigidAxis)
