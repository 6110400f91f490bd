"""The tuner's core on a small problem: figures, derivatives, goals, barrier, methods, resuming."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage as js
from jaxstage.metrics import record, selected, together
from jaxstage.studies import with_metric
from jaxstage.studies.case import scored
from tuning.tuner.problem.compiled_objective import _pulled
from tuning.tuner.problem.gradient_check import compare_slopes, gradient_check
from tuning.tuner.problem.objective import LOST, Objective, Term, cvar, mean, parse_goals, worst
from tuning.tuner.problem.problem import (
    evaluate,
    gauss_newton_model,
    make_problem,
    scales_of,
    value_and_grad,
    with_weights,
)
from tuning.tuner.problem.run_group import make_group
from tuning.tuner.problem.search_space import Search, search_space
from tuning.tuner.problem.training_metrics import (
    CHANGE,
    CONTOUR,
    FOLLOWING,
    PIECES,
    available_columns,
    growth,
    pieces,
    smooth_max,
)
from tuning.tuner.search.cma_es import cma_es
from tuning.tuner.search.cost_model import CostModel
from tuning.tuner.search.first_order import first_order
from tuning.tuner.search.lbfgs import lbfgs
from tuning.tuner.search.levenberg_marquardt import levenberg_marquardt
from tuning.tuner.search.method import Method
from tuning.tuner.search.optimise import tune
from tuning.tuner.search.random_search import RandomState, random_search
from tuning.uncertainty.uncertain_space import draw, space, study_spreads

pytestmark = pytest.mark.long

TICKS, RUNS = 300, 3
COST_MODEL = CostModel(gradient=4.0, gauss_newton=5.0, simulation_s=1e-3)
TERMS = (Term("contour_rms_um"), Term("energy_copper_J", 0.1), Term("command_change_rms_A", 0.1))


@functools.cache
def case():
    """A PI law on a fast circle, which it follows badly; the loop that compiles fastest."""
    return js.build("pi-circle", js.Timing(lap_time=0.5, duration=TICKS * 1e-4, scored=0))


@functools.cache
def group(margin=0.0):
    spreads = [s for s in study_spreads("pi-circle") if s["path"] != "plant.coulomb"]
    values = draw(space(case(), spreads, ()), "random", 1, RUNS, 0, RUNS)
    return make_group("circle", case(), values, np.arange(RUNS), margin)


@functools.cache
def searched():
    return search_space(case(), (Search("c1"), Search("K", tied=True)))


@functools.cache
def problem():
    return make_problem(searched(), (group(0.25),), Objective(TERMS), width=4)


Z = np.array([0.3, -0.2, 0.1])


# --- figures and objective -----------------------------------------------------------------


def test_figures_are_those_of_single_runs():
    """All that is evaluated in one batch, against `simulate` on the same plants."""
    found = evaluate(problem(), np.stack([searched().start(), Z]))
    own = group(0.25)
    loop = js.replace(own.case.loop, metric=own.case.metric)
    for run in (1, RUNS + 1):  # a plant, and the first one with more gain
        axes = own.batch.in_axes[1]
        spread = jax.tree.map(
            lambda a, x: a is not None, axes, own.batch.scenario, is_leaf=lambda a: a is None
        )
        scenario = jax.tree.map(lambda s, x, r=run: x[r] if s else x, spread, own.batch.scenario)
        gains = searched().gains_of(jnp.asarray(Z))
        report = js.simulate(loop, gains, scenario, own.case.path, TICKS).report
        columns = js.columns(report, loop.plant)
        assert found.columns["contour_rms_um"][1, run] == pytest.approx(
            columns["contour_rms_um"], rel=1e-9
        )
        assert found.columns["energy_copper_J"][1, run] == pytest.approx(
            columns["energy_copper_J"], rel=1e-9
        )


def test_sums_of_a_run_are_those_of_its_record():
    """Squares of each piece, the smooth maximum and the growth, against every recorded tick."""
    first = 60
    window = case().window._replace(start=first)
    own = together(
        record,
        pieces((CONTOUR, FOLLOWING, CHANGE), window),
        scored(smooth_max, window),
        growth(TICKS),
    )
    run = with_metric(case(), own).simulate()
    rows, report = run.rows["record"], run.report
    error = np.asarray(rows.setpoint.position - rows.output.position)
    contour = np.asarray(rows.nearest.distance)
    command = np.asarray(rows.command)
    change = np.diff(command, axis=0, prepend=command[:1])
    inside = TICKS - first
    for name, square in (
        ("contour", contour**2),
        ("following", np.mean(error**2, axis=1)),
        ("change", np.mean(change**2, axis=1)),
    ):
        parts = square[first:].reshape(PIECES, -1).sum(axis=1) / inside
        np.testing.assert_allclose(report["pieces"][name], parts, rtol=1e-10)
    power = np.mean(np.abs(contour[first:]) ** 16) ** (1 / 16)
    found = float(report["scored"].contour_smooth_max)
    assert found == pytest.approx(power, rel=1e-10)
    thirds = np.sum(error**2, axis=1).reshape(3, -1).mean(axis=1)
    assert float(report["growth"]) == pytest.approx(np.sqrt(thirds[2] / thirds[1]), rel=1e-10)


def test_a_smooth_command_is_not_the_price_of_accuracy():
    """The changes of a command count as 1 from 2 % of its RMS on, or from where they were."""
    before = problem().before
    assert before is not None
    found = {}
    for share in (0.001, 0.1):
        change = share * before.columns["command_rms_A"]
        columns = {**before.columns, "command_change_rms_A": change}
        found[share] = scales_of(problem(), before._replace(columns=columns))
    np.testing.assert_allclose(found[0.001] / found[0.1], [1, 1, 0.02 / 0.1], rtol=1e-12)
    told = problem()._replace(objective=Objective((Term("command_change_rms_A", scale=1e-6),)))
    assert scales_of(told, before) == [1e-6], "what the user says is not touched"


def test_the_objective_is_the_sum_of_its_terms():
    found = evaluate(problem(), Z[None])
    before = problem().before
    assert before is not None and before.objective[0] == pytest.approx(1.0)
    parts = [
        t.weight * (found.columns[t.column] / scale) ** 2
        for t, scale in zip(TERMS, problem().scales, strict=True)
    ]
    pull = 1 + 1e-4 * np.sum((Z - searched().start()) ** 2)
    costs = sum(parts) / sum(t.weight for t in TERMS) * pull
    np.testing.assert_allclose(found.costs, costs, rtol=1e-10)
    weights = [1.0] * RUNS + [0.05] * 2  # those with a wrong gain
    expected = np.average(costs, axis=1, weights=weights)
    np.testing.assert_allclose(found.objective, expected, rtol=1e-10)


def test_derivatives_agree():
    """Reverse and forward mode, the curvature's per-run gradients, and differences."""
    reverse, forward = value_and_grad(problem(), Z[None]), gauss_newton_model(problem(), Z[None])
    scale = np.max(np.abs(forward.gradient))
    np.testing.assert_allclose(reverse.gradient, forward.gradient, atol=1e-9 * scale)
    summed = np.average(forward.of_runs, axis=1, weights=[1.0] * RUNS + [0.05] * 2)
    np.testing.assert_allclose(summed, forward.gradient, atol=1e-9 * scale)
    check = gradient_check(problem(), Z, known=forward)
    assert check.ok and check.non_finite == 0 and np.max(check.error) < 0.02
    matrix = forward.gauss_newton[0]
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-9 * np.max(matrix))
    assert np.linalg.eigvalsh(matrix)[0] > -1e-9 * np.max(matrix)


