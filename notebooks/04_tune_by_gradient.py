# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#       jupytext_version: 1.19.6
#   kernelspec:
#     display_name: Python 3 (ipykernel)
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Tune by gradient
#
# How far the tool leaves its path is a differentiable function of the gains. This notebook puts the
# slope of that function next to differences of simulations, follows a search over the map of two
# gains, and looks at the machine before and after. `jaxstage tune` does the same with all gains,
# and then tests the result on plants that the search never saw.

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxstage as js
from jaxstage import plot
from jaxstage.plot import tuning as pictures
from tuning.tuner.baselines import convergence_curve
from tuning.tuner.pictures import simulate_before_after
from tuning.tuner.problem.objective import Objective, Term
from tuning.tuner.problem.problem import evaluate, gauss_newton_model, make_problem
from tuning.tuner.problem.run_group import make_group
from tuning.tuner.problem.search_space import Search, default_searches, search_space
from tuning.tuner.search.cma_es import cma_es
from tuning.tuner.search.levenberg_marquardt import levenberg_marquardt
from tuning.tuner.search.optimise import tune
from tuning.uncertainty.uncertain_space import draw, space, study_spreads

# %matplotlib inline

js.configure(precision="double")

# %% tags=["parameters"]
LOOP, GAINS = "dfcmac-circle", ("slope", "rate")
SECONDS, PLANTS = 1.0, 4
GRID, BUDGET = 21, 1200.0

# %% [markdown]
# ## The question
#
# The stage of the first notebook, one lap of the circle in one second, on four plants within the
# spreads of the study. Two numbers are free: the slope of the sliding surface and the rate at which
# the law learns, each the same on both axes. Minimised is the mean square of the contour error over
# all plants, and a tenth of that of the changes of the current; the gains before count as 1.

# %%
case = js.build(LOOP, js.Timing(lap_time=1.0, duration=SECONDS, scored=0))
plants = draw(space(case, study_spreads(LOOP), ()), "sobol", 0, PLANTS, 0, PLANTS)
group = make_group("circle", case, plants, np.arange(PLANTS))
boxes = [one for one in default_searches(case) if one.name.rpartition(".")[2] in GAINS]
searched = search_space(case, [Search(b.name, b.low, b.high, tied=True) for b in boxes])
terms = (Term("contour_rms_um"), Term("command_change_rms_A", 0.1))
problem = make_problem(searched, (group,), Objective(terms))
for entry in searched.entries:
    print(f"{entry.path:28s} {entry.before[0]:g} {entry.unit}, {entry.low[0]:g}..{entry.high[0]:g}")

# %% [markdown]
# Inside, each gain is a number z without bounds: a step in z is a ratio of the gain, and the box
# cannot be left.
#
# ## The slope, and what differences say
#
# Central differences need two simulations for each gain, and a step: too large a step cuts the
# corner, too small a one sees rounding and the small jumps of friction that lets go one control
# period later. The derivative of the simulation needs no step.

# %%
here = searched.start()
along = np.array([1.0, 0.0])
exact = gauss_newton_model(problem, here[None])
slope = exact.gradient[0] @ along
print(f"derivative of the simulation: {slope:.6f}")
for step in 10.0 ** -np.arange(0, 7):
    ends = evaluate(problem, here + step * np.stack([along, -along])).objective
    found = (ends[0] - ends[1]) / (2 * step)
    print(f"differences, step {step:7.0e}: {found:.6f}, off by {abs(found / slope - 1):.1e}")

# %% [markdown]
# ## Why so few steps are enough
#
# The objective is a sum of squares: of the error in each piece of each run. The derivative of
# every piece is there, so that not only the slope of the sum is known but, by Gauss-Newton, its
# curvature, too: the parabola below was drawn from one point alone. Its minimum is where the search
# goes next, as far as it trusts the parabola.

# %%
places = np.linspace(-1.5, 1.5, 31)
real = evaluate(problem, here + places[:, None] * along).objective
bend = along @ exact.gauss_newton[0] @ along
tangent = exact.objective[0] + slope * places
figure, ax = plt.subplots(figsize=(9, 4.5), layout="constrained")
ax.plot(places, real, "k", linewidth=2, label="simulated")
ax.plot(places, tangent, "--", label="slope")
ax.plot(places, tangent + bend * places**2 / 2, label="slope and Gauss-Newton curvature")
ax.set(xlabel=f"{GAINS[0]}: z from where it is", ylabel="objective", ylim=(0, 1.6 * real.max()))
ax.legend()

# %% [markdown]
# ## The search
#
# Levenberg-Marquardt from the gains before. One simulation counts all plants, in compiled
# code; derivatives are charged what they cost here, which is many of those.

# %%
steps = []
tuned = tune(problem, levenberg_marquardt(), budget=BUDGET, watch=steps.append)
print(f"a derivative in both gains: {tuned.cost_model.gauss_newton:.0f} simulations")
for step in steps[:: max(1, len(steps) // 8)]:
    print(f"{step.simulations:5.1f} simulations: objective {step.best:.4f}")
print(f"{tuned.before:.3f} -> {tuned.after:.4f}, {tuned.ended}")


# %% [markdown]
# The map was paid for by simulating every point of it, which two gains allow and ten do not.


# %%
def values(z):
    pairs = zip(searched.entries, z.T, strict=True)
    return [np.asarray(jax.vmap(e.value_of)(column[:, None]))[:, 0] for e, column in pairs]


path = np.stack([here, *(step.z for step in steps)])
low, high = path.min(axis=0) - 1.0, path.max(axis=0) + 1.0
sides = np.linspace(low, high, GRID).T
grid = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
found = evaluate(problem, grid)
heights = np.where(np.isfinite(found.lost_at_s).any(axis=1), np.nan, found.objective)

# %%
figure, ax = plt.subplots(figsize=(9, 6.5), layout="constrained")
shape = (GRID, GRID)
axes = [column.reshape(shape) for column in values(grid)]
drawn = ax.contourf(*axes, np.log10(heights.reshape(shape)), 24, cmap="cividis")
figure.colorbar(drawn, label="log10 of the objective; white: a plant is lost")
ax.plot(*values(path), "o-", color="#D55E00", label="the search")
labels = [f"{e.symbol} ({e.unit})" for e in searched.entries]
ax.set(xscale="log", yscale="log", xlabel=labels[0], ylabel=labels[1])
ax.legend()

# %% [markdown]
# ## Without gradients
#
# CMA-ES asks for values only. With two gains it is the cheaper one: a value is compiled code here,
# a derivative is not yet. What it needs grows with the number of gains; `jaxstage tune LOOP
# --baseline cma` puts it beside the search on your own problem, at equal cost.

# %%
other = tune(problem, cma_es(), budget=BUDGET)
traces = [pictures.Trace(*convergence_curve(one)) for one in (tuned, other)]
pictures.history(traces, f"{LOOP}, {PLANTS} plants, seed 0")

# %% [markdown]
# ## Before and after
#
# The nominal machine under both gains. What is left is friction: while an axis stands, no law can
# do anything about it.

# %%
pair = simulate_before_after(case, case.gains, tuned.gains, recorded=True)


def shown(case, run):
    return plot.view(case, run.report["scored"], run.rows["record"])


pictures.before_after(shown(pair.before, pair.runs[0]), shown(pair.after, pair.runs[1]))

# %%
plt.close("all")
