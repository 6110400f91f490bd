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
# # Write your own controller
#
# A control law is two functions and two classes. Here is a super-twisting sliding mode, a law that
# the library does not have: it pushes with a root of the sliding variable, and an integral of its
# sign learns the disturbance. We write it in one cell, put it through the battery that every law of
# the library passes, and run it beside an industrial cascade.

# %%
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from jax import Array

import jaxstage as js
from jaxstage.controllers import RigidAxis, per_axis
from jaxstage.controllers.parts.nominal import authority, drift
from jaxstage.metrics import contour
from jaxstage.model.fields import gain, part, pytree, signal
from jaxstage.testing import check_controller

# %matplotlib inline

js.configure(precision="double")

# %% tags=["parameters"]
LAP_TIME = 1.0  # s

# %% [markdown]
# ## The law
#
#     e = r - y,   s = e' + c e
#     u = (1/b) (r'' + c e' + k1 phi(s) + I - f),   I' = k2 s / sqrt(s^2 + w^2)
#     phi(s) = (s/w) / ((s/w)^2 + 1)^(1/4)
#
# As published, phi(s) is the root of |s| with the sign of s, and I' the bare sign. Both are rounded
# here within the width w: a root has no slope at zero, and a sampled sign chatters. What is tuned
# is a `gain`, what the law assumes about its axis a `part`, what it remembers a `signal`, each with
# its unit.


# %%
@pytree
class Twisting:
    slope: Array = gain("1/s", "c", "slope of the sliding surface", above=0.0)
    push: Array = gain("m/s2", "k1", "root term at s = w", low=0.0)
    learning: Array = gain("m/s3", "k2", "rate of the integral", low=0.0)
    width: Array = gain("m/s", "w", "width of the rounding", above=0.0)
    nominal: RigidAxis = part("what the law assumes about the axis")


@pytree
class Learned:
    integral: Array = signal("m/s2", "I", "disturbance that the law has learned")


def init(gains, setpoint, measurement):
    return Learned(integral=jnp.zeros_like(setpoint.position))


def control(gains, memory, setpoint, measurement, dt):
    error = setpoint.position - measurement.position
    rate = setpoint.velocity - measurement.velocity
    ratio = (rate + gains.slope * error) / gains.width
    integral = memory.integral + dt * gains.learning * ratio / jnp.sqrt(ratio**2 + 1)
    pushed = gains.push * ratio / (ratio**2 + 1) ** 0.25 + integral
    wanted = setpoint.acceleration + gains.slope * rate + pushed
    demand = (wanted - drift(gains.nominal, measurement.velocity)) / authority(gains.nominal)
    return demand, Learned(integral=integral)


twisting = per_axis(js.Controller(name="twisting", init=init, control=control))

# %% [markdown]
# ## The battery
#
# Memory that keeps its kind, finite commands at rest and far off, the same numbers compiled and in
# batches, gradients that agree with differences, gains that survive a file.

# %%
cascade = js.build("cascade-circle", js.Timing(lap_time=LAP_TIME, laps=1))
two = np.ones(2)
gains = Twisting(
    slope=200 * two,
    push=100 * two,
    learning=4e4 * two,
    width=0.02 * two,
    nominal=cascade.gains.nominal,
)
checks = check_controller(twisting, gains)
print("\n".join(check.text() for check in checks))
assert all(check.passed for check in checks)

# %% [markdown]
# It can fail, too. The root as published has an infinite slope at s = 0:


# %%
def bare(gains, memory, setpoint, measurement, dt):
    surface = setpoint.velocity - measurement.velocity
    return gains.push * jnp.sign(surface) * jnp.sqrt(jnp.abs(surface)), memory


for check in check_controller(per_axis(js.Controller(name="bare", init=init, control=bare)), gains):
    if not check.passed:
        print(check.text())

# %% [markdown]
# ## On the machine
#
# The published table with dry friction that sticks, one lap of the circle. The cascade knows the
# friction exactly and feeds it forward at each reversal; the new law has to learn it.


# %%
trace = js.Metric(
    name="trace",
    init=lambda setpoint: (),
    update=lambda acc, sample, dt: (acc, 1e6 * sample.nearest.distance),
    finish=lambda acc: None,
)


def lap(law, gains):
    loop = js.replace(cascade.loop, controller=law, metric=js.together(contour, trace))
    ticks = cascade.window.ticks
    run = js.simulate(loop, gains, cascade.scenario, cascade.path, ticks)
    rms = 1e6 * float(run.report["contour"].contour_rms)
    return rms, np.asarray(run.rows["trace"])


figure, ax = plt.subplots(figsize=(12, 5), layout="constrained")
for name, law, values in (
    ("cascade", cascade.loop.controller, cascade.gains),
    ("super-twisting", twisting, gains),
):
    rms, error = lap(law, values)
    ax.semilogy(np.arange(len(error)) * cascade.loop.dt, error, label=f"{name}: {rms:.2f} um RMS")
ax.set(xlabel="time (s)", ylabel="contour error (um)", ylim=(1e-3, 1e3), title="circle")
ax.legend()

# %% [markdown]
# To make the law known to every command, put the cell into a file with a `Study` and name it in
# `JAXSTAGE_STUDIES`: the documentation has it in full ("Add a controller").