def test_a_wrong_gradient_fails_the_check():
    slope = np.array([[1.0, 2.0], [0.5, -1.0], [0.2, 0.3], [1.0, 1.0]])
    runs = ("a", "b", "c", "d")
    assert compare_slopes(runs, slope, [slope * 1.1, slope]).ok
    assert not compare_slopes(runs, slope, [-slope, 0 * slope]).ok
    assert not compare_slopes(runs, np.where(slope == 0.5, np.nan, slope), [slope]).ok


def test_lost_runs_order_candidates():
    """Later is better, nothing is NaN, and the slope of a lost run is none."""
    loop = js.replace(case().loop, path_limit=1e-3)
    own = make_group("tight", case()._replace(loop=loop), {}, np.arange(1))
    weak = search_space(case(), (Search("K", 1e-3, 1e6, tied=True),))
    scaled = tuple(t._replace(scale=1.0) for t in TERMS[:1])
    tight = make_problem(weak, (own,), Objective(scaled), width=4)
    found = evaluate(tight, np.array([[-3.6], [-3.27], [-3.08], [0.0]]))
    lost = found.lost_at_s[:, 0]
    assert np.all(lost[:-1] > 0) and len(set(lost[:-1])) == 3
    assert np.all(np.isfinite(found.objective)) and np.all(found.objective[:-1] >= LOST)
    assert np.all(np.diff(found.objective[:-1]) < 0) and np.all(np.diff(lost[:-1]) > 0)
    assert np.isnan(lost[-1]) and found.objective[-1] < LOST
    assert np.isinf(found.violation[0]) and found.violation[-1] == -1
    start = case()._replace(gains=weak.gains_of(jnp.asarray([-3.6])))
    from_lost = search_space(start, (Search("K", 1e-3, 1e6, tied=True),))
    found = make_problem(from_lost, (own,), Objective(TERMS[:1]), width=8)
    assert found.before is not None and found.before.objective[0] >= LOST
    assert 1 < found.scales[0] < 1e3, "um: the error of gains that hold the run"
    result = tune(found, starts=2, budget=60.0, cost_model=COST_MODEL)
    assert result.before >= LOST and result.after < 1.01 and result.feasible
    value = float(start.gains.proportional_gain[0])
    hopeless = search_space(start, (Search("K", 0.9 * value, 1.1 * value, tied=True),))
    with pytest.raises(ValueError, match=r"1 of 1 training runs are lost, the first, tight 0, at"):
        make_problem(hopeless, (own,), Objective(TERMS[:1]), width=8)


