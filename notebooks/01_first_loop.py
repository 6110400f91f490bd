# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3 (ipykernel)
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A first loop
#
# An XY stage with two permanent-magnet motors follows a circle of 25 mm radius, one lap in 5 s.
# Each axis is controlled by a direct fuzzy CMAC sliding-mode law: it knows nothing about friction,
# and learns the motor current it needs while it runs (Mao et al., Energies 2021, 14, 7802).
# We simulate two laps, look at them, and then ask what the slope of the sliding surface does.

# %%
import jax
import jax.numpy as jnp

import jaxstage as js
from jaxstage import plot
from jaxstage.metrics import contour, record, together
from jaxstage.studies import with_scored_metric

# %matplotlib inline

js.configure(precision="double")

# %% [markdown]
# A *case* is everything a simulation needs: the loop (what is fixed), the gains (what is tuned),
# the scenario (what is uncertain) and the path (what is asked). Metrics are kept while the loop
# runs; `record` in addition stores every tick, for the pictures.

# %%
case = js.build("dfcmac-circle")
run = js.with_metric(case, together(case.loop.metric, record)).simulate()
scored = run.report["scored"]
print(f"contour error {scored['contour'].contour_rms * 1e6:.1f} um RMS on the second lap")

# %% [markdown]
# ## The contour
#
# The error is a thousandth of the circle, so it is drawn magnified: from each point of the
# reference, the blue line stands off by the contour error times the factor in the title. The four
# steps are *quadrant glitches*. Where an axis reverses, dry friction holds it while the law
# learns the new sign of the friction; the other axis moves on, and the tool leaves the circle.

# %%
shown = plot.view(case, scored, run.rows["record"])
plot.contour(shown)

# %% [markdown]
# ## The axes
#
# Below each position stands its following error, reference minus actual. After a reversal the
# error jumps by about 44 um in x and 34 um in y, and then decays as exp(-t): on the sliding
# surface s = -(c1 e + e') = 0 the error has the time constant 1/c1, here 1 s.

# %%
plot.axes(shown)

# %% [markdown]
# ## The sliding surface
#
# Left: the sliding variable is zero except for some 100 ms after each reversal, where it rings.
# Right: the same in the phase plane. The error leaves the dashed line s = 0 in an arc while the
# axis sticks, rings around the line, and slides back along it.

# %%
plot.surface(shown)

# %% [markdown]
# ## Many loops at once
#
# A steeper surface brings the error back faster. The simulation is an ordinary function of its
# gains, so `jax.vmap` runs it for several slopes c1 in one go. Only the contour error is asked for:
# metrics that nobody reads cost time.


# %%
light = with_scored_metric(case, together(contour))


def contour_rms(slope: jax.Array) -> jax.Array:
    gains = js.replace(light.gains, slope=jnp.full(2, slope))
    run = js.simulate(light.loop, gains, light.scenario, light.path, light.window.ticks)
    return run.report["contour"].contour_rms


slopes = jnp.array([0.5, 1.0, 5.0, 20.0])
for slope, rms in zip(slopes, jax.vmap(contour_rms)(slopes), strict=True):
    print(f"c1 = {slope:4.1f} 1/s: contour error {rms * 1e6:5.1f} um RMS")

# %% [markdown]
# Steeper is better here, but a slope of 0.5 1/s is not worse than 1: what is left of the error when
# an axis reverses again has the opposite sign of the new jump, and takes a part off it.
