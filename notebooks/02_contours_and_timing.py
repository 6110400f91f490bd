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
# # Contours and timing
#
# What a tool is asked to do is a curve and a timing. The curve alone fixes where the axes reverse
# and where the tool must turn a corner; the timing fixes how fast. This notebook looks at the four
# published contours, drives one of them in two ways, and ends with sliders.

# %%
import time

import ipywidgets
import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxstage as js
from jaxstage import references as ref
from jaxstage.metrics import contour

# %matplotlib inline

js.configure(precision="double")

# %% tags=["parameters"]
FEEDS = (1000.0, 2000.0, 4000.0, 8000.0)  # mm/min

# %% [markdown]
# ## Four curves
#
# All are NURBS. Circle and bowknot are smooth; heart and star have corners, which no machine can
# follow at constant feed without an error.

# %%
CURVES = {"circle": ref.circle, "bowknot": ref.bowknot, "heart": ref.heart, "star": ref.star}


def draw(ax, name):
    path = ref.make_path(CURVES[name](), ref.uniform_parameter(1.0, 1e-3))
    ax.plot(*(1e3 * np.asarray(path.setpoint.position).T))
    ax.set(title=f"{name}, {1e3 * float(path.length):.0f} mm", xlabel="x (mm)", aspect="equal")


figure, panels = plt.subplots(1, 4, figsize=(15, 4), layout="constrained")
for panel, name in zip(panels, CURVES, strict=True):
    draw(panel, name)

# %% [markdown]
# ## Two timings
#
# The papers run through the curve's parameter at a constant rate: the feed then depends on how the
# curve was written down. A machine runs at a constant feed. Both take the same time here; only the
# feed along the way differs. The curvature says what the corner costs.

# %%
uniform = ref.make_path(ref.heart(), ref.uniform_parameter(1.0, 1e-3))
steady = ref.make_path(ref.heart(), ref.constant_feed(6e4 * float(uniform.length), 1e-3))

figure, ax = plt.subplots(figsize=(10, 3.5), layout="constrained")
for path, label in ((uniform, "uniform parameter"), (steady, "constant feed")):
    speed = np.linalg.norm(np.asarray(path.setpoint.velocity), axis=1)
    ax.plot(np.linspace(0, 1, len(speed)), 6e4 * speed, label=label)
ax.set(xlabel="time (s)", ylabel="feed (mm/min)", title="heart, one lap in 1 s")
ax.legend()

# %% [markdown]
# ## Faster costs accuracy
#
# The industrial cascade on the heart at growing feed, first lap. Its feed-forward knows the machine
# exactly, so what is left comes from the corners and from dry friction at the reversals.


# %%
def worst(feed):
    case = js.build("cascade-heart", js.Timing(feed=feed, laps=1))
    run = js.with_metric(case, contour).simulate()
    return 1e6 * float(run.report.contour_max)


for feed in FEEDS:
    print(f"{feed:6.0f} mm/min: largest contour error {worst(feed):8.1f} um")

# %% [markdown]
# ## Turn the gains yourself
#
# One lap of the circle in one second, 10 000 control periods, under the direct fuzzy CMAC. The loop
# is compiled once; each move of a slider simulates the lap again, in under a tenth of a second.

# %%
case = js.build("dfcmac-circle", js.Timing(lap_time=1.0, laps=1))
trace = js.Metric(
    name="trace",
    init=lambda setpoint: (),
    update=lambda acc, sample, dt: (acc, 1e6 * sample.nearest.distance),
    finish=lambda acc: None,
)
loop = js.replace(case.loop, metric=trace)


def lap(slope, mass):
    gains = js.replace(case.gains, slope=np.full(2, slope))
    plant = js.replace(case.scenario.plant, mass=mass * case.scenario.plant.mass)
    scenario = js.replace(case.scenario, plant=plant)
    run = js.simulate(loop, gains, scenario, case.path, case.window.ticks)
    return jax.block_until_ready(run.rows)


lap(1.0, 1.0)  # compiles
begin = time.process_time()
lap(2.0, 1.1)
print(f"one lap again: {time.process_time() - begin:.3f} s of processor time")


# %%
def show(slope, mass):
    ax = plt.figure(figsize=(10, 3.5), layout="constrained").add_subplot()
    ax.plot(np.arange(case.window.ticks) * case.loop.dt, lap(slope, mass))
    ax.set(xlabel="time (s)", ylabel="contour error (um)", ylim=(0, 150))
    plt.show()


ipywidgets.interact(
    show,
    slope=ipywidgets.FloatLogSlider(1.0, min=-1, max=2, description="c1 (1/s)"),
    mass=ipywidgets.FloatSlider(1.0, min=0.5, max=2.0, description="true mass"),
)