@pytest.mark.fast
@pytest.mark.parametrize("size", [1.0, 1e-8])
def test_the_pull_is_a_share_of_what_is_left(size):
    """Value, gradient and curvature of d (1 + 1e-4 |z - z0|^2), however small d is."""
    target = jnp.array([3.0, -1.0])

    def residuals(z):
        return jnp.sqrt(size) * jnp.array([z[0] - target[0], 2 * z[1] - target[1], z[0] * z[1]])

    def pulled(z):
        return _pulled(residuals(z)[None, None], z[None])[0, 0]

    def cost(z):
        return jnp.sum(residuals(z) ** 2) * (1 + 1e-4 * jnp.sum(z**2))

    z = jnp.array([1.5, 0.7])
    assert float(jnp.sum(pulled(z) ** 2)) == pytest.approx(float(cost(z)), rel=1e-12)
    gradient = jax.grad(lambda z: jnp.sum(pulled(z) ** 2))(z)
    np.testing.assert_allclose(gradient, jax.grad(cost)(z), rtol=1e-10)
    jacobian = jax.jacfwd(pulled)(z)
    np.testing.assert_allclose(2 * jacobian.T @ pulled(z), gradient, rtol=1e-10)
    assert jacobian.shape == (5, 2), "each coordinate has a residual of its own"


@pytest.mark.fast
def test_risk_weights():
    costs = jnp.array([[1.0, 4.0, 2.0, 3.0], [5.0, 1.0, 1.5, 1.2]])
    shares = jnp.full(4, 0.25)
    np.testing.assert_allclose(mean.weights(costs, shares), np.full((2, 4), 0.25))
    np.testing.assert_allclose(worst.weights(costs, shares), [[0, 1, 0, 0], [1, 0, 0, 0]])
    little = jnp.array([0.3, 0.05, 0.35, 0.3])
    np.testing.assert_allclose(worst.weights(costs, little)[0], [0, 0, 0, 1])
    lost = worst.weights(costs.at[0, 1].set(2 * LOST), little)
    np.testing.assert_allclose(lost[0], [0, 1, 0, 0])
    np.testing.assert_allclose(
        cvar(0.5).weights(costs, shares), [[0, 0.5, 0, 0.5], [0.5, 0, 0.5, 0]]
    )
    part = cvar(0.3).weights(costs, shares)
    np.testing.assert_allclose(part, [[0, 5 / 6, 0, 1 / 6], [5 / 6, 0, 1 / 6, 0]])
    with pytest.raises(ValueError, match="cvar share = 0: must be in"):
        cvar(0)


