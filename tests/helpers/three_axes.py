"""A stage of three axes on a helix, under a composed law: nothing of the published system."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.controllers import (
    Both,
    Coupled,
    DisturbanceObserver,
    PidContour,
    RigidAxis,
    Sliding,
    cross_coupled,
    disturbance_observer,
    per_axis,
    pid_contour,
    plus,
    sliding,
)
from jaxstage.hardware.drives import CurrentDrive, current_drive
from jaxstage.hardware.loads import SineLoad, sine_load
from jaxstage.hardware.sensors import Encoder, encoder
from jaxstage.metrics import tracking
from jaxstage.model.blocks import Loop
from jaxstage.model.fields import replace
from jaxstage.model.signals import Scenario, Start
from jaxstage.numerics.smooth import SmoothWidth, smooth
from jaxstage.plants import PmlsmStage, pmlsm_stage
from jaxstage.references import analytic

DT = 2e-4


def _helix(params, time):
    angle = params["rate"] * time
    r = params["radius"]
    return jnp.stack([r * jnp.cos(angle), r * jnp.sin(angle), params["climb"] * time])


HELIX = analytic("helix", _helix, DT)
PATH = {"radius": jnp.asarray(0.05), "rate": jnp.asarray(4 * np.pi), "climb": jnp.asarray(0.01)}
MASS, DAMPING, FORCE = np.array([12.0, 8, 5]), np.array([10.0, 8, 12]), np.array([50.0, 50, 40])
LOAD = np.array([20.0, -15.0, 10.0])


def plant_params():
    return PmlsmStage(mass=MASS, damping=DAMPING, force_constant=FORCE, resistance=np.zeros(3))


def gains(stiffness=1000.0):
    nominal = RigidAxis(
        force_constant=FORCE, mass=MASS, damping=DAMPING, coulomb=np.zeros(3), load=np.zeros(3)
    )
    law = Sliding(
        slope=np.array([10.0, 12, 15]),
        switching_gain=np.full(3, 0.5),
        disturbance_bound=np.zeros(3),
        switch=SmoothWidth(width=np.full(3, 5e-3)),
        nominal=nominal,
    )
    watch = DisturbanceObserver(
        disturbance_gain=np.full(3, 250e3), velocity_gain=np.full(3, 1e3), nominal=nominal
    )
    contour = PidContour(
        proportional_gain=stiffness, integral_gain=0.0, derivative_gain=0.0, rest_speed=1e-6,
        form=(),
    )  # fmt: skip
    return Coupled(
        law=Both(law=law, extra=watch),
        extra=contour,
        command_per_acceleration=MASS / FORCE,
    )


LAW = cross_coupled(plus(per_axis(sliding(smooth)), per_axis(disturbance_observer)), pid_contour())


def scenario(limit=10.0, delay=0.0, lag=0.0, amplitude=0.0, resolution=1e-8):
    return Scenario(
        plant=plant_params(),
        load=SineLoad(
            amplitude=np.full(3, amplitude), frequency=np.array([3.0, 2, 1.5]),
            phase=np.zeros(3), bias=LOAD,
        ),
        sensor=Encoder(resolution=resolution, bandwidth=np.inf),
        drive=CurrentDrive(limit=np.full(3, limit), delay=delay, lag=lag),
        start=Start(offset=np.array([-1e-4, 0, -5e-5]), velocity=np.ones(3)),
        key=jax.random.key(3),
    )  # fmt: skip


def loop(metric=tracking, controller=LAW, **changes):
    base = Loop(
        plant=pmlsm_stage(),
        controller=controller,
        reference=HELIX,
        load=sine_load,
        sensor=encoder,
        drive=current_drive(3),
        metric=metric,
        dt=DT,
        substeps=2,
    )
    return replace(base, **changes)


def currents(sample):
    return sample.demand, sample.command, sample.applied


def watched(sample):
    return currents(sample), sample.output, sample.measurement
