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
# # Fuzzy rules, before and after
#
# The adaptive fuzzy PID law couples the axes of a three-axis stage: 147 rules look at the contour
# error and its rate and say how hard the coupling should push. They are written down by an expert's
# rule of thumb, the same for any machine. Rules are numbers, the simulation has a slope in each of
# them, and so they can be tuned like any other gain. This notebook does it, and asks what changed.

# %%
import matplotlib.pyplot as plt
import numpy as np

import jaxstage as js
from jaxstage import plot
from jaxstage.controllers.fuzzy_rules import fuzzy_laws
from jaxstage.plot import tuning as pictures
from tuning.tuner.pictures import rules_text, simulate_before_after
from tuning.tuner.problem.objective import Objective, Term
from tuning.tuner.problem.problem import make_problem
from tuning.tuner.problem.run_group import make_group
from tuning.tuner.problem.search_space import Search, search_space
from tuning.tuner.search.lbfgs import lbfgs
from tuning.tuner.search.optimise import tune
from tuning.uncertainty.uncertain_space import draw, space, study_spreads

# %matplotlib inline

js.configure(precision="double")

# %% tags=["parameters"]
SECONDS, PLANTS = 2.0, 3
METHOD, BUDGET = lbfgs(), 3000.0

# %% [markdown]
# ## The rules
#
# Each table below is one gain of the coupling: rows are sets of the contour error, columns sets of
# its rate, from negative big to positive big. The contour error is a distance, so only the upper
# rows ever fire.

# %%
case = js.build("af-pid-ccc", js.Timing(lap_time=10.0, duration=SECONDS, scored=0))
(law,) = fuzzy_laws(case.gains)
plot.memberships(law.error_sets, "contour error, X1")

# %%
SHOWN = {"proportional": "K_P in 1/s2", "derivative": "K_D in 1/s"}


def surface(law, field, when):
    rules = getattr(law.rules, field)
    return plot.rule_surface(law.error_sets, law.rate_sets, rules, f"{SHOWN[field]}, {when}")


surface(law, "proportional", "before")

# %% [markdown]
# ## Tuning them
#
# All consequents at once, on some plants within the spreads of the study; a helix with a load that
# swings. The price on the command keeps the coupling from buying the last micrometre with noise.
# With so many numbers the gradient comes from reverse mode: one pass back through the whole run
# gives the slope in every rule.

# %%
plants = draw(space(case, study_spreads(case.name), ()), "sobol", 0, PLANTS, 0, PLANTS)
group = make_group("helix", case, plants, np.arange(PLANTS))
searched = search_space(case, [Search("rules")])
terms = (Term("contour_rms_um"), Term("command_change_rms_A", 0.1))
problem = make_problem(searched, (group,), Objective(terms))
tuned = tune(problem, METHOD, budget=BUDGET)
print(f"{searched.size} rules: objective {tuned.before:.3f} -> {tuned.after:.4f} ({tuned.ended})")

# %% [markdown]
# ## The machine, before and after

# %%
pair = simulate_before_after(case, case.gains, tuned.gains, recorded=True)
for name in ("contour_rms_um", "contour_max_um", "energy_J"):
    before, after = (metrics[name] for metrics in pair.metrics())
    print(f"{name:16s} {before:9.4g} -> {after:9.4g}")


# %%
def shown(case, run):
    return plot.view(case, run.report["scored"], run.rows["record"])


pictures.before_after(shown(pair.before, pair.runs[0]), shown(pair.after, pair.runs[1]))

# %% [markdown]
# ## The rules afterwards
#
# The same table, tuned. A rule that never fires has no slope and stays where it was: what moved is
# what this machine on this motion uses.

# %%
(after,) = fuzzy_laws(tuned.gains)
surface(after, "proportional", "after")

# %%
surface(after, "derivative", "after")

# %%
figure, panels = plt.subplots(1, 2, figsize=(12, 5), layout="constrained")
for ax, (field, text) in zip(panels, SHOWN.items(), strict=True):
    ratio = getattr(after.rules, field) / getattr(law.rules, field)
    drawn = ax.imshow(np.log2(ratio), cmap="coolwarm", vmin=-3, vmax=3)
    ax.set(title=text, xlabel="set of the rate", ylabel="set of the contour error")
    figure.colorbar(drawn, label="doublings")

# %% [markdown]
# In words, as `jaxstage run` and `jaxstage tune` write them to `rules.txt`; "at the end" is what
# the law went on to learn while it ran.

# %%
print(rules_text(pair))

# %%
plt.close("all")