@pytest.mark.fast
def test_goals_say_by_how_much_they_are_missed():
    columns = {"a_um": np.array([10.0, 30.0]), "b": np.array([1.0, 2.0])}
    low, high = parse_goals("5 < a_um <= 20", columns)
    np.testing.assert_allclose(low.violation(columns), [-1.0, -5.0])
    np.testing.assert_allclose(high.violation(columns), [-0.5, 0.5])
    (both,) = parse_goals("a_um / 10 < b + 1", columns)
    np.testing.assert_allclose(both.violation(columns), [-1 / 3, 0.0])
    assert parse_goals("a_um < 20 and b > 3", columns)[1].names == ("b",)
    for text, told in (
        ("a_um < 20 or b < 1", "must be a comparison by"),
        ("a_um == 20", "must be a comparison by"),
        ("a_um + 1", "is a number: compare it"),
        ("c < 1", "unknown column 'c'"),
        (f"a_um < 1{400 * '0'}", "a number is beyond"),
        ("a_um < 1e400", "a number is beyond"),
        (" and ".join(["a_um < 1"] * 3000), "longer than"),
    ):
        with pytest.raises(ValueError, match=told) as error:
            parse_goals(text, columns)
        assert str(error.value).startswith("--goal '") and "\n" not in str(error.value)
        assert len(str(error.value)) < 400


