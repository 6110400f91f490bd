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
#

# %% [markdown]
# # Robustness by Monte-Carlo
#
# A law that is good on the nominal machine may be poor on the next one of the series. We draw many
# machines, run three laws on the same machines, and ask how many meet a specification, with an
# interval that says how sure the answer is.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import jaxstage as js
from tuning.sweeps import replays, store
from tuning.sweeps.analysis import Question, analyse
from tuning.sweeps.configuration import SweepRequest, build, configure_sweep
from tuning.sweeps.pictures import plots
from tuning.sweeps.sweep import sweep

# %matplotlib inline

js.configure(precision="double")

# %% tags=["parameters"]
PLANTS = 256
LOOPS = ("cmac-circle", "dfcmac-circle", "cascade-circle")
TIMING = ("lap_time=1", "laps=1")

# %% [markdown]
# ## What is uncertain
#
# Each study says how uncertain its machine is: factors on the nominal values, each with a reason.
# A scenario file of your own would take their place.

# %%
text = configure_sweep(SweepRequest(loops=LOOPS, runs=PLANTS, words=TIMING))
plan = build(text)
for item in plan.spaces[0].uncertain:
    print(f"{item.path:22s} {item.distribution.low:.2f} to {item.distribution.high:.2f}")

# %% [markdown]
# ## The sweep
#
# The text above is all that a run depends on: run *i* is drawn from the seed and *i* alone. Results
# are kept as Parquet, one row a run; what a stopped sweep lacks is done by the next call.

# %%
folder = Path(tempfile.mkdtemp()) / "swept"
store.create(folder, text, resume=False)
print(sweep(text, folder), "runs simulated")

# %% [markdown]
# ## The answer
#
# The yield has an exact 95 % interval; more plants narrow it. The comparison is made on the *same*
# plants, so that it is much sharper than two separate means would be.

# %%
found = analyse(folder, plan, Question("contour_max_um < 75 and finite"))
for loop in found.loops:
    share = loop.met
    print(f"{loop.name:15s} yield {share.value:.1%} ({share.low:.1%} to {share.high:.1%})")
for pair in found.comparisons:
    print(f"{pair.first} is better than {pair.second} on {pair.better.value:.0%} of the plants")

# %%
pictures = plots(found)
pictures["distribution"]

# %% [markdown]
# ## Which value matters
#
# Each panel is one uncertain value against the metric; plants that fail are marked. A slope says
# that the value matters, a cloud that it does not.

# %%
pictures[f"{LOOPS[0]}-parameters"]

# %% [markdown]
# ## The worst plant again
#
# Any plant can be drawn again from its number, bit for bit.

# %%
worst = replays.RunSelection(worst=1, loop=LOOPS[0], metric=found.metric)
(number, ids), *_ = replays.select_runs(folder, plan, worst)
(again,) = replays.replay(folder, plan, number, ids)
print(f"run {again['run']}: {again['figures']['contour_max_um']:.1f} um", again["identical"])
for name, value in again["parameters"].items():
    print(f"  {name:32s} {value:.4g}")

# %%
plt.close("all")
