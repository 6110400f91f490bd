"""The battery that every law passes, and the laws by their theory."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from batteries import (
    DT,
    ENTRIES,
    Lead,
    ahead,
    cast,
    seen,
    setpoint,
    table_loop,
    tracing,
)

from jaxstage import settings
from jaxstage.blocks import Controller, keep
from jaxstage.controllers import (
    Both,
    Coupled,
    DisturbanceObserver,
    Offset,
    PidContour,
    cascade,
    cmac_sliding,
    cross_coupled,
    disturbance_observer,
    gaussian,
    offset_setpoint,
    per_axis,
    pi,
    pid_contour,
    plus,
    sliding,
)
from jaxstage.drives import CurrentDrive, current_drive
from jaxstage.fields import leaves, pytree, replace, signal
from jaxstage.numerics.smooth import Layer, exact, implicit
from jaxstage.rollout import _simulate, simulate
from jaxstage.studies import Timing, build
from jaxstage.studies.fuzzy_cmac.loops import (
    LAWS,
    cascade_gains,
    dfcmac_gains,
    pi_gains,
    scenario,
    sliding_gains,
)

every_law = pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
types = pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64], ids=["f32", "f64"])

#: error (m), rate (m/s), setpoint velocity (m/s) and acceleration (m/s2) of x and y
MOVING = ([1.2e-3, -0.7e-3], [0.012, -0.02], [0.15, -0.04], [0.3, 0.8])
CASES = {
    "moving": MOVING,
    "zero error": ([0, 0], [0, 0], [0.15, -0.04], [0.3, 0.8]),
    "rest": ([0, 0], [0, 0], [0, 0], [0, 0]),
    "reversal": ([1e-5, -1e-5], [1e-9, -1e-9], [0, 1e-300], [-1, 1]),
    "far off": ([5, -5], [100, -100], [1, 1], [50, -50]),
}


def bench(case, dtype=jnp.float64):
    """Setpoint and measurement with the given error and rate."""
    error, rate, velocity, acceleration = (np.asarray(x, float) for x in case)
    wanted = setpoint([0.02, -0.01], velocity, acceleration, dtype)
    return wanted, seen([0.02, -0.01] - error, velocity - rate, dtype)


def kinds(tree):
    """Structure, shape, type and weak type of every leaf."""
    described = jax.tree.map(lambda x: (x.shape, str(x.dtype), x.weak_type), tree)
    return jax.tree.structure(tree), jax.tree.leaves(described)


def ticks(law, gains, pair, limit=0.3, count=2):
    """``count`` periods with a fixed error and a drive that saturates: demands and memory."""
    wanted, measured = pair
    memory, demands = law.init(gains, wanted, measured), []
    for _ in range(count):
        demand, memory = law.control(gains, memory, wanted, measured, DT)
        memory = law.settle(gains, memory, demand, jnp.clip(demand, -limit, limit), DT)
        demands.append(demand)
    return jnp.stack(demands), memory


@functools.cache
def compiled(name, dtype=jnp.float64):
    """`ticks` of an entry as one compiled function of gains, setpoint, measurement and limit."""
    (law,) = (entry.make() for entry in ENTRIES if entry.name == name)
    return jax.jit(lambda gains, pair, limit: ticks(law, gains, pair, limit))


def close(a, b, rtol, atol=0.0):
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=rtol, atol=atol), a, b)


# --- the battery ---------------------------------------------------------------------------


@pytest.mark.fast
@every_law
@types
def test_memory_keeps_structure_shape_and_type(entry, dtype):
    """So that the scan accepts it, and nothing is ever traced twice."""
    law, gains = entry.make(), cast(entry.gains, dtype)
    wanted, measured = bench(MOVING, dtype)

    def period(gains, wanted, measured):
        before = law.init(gains, wanted, measured)
        demand, controlled = law.control(gains, before, wanted, measured, DT)
        return demand, before, controlled, law.settle(gains, controlled, demand, demand, DT)

    demand, before, controlled, settled = jax.eval_shape(period, gains, wanted, measured)
    assert demand.shape == (2,) and demand.dtype == dtype and not demand.weak_type
    assert kinds(before) == kinds(controlled) == kinds(settled)
    assert all(leaf.dtype == dtype and not leaf.weak_type for leaf in jax.tree.leaves(settled))


@every_law
def test_finite_command_and_memory(entry):
    """At zero error, rest, reversal, far off; also behind a drive that gives next to nothing."""
    for name, case in CASES.items():
        for limit in (np.inf, 1e-3):
            result = compiled(entry.name)(cast(entry.gains), bench(case), limit)
            assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(result)), name


@every_law
def test_jit_equals_eager(entry):
    eager = ticks(entry.make(), cast(entry.gains), bench(MOVING))
    jitted = compiled(entry.name)(cast(entry.gains), bench(MOVING), 0.3)
    close(jitted, eager, rtol=1e-11, atol=1e-14)


@every_law
def test_many_gains_equal_one_at_a_time(entry):
    one, pair = compiled(entry.name), bench(MOVING)
    some = [
        jax.tree.map(lambda x, c=c: x * c + (c - 1) * 1e-3, cast(entry.gains))
        for c in (0.8, 1.0, 1.3)
    ]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *some)
    many = jax.vmap(lambda g: one(g, pair, 0.3))(stacked)
    for i, gains in enumerate(some):
        close(jax.tree.map(lambda x, i=i: x[i], many), one(gains, pair, 0.3), 1e-11, 1e-14)


@every_law
def test_gradients(entry):
    """By gains, setpoint and measurement: finite at rest, zero error and reversal too. Forward
    equals reverse and differences at a point where no law switches."""
    law, gains = entry.make(), cast(entry.gains)
    weights = jnp.broadcast_to(jnp.asarray([0.7, -1.3]), (2, 2))
    rng = np.random.default_rng(0)
    direction = jax.tree.map(
        lambda x: jnp.asarray(rng.uniform(0.5, 1, x.shape) * np.where(x == 0, 1e-3, x)), gains
    )

    def objective(g, pair):
        demands, memory = ticks(law, g, pair, limit=0.05)
        return jnp.sum(demands * weights) + sum(jnp.sum(m) for m in jax.tree.leaves(memory))

    @jax.jit
    def slopes(g, pair, d):
        forward = jax.jvp(lambda x: objective(x, pair), (g,), (d,))
        return forward, jax.grad(objective, argnums=(0, 1))(g, pair)

    for name, case in CASES.items():
        found = slopes(gains, bench(case), direction)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found)), name
    (_, forward), (reverse, _) = slopes(gains, bench(MOVING), direction)
    assert forward != 0
    pairs = zip(jax.tree.leaves(reverse), jax.tree.leaves(direction), strict=True)
    np.testing.assert_allclose(sum(np.vdot(a, b) for a, b in pairs), forward, rtol=1e-10)
    h = 1e-6
    up, down = (
        slopes(
            jax.tree.map(lambda x, d, s=s: x + s * d, gains, direction), bench(MOVING), direction
        )
        for s in (h, -h)
    )
    np.testing.assert_allclose((up[0][0] - down[0][0]) / (2 * h), forward, rtol=5e-6)


@pytest.mark.fast
@every_law
def test_composed_anew_it_is_the_same_definition(entry):
    assert entry.make() is entry.make()
    assert hash(entry.make()) == hash(entry.make())


@pytest.mark.fast
@every_law
def test_gains_survive_a_file(entry, tmp_path):
    rng = np.random.default_rng(1)
    gains = jax.tree.map(lambda x: jnp.asarray(x * rng.uniform(0.5, 2, np.shape(x))), entry.gains)
    file = tmp_path / "gains.toml"
    file.write_text(settings.to_toml({"gains": gains}))
    back, _, paths = settings.apply(cast(entry.gains), scenario(), settings.read_toml(file))
    assert jax.tree.structure(back) == jax.tree.structure(gains)
    assert len(paths) == len(jax.tree.leaves(gains))
    jax.tree.map(np.testing.assert_array_equal, back, gains)


@pytest.mark.fast
@every_law
def test_every_gain_and_memory_has_unit_and_meaning(entry):
    law, gains = entry.make(), cast(entry.gains)
    memory = law.init(gains, *bench(MOVING))
    for tree in (gains, memory):
        described = list(leaves(tree))
        assert len(described) == len(jax.tree.leaves(tree))
        for path, quantity, _ in described:
            assert quantity.unit and quantity.doc, path
    assert all(q.symbol for _, q, _ in leaves(gains)), "a gain without symbol"


@every_law
def test_single_precision_follows_double(entry):
    """Errors are differences of positions of 20 mm: 2e-9 m of rounding, times the stiffest law."""
    for name in ("moving", "zero error", "rest"):
        fine, _ = compiled(entry.name)(cast(entry.gains), bench(CASES[name]), 0.3)
        coarse, _ = compiled(entry.name, "f32")(
            cast(entry.gains, jnp.float32), bench(CASES[name], jnp.float32), 0.3
        )
        assert coarse.dtype == jnp.float32
        scale = np.abs(fine).max() + 0.02
        np.testing.assert_allclose(coarse[0], fine[0], atol=1e-3 * scale, err_msg=name)


SETTLED = [entry for entry in ENTRIES if entry.settled and entry.name != "offset"]


@pytest.mark.parametrize("entry", SETTLED, ids=lambda entry: entry.name)
def test_single_precision_run_follows_double(entry):
    """A tenth of a second of a law that does not switch: errors agree to a fiftieth."""
    loop, scenario, path = table_loop(entry.make())
    reports = []
    for dtype in (jnp.float32, jnp.float64):
        run = simulate(loop, entry.gains, scenario, cast(path, dtype), 1000)
        assert run.report.ate.dtype == dtype
        reports.append(run.report)
    np.testing.assert_allclose(reports[0].ate, reports[1].ate, rtol=0.02)
    np.testing.assert_allclose(reports[0].tracking_max, reports[1].tracking_max, rtol=0.02)


def test_no_retrace_for_changed_numbers():
    """Floats, numpy or JAX numbers, other seeds and recomposed definitions: one compilation."""

    def loop_of():
        return table_loop(per_axis(cmac_sliding(gaussian, exact)))

    loop, scenario, path = loop_of()
    gains = dfcmac_gains()
    before = _simulate._cache_size()
    variants = [
        (gains, scenario),
        (cast(gains), cast(replace(scenario, key=()))),
        (jax.tree.map(lambda x: np.asarray(1.1 * x, np.float32), gains), scenario),
        (gains, replace(scenario, plant=jax.tree.map(lambda x: 1.2 * x, scenario.plant))),
    ]
    for seed, (numbers, uncertain) in enumerate(variants):
        again, _, _ = loop_of()
        assert again == loop
        simulate(again, numbers, replace(uncertain, key=jax.random.key(seed)), path, 20)
    assert _simulate._cache_size() == before + 1


def test_no_retrace_for_python_floats():
    law, gains = per_axis(pi), pi_gains()
    loop, scenario, path = table_loop(offset_setpoint(law, "lead", ahead), drive=current_drive(2))
    before = _simulate._cache_size()
    for delay, time in enumerate((1e-4, np.float32(2e-4), jnp.asarray(3e-4))):
        drive = CurrentDrive(limit=np.array([1.0, 2.0]), delay=delay, lag=float(time))
        scenario = replace(scenario, drive=drive)
        simulate(loop, Offset(law=gains, offset=Lead(time=time)), scenario, path, 20)
    assert _simulate._cache_size() == before + 1


# --- composition ---------------------------------------------------------------------------


@pytree
class Heard:
    """What a `spy` was told."""

    demand: jax.Array = signal("A", "", "demand", shape="(axes,)")
    command: jax.Array = signal("A", "", "command", shape="(axes,)")
    position: jax.Array = signal("m", "", "setpoint", shape="(axes,)")


def _spy_control(gains, memory, wanted, measured, dt):
    return gains["demand"], replace(memory, position=wanted.position)


#: demands what its gains say, and remembers what it hears
spy = Controller(
    name="spy",
    init=lambda gains, wanted, measured: Heard(
        demand=jnp.zeros(2), command=jnp.zeros(2), position=wanted.position
    ),
    control=_spy_control,
    settle=lambda gains, memory, demand, command, dt: replace(
        memory, demand=demand, command=command
    ),
)


def spoken(x, y):
    return {"demand": jnp.asarray([x, y])}


@pytest.mark.fast
def test_per_axis_is_the_law_on_each_axis():
    for entry in ENTRIES[:5]:
        (single,) = (law.controller for law in LAWS if law.name == entry.name)
        gains = cast(entry.gains)
        wanted, measured = bench(MOVING)
        demands, memory = compiled(entry.name)(gains, (wanted, measured), 0.3)
        for i in range(2):
            pick = lambda tree, i=i: jax.tree.map(lambda x: x[i] if x.ndim else x, tree)  # noqa: E731
            own, sp, m = pick(gains), pick(wanted), pick(measured)
            kept = single.init(own, sp, m)
            for k in range(2):
                demand, kept = single.control(own, kept, sp, m, DT)
                kept = single.settle(own, kept, demand, jnp.clip(demand, -0.3, 0.3), DT)
                np.testing.assert_allclose(demand, demands[k, i], rtol=1e-12)
            close(kept, pick(memory), rtol=1e-12)


@pytest.mark.fast
def test_plus_adds_and_forwards_the_totals():
    law = plus(spy, plus(spy, spy))
    gains = Both(law=spoken(1, 2), extra=Both(law=spoken(10, 20), extra=spoken(100, 200)))
    wanted, measured = bench(MOVING)
    memory = law.init(gains, wanted, measured)
    demand, memory = law.control(gains, memory, wanted, measured, DT)
    np.testing.assert_array_equal(demand, [111, 222])
    command = jnp.asarray([50.0, 60.0])
    memory = law.settle(gains, memory, demand, command, DT)
    for heard in (memory.law, memory.extra.law, memory.extra.extra):
        np.testing.assert_array_equal(heard.demand, demand)
        np.testing.assert_array_equal(heard.command, command)


@pytest.mark.fast
def test_cross_coupling_is_an_acceleration_and_forwards_the_totals():
    law = cross_coupled(spy, spy)
    gains = Coupled(
        law=spoken(1, 2),
        extra=spoken(10, 20),
        command_per_acceleration=jnp.asarray([0.5, 0.25]),
    )
    wanted, measured = bench(MOVING)
    memory = law.init(gains, wanted, measured)
    demand, memory = law.control(gains, memory, wanted, measured, DT)
    np.testing.assert_array_equal(demand, [1 + 5, 2 + 5])
    memory = law.settle(gains, memory, demand, 0.5 * demand, DT)
    for heard, unit in ((memory.law, 1), (memory.extra, np.array([0.5, 0.25]))):
        np.testing.assert_array_equal(heard.demand, np.array([6, 7]) / unit)
        np.testing.assert_array_equal(heard.command, np.array([3, 3.5]) / unit)


@pytest.mark.fast
def test_a_gain_given_once_holds_for_all_axes():
    case = build("dfcmac-circle", Timing(lap_time=0.05, laps=1))
    once = replace(case.gains, slope=2.0, weights=np.zeros((4, 3, 3)))
    each = replace(case.gains, slope=np.full(2, 2.0))
    a, b = (replace(case, gains=g).simulate().report["tracking"].ate for g in (once, each))
    np.testing.assert_array_equal(a, b)


@pytest.mark.fast
def test_offset_moves_what_the_law_follows_only():
    law = offset_setpoint(spy, "lead", ahead)
    gains = Offset(law=spoken(1, 2), offset=Lead(time=jnp.asarray(1e-3)))
    wanted, measured = bench(MOVING)
    for memory in (
        law.init(gains, wanted, measured),
        law.control(gains, spy.init(None, wanted, measured), wanted, measured, DT)[1],
    ):
        np.testing.assert_allclose(
            memory.position - wanted.position, 1e-3 * wanted.velocity, atol=1e-17
        )
    settled = law.settle(gains, memory, jnp.ones(2), jnp.zeros(2), DT)
    np.testing.assert_array_equal(settled.demand, [1, 1])


def test_a_composition_runs_as_its_parts():
    """A coupling and an observer that do nothing leave a run as it is, to the last digit."""
    axis = per_axis(cascade)
    none = DisturbanceObserver(
        disturbance_gain=np.full(2, 1e-300),
        velocity_gain=np.ones(2),
        nominal=cascade_gains().nominal,
    )
    zero = np.zeros(())
    no_coupling = PidContour(
        proportional_gain=zero, integral_gain=zero, derivative_gain=zero, rest_speed=1e-6, form=()
    )
    composed = cross_coupled(plus(axis, per_axis(disturbance_observer)), pid_contour())
    gains = Coupled(
        law=Both(law=cascade_gains(), extra=none),
        extra=no_coupling,
        command_per_acceleration=np.full(2, 3e-3),
    )
    loop, scenario, path = table_loop(axis)
    plain = simulate(loop, cascade_gains(), scenario, path, 300)
    wrapped = simulate(replace(loop, controller=composed), gains, scenario, path, 300)
    np.testing.assert_allclose(wrapped.report.ate, plain.report.ate, rtol=1e-9)


# --- laws by their theory ------------------------------------------------------------------


def slid_variables(sample):
    return sample.memory.surface, sample.command


def followed(sample):
    return sample.output.position - sample.setpoint.position, sample.command != sample.demand


@pytest.fixture(scope="module")
def reaching():
    """|s| (m/s) of the ideal sliding law from rest, for a gain eta and a bound D."""
    loop, scenario, path = table_loop(per_axis(sliding(exact)), metric=tracing(slid_variables))

    def surfaces(eta, bound=1.0):
        gains = sliding_gains()
        gains = replace(
            gains,
            switching_gain=np.full(2, eta),
            disturbance_bound=bound * gains.disturbance_bound,
        )
        run = simulate(loop, gains, scenario, path, 2000)
        return np.abs(run.rows[0]), eta + np.asarray(gains.disturbance_bound)

    return surfaces


@pytest.mark.parametrize("eta", [1.0, 5.0])
def test_sliding_variable_falls_at_least_at_eta(reaching, eta):
    surface, full = reaching(eta)
    bound = np.asarray(sliding_gains().disturbance_bound)
    for axis in range(2):
        s = surface[:, axis]
        outside = s[:-1] > (full + bound)[axis] * DT
        fall = (s[:-1] - s[1:])[outside] / DT
        if s[0] > 0.1:
            assert outside.sum() > 100, "nothing to reach"
        assert (fall >= 0.9 * eta).all()


def test_a_bound_below_the_friction_does_not_reach(reaching):
    """Half the bound: the friction wins, s does not fall at eta; the law above can fail."""
    surface, _ = reaching(1.0, bound=0.5)
    start = int(np.argmax(surface[0] > 0.1))
    assert (surface[:1000, start] - surface[1:1001, start]).min() / DT < 0.9


@pytest.fixture(scope="module")
def slid():
    """max |s| once reached, full switching gain, bound D, and variation of u, per axis."""
    results = {}
    for name, switch, params in (
        ("exact", exact, ()),
        ("implicit", implicit, Layer(layer=np.ones(2))),
    ):
        loop, scenario, path = table_loop(
            per_axis(sliding(switch)), metric=tracing(slid_variables), period=5.0
        )
        gains = replace(sliding_gains(), switch=params)
        surface, command = simulate(loop, gains, scenario, path, 100_000).rows
        surface = np.abs(surface)
        bound = np.asarray(gains.disturbance_bound)
        full = bound + np.asarray(gains.switching_gain)
        first = [int(np.argmax(surface[:, i] <= full[i] * DT)) for i in range(2)]
        largest = np.array([surface[first[i] :, i].max() for i in range(2)])
        varied = np.abs(np.diff(command[50_000:], axis=0)).sum(axis=0) / 5.0
        results[name] = (largest, full, bound, varied)
    return results


def test_reached_it_stays_within_one_period_of_switching(slid):
    """|s| <= (eta_D + D) Ts with sgn, and comes near; about eta_D Ts with the implicit form."""
    largest, full, bound, _ = slid["exact"]
    assert (largest <= (full + bound) * DT).all()
    assert (largest > 0.98 * (full + bound) * DT).all()
    largest, full, _, _ = slid["implicit"]
    np.testing.assert_allclose(largest, full * DT, rtol=2e-3)


def test_implicit_switching_hardly_varies_the_command(slid):
    """Total variation per second in the second lap; the four numbers are an independent model's."""
    np.testing.assert_allclose(slid["exact"][3], [2.60, 2.17], rtol=5e-3)
    np.testing.assert_allclose(slid["implicit"][3], [0.202, 0.169], rtol=5e-3)