def test_a_start_has_weights_of_its_own():
    """The rows of a trade-off share one program."""
    both = with_weights(problem(), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    found = evaluate(both, np.stack([Z, Z]), np.arange(2))
    ratio = found.columns["contour_rms_um"][0] / both.scales[0]
    pull, weights = 1 + 1e-4 * np.sum((Z - searched().start()) ** 2), [1.0] * RUNS + [0.05] * 2
    assert found.objective[0] == pytest.approx(np.average(ratio**2, weights=weights) * pull)
    drawn = found.columns["energy_copper_J"][1] / both.scales[1]
    assert found.objective[1] == pytest.approx(np.average(drawn**2, weights=weights) * pull)
    with pytest.raises(ValueError, match=r"weights must be \(starts, 3\)"):
        with_weights(problem(), np.ones((2, 2)))


def test_what_a_problem_refuses():
    parts = (searched(), (group(0.25),))
    for terms, told in (
        ((), "at least one term"),
        ((Term("contour_rms_nm"),), "unknown column 'contour_rms_nm'; did you mean"),
        ((Term("contour_rms_um", -1.0),), "weight = -1 of contour_rms_um"),
        ((Term("contour_rms_um", scale=0.0),), "scale = 0 of contour_rms_um"),
    ):
        with pytest.raises(ValueError, match=told):
            make_problem(*parts, Objective(terms))
    with pytest.raises(ValueError, match=r"margin = 1: must be in 0\.\.1"):
        make_group("g", case(), {}, np.arange(1), margin=1.0)
    assert {"growth", "contour_smooth_max_um", "command_change_rms_A"} < set(
        available_columns(case())
    )


# --- methods -------------------------------------------------------------------------------


def tuned(method, budget=60.0, **more):
    return tune(problem(), method, budget=budget, cost_model=COST_MODEL, **more)


def test_every_method_improves_and_says_what_it_spent():
    for method in (
        levenberg_marquardt(),
        lbfgs(),
        first_order(),
        cma_es(),
        random_search(batch=8),
    ):
        found = tuned(method)
        assert found.before == pytest.approx(1.0) and found.after < 0.97, method.name
        assert found.feasible and found.method == method.name
        steps = found.history
        assert (
            steps[-1].simulations == pytest.approx(found.simulations) and found.simulations <= 60.0
        )
        assert found.simulations > 35 and not found.note
        assert all(a.best >= b.best for a, b in itertools.pairwise(steps))
        again = evaluate(problem(), found.z[None]).objective[0]
        assert again == pytest.approx(found.after, rel=1e-9)


def test_the_method_is_chosen_by_size_and_check():
    found, alone = tuned(None, budget=200.0), tuned(levenberg_marquardt(), budget=200.0)
    assert found.method == "lm" and found.check is not None and found.check.ok
    assert alone.simulations < 150 and alone.ended == "no start finds anything better"
    assert 190 < found.simulations <= 200, "CMA-ES goes on from where it ended"
    assert found.after <= alone.after < 0.97 and found.starts[0].objective == alone.after


def test_a_budget_below_a_jacobian_is_not_overrun():
    """CMA-ES searches in its place, and the result says so; nothing is asked beyond the budget."""
    dear = COST_MODEL._replace(gauss_newton=50.0, gradient=40.0)
    for method, name, least in ((None, "lm", 65), (lbfgs(), "lbfgs", 44)):
        budget = least - 1.0
        found = tune(problem(), method, budget=budget, cost_model=dear)
        assert found.method == "cma" and 0.8 * budget < found.simulations <= budget
        told = f"the first step of {name} costs {least} simulations, more than the budget"
        assert found.note == f"{told}: CMA-ES searched"
        assert found.after < found.before
    first = tune(problem(), lbfgs(), budget=44.0, cost_model=dear)
    assert first.method == "lbfgs" and first.simulations == 44 and first.after < first.before
    assert [step.simulations for step in first.history] == [40, 44], (
        "what the last step tried is told"
    )
    with pytest.raises(ValueError, match="budget = 17: must be >= 18 simulations"):
        tune(problem(), starts=2, budget=17.0, cost_model=dear)


def test_a_start_that_falls_behind_is_given_up():
    """What it would have cost goes to the others."""
    asked = []

    def begin(oracle, starts, seed):
        oracle.values(starts, np.arange(2))
        worse, none = np.array([1.0, 2.0]), np.full(2, np.nan)
        return RandomState(starts, seed, 0, starts, worse, none, np.zeros(2, bool))

    def step(oracle, state):
        active = np.flatnonzero(~state.done)
        oracle.values(state.z[active] + 0.01 * (len(asked) + 1), active)
        asked.append(active.tolist())
        return state

    both = np.stack([searched().start(), Z])
    idle = Method(name="idle", needs="", first=lambda cost_model, n: 2.0, begin=begin, step=step)
    found = tuned(idle, starts=both, budget=12.0)
    assert asked == [[0, 1]] * 2 + [[0]] * 6 and found.simulations == 12


def test_a_stopped_tuning_ends_the_same(tmp_path):
    """Half of the evaluations are lost, and a file is cut off: the rest is done again."""
    whole = tuned(levenberg_marquardt(), budget=80.0, log_folder=tmp_path, starts=2, seed=3)
    files = sorted(tmp_path.glob("*.npz"))
    assert len(files) > 6
    for file in files[len(files) // 2 + 1 :]:
        file.unlink()
    cut = files[len(files) // 2]
    cut.write_bytes(cut.read_bytes()[:100])
    again = tuned(levenberg_marquardt(), budget=80.0, log_folder=tmp_path, starts=2, seed=3)
    assert np.array_equal(whole.z, again.z) and whole.after == again.after
    assert [p.best for p in whole.history] == [p.best for p in again.history]
    assert sorted(tmp_path.glob("*.npz")) == files
    with pytest.raises(ValueError, match="holds the evaluations of another tuning"):
        tuned(levenberg_marquardt(), budget=80.0, log_folder=tmp_path, starts=2, seed=4)


def test_goals_are_met_before_anything_else():
    """Least contour error among what moves the command by less than 60 mA a period."""
    goals = parse_goals("command_change_rms_A < 0.06", available_columns(case()))
    bound = make_problem(searched(), (group(0.25),), Objective(TERMS[:1], goals), width=4)
    found = tune(bound, levenberg_marquardt(), budget=80.0, cost_model=COST_MODEL)
    assert found.feasible and found.after < 0.9
    change = evaluate(problem(), found.z[None]).columns["command_change_rms_A"]
    assert 0.058 < np.max(change) < 0.06, "the goal is what stops it"


def test_only_the_metrics_that_are_asked_for_run():
    one = selected(case().metric, ("contour",))
    first = jax.tree.map(lambda r: r[0], case().path.setpoint)
    assert set(one.init(first)) == {"contour"} == set(one.finish(one.init(first)))
    with pytest.raises(ValueError, match="no metric is called conture; there are"):
        selected(case().metric, ("conture",)).init(first)