def overshoot(law, gains, limit, offset=-0.002, count=3000):
    """Largest following error of y beyond its setpoint, from ``offset`` m, behind a weak drive."""
    loop, scenario, path = table_loop(
        per_axis(law), metric=tracing(followed), drive=current_drive()
    )
    scenario = replace(
        scenario,
        drive=CurrentDrive(limit=np.full(2, limit), delay=0.0, lag=0.0),
        start=replace(scenario.start, offset=np.array([0.0, offset])),
    )
    beyond, cut = simulate(loop, gains, scenario, path, count).rows
    assert cut.any(), "the drive never saturated"
    return float(beyond[:, 1].max())


def test_cascade_does_not_wind_up():
    """2 mm off behind a drive that can just move: no overshoot, but millimetres for a deaf law."""
    gains = cascade_gains()
    assert overshoot(cascade, gains, 0.45) < 1e-6
    assert overshoot(replace(cascade, settle=keep), gains, 0.45) > 1e-3


def windup(law, gains, count):
    """Memory after ``count`` periods with a fixed error behind a drive of 0.1 A."""
    return jax.jit(lambda g: ticks(per_axis(law), g, bench(CASES["far off"]), 0.1, count)[1])(gains)


def test_cascade_integral_ends_at_the_limit():
    """Back-calculation has one fixed point: the integral alone gives the limit, b u = k_i I."""
    gains = cast(
        replace(
            cascade_gains(),
            velocity_feedforward=np.zeros(2),
            acceleration_feedforward=np.zeros(2),
            friction_feedforward=np.zeros(2),
            load_feedforward=np.zeros(2),
            integral_gain=np.full(2, 1e7),
        )
    )
    axis = gains.nominal
    limit = 0.1 * axis.force_constant / axis.mass / gains.integral_gain
    held = np.abs(windup(cascade, gains, 120).integral)
    np.testing.assert_allclose(held, limit, rtol=1e-6)
    deaf = np.abs(windup(replace(cascade, settle=keep), gains, 120).integral)
    assert (deaf > 100 * held).all()


def test_pi_settles_on_the_command_it_was_given():
    """After a cut the integral IS the command of the drive: it leaves the limit at once."""
    gains = cast(pi_gains())
    np.testing.assert_allclose(np.abs(windup(pi, gains, 5).command), 0.1, rtol=1e-12)
    assert (np.abs(windup(replace(pi, settle=keep), gains, 5).command) > 10).all()
