"""Any law on any plant with matching axes: finite, differentiable, batched."""

import inspect
from typing import Any, NamedTuple, get_origin

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstage.controllers
import jaxstage.plants
from jaxstage.controllers import (
    AdaptiveSliding,
    Both,
    Cascade,
    CmacSliding,
    Coupled,
    DisturbanceObserver,
    Gaussian,
    Limits,
    ModelReference,
    NonlinearSurface,
    Offset,
    Pd,
    Pi,
    PositionFeedforward,
    Rates,
    RigidAxis,
    Sliding,
    adaptive_sliding,
    cascade,
    cmac_sliding,
    cross_coupled,
    disturbance_observer,
    fuzzy_pid_contour,
    gaussian,
    model_reference,
    nonlinear_surface,
    pd,
    per_axis,
    pi,
    pid_contour,
    plus,
    position_feedforward,
    sliding,
)
from jaxstage.controllers.parts.damping import BoundedDamping
from jaxstage.controllers.parts.nominal import authority
from jaxstage.controllers.parts.reaching import FixedGain
from jaxstage.hardware.drives import ideal_drive
from jaxstage.hardware.loads import no_load
from jaxstage.hardware.sensors import ideal_sensor
from jaxstage.metrics import tracking
from jaxstage.model.blocks import Controller, Loop, Plant, Reference
from jaxstage.model.signals import Nearest, Scenario, Setpoint, Start
from jaxstage.numerics.smooth import SmoothWidth, smooth
from jaxstage.plants import pmlsm_stage, pmsm_table, screw_table, two_inertia
from jaxstage.simulate.rollout import start
from jaxstage.simulate.tick import tick
from jaxstage.studies.adaptive_smc import values as screw_values
from jaxstage.studies.fuzzy_ccc import values as stage_values
from jaxstage.studies.fuzzy_cmac.loops import nominal as table_axis
from jaxstage.studies.fuzzy_cmac.loops import plant as table
from jaxstage.studies.mrac_asmc import values as drive_values

DT, TICKS = 2e-4, 2


class Machine(NamedTuple):
    """A plant of two axes, its parameters and what a law may assume of it."""

    plant: Plant
    params: Any
    nominal: RigidAxis


def machine(plant, params, nominal):
    """The first two axes of published values; those of a single axis twice."""
    two = lambda tree: jax.tree.map(lambda x: np.resize(x, 2), tree)  # noqa: E731
    return Machine(plant, two(params), two(nominal))


MACHINES = {
    "pmsm_table": machine(pmsm_table(), table(), table_axis()),
    "pmlsm_stage": machine(pmlsm_stage(("x", "y")), stage_values.plant(), stage_values.nominal()),
    "screw_table": machine(screw_table(), screw_values.plain_friction(), screw_values.nominal()),
    "two_inertia": machine(two_inertia(("x", "y")), drive_values.plant(), drive_values.nominal()),
}


# --- gains by the nominal axis: poles of about 100 1/s ----------------------------------------


def _sliding(axis):
    return per_axis(sliding(smooth)), Sliding(
        slope=30.0, switching_gain=0.5, disturbance_bound=0.0,
        switch=SmoothWidth(width=5e-3), nominal=axis,
    )  # fmt: skip


def _cmac(axis):
    return per_axis(cmac_sliding(gaussian, smooth)), CmacSliding(
        slope=30.0, rate=(100.0 / authority(axis)) ** 2, credit=1.0, switching_gain=0.1,
        error_width=5e-3, rate_width=0.05, weights=np.zeros((4, 3, 3)),
        receptive=Gaussian(spacing=0.5, width=1.0), switch=SmoothWidth(width=5e-3), nominal=axis,
    )  # fmt: skip


def _pi(axis):
    return per_axis(pi), Pi(proportional_gain=100.0 / authority(axis), slope=30.0)


def _cascade(axis):
    return per_axis(cascade), Cascade(
        position_gain=30.0, velocity_gain=100.0, integral_gain=500.0, velocity_feedforward=1.0,
        acceleration_feedforward=1.0, friction_feedforward=1.0, load_feedforward=1.0,
        friction_width=1e-3, nominal=axis,
    )  # fmt: skip


def _pd(axis):
    return per_axis(pd), Pd(proportional_gain=3000.0, derivative_gain=130.0, nominal=axis)


def _surface(axis):
    return per_axis(nonlinear_surface(switch=smooth)), NonlinearSurface(
        slope=30.0, damping_slope=1.8, switching_gain=0.1,
        damping=BoundedDamping(final=10.0, speed=1e-3), reaching=FixedGain(start=80.0),
        switch=SmoothWidth(width=5e-3), nominal=axis,
    )  # fmt: skip


def _adaptive(axis):
    return per_axis(adaptive_sliding()), AdaptiveSliding(
        slope=30.0, slope_rate=1e4, slope_least=1.0, slope_most=100.0, switching_gain=0.2,
        switching_rate=500.0, switching_least=0.0, switching_most=1.0, sharpness=500.0,
        sharpness_rate=1e6, sharpness_least=1.0, sharpness_most=1e3, nominal=axis,
    )  # fmt: skip


def _observed(axis):
    law, gains = _pd(axis)
    watching = DisturbanceObserver(disturbance_gain=1e4, velocity_gain=200.0, nominal=axis)
    return plus(law, per_axis(disturbance_observer)), Both(law=gains, extra=watching)


def _reference(axis):
    law, gains = _cmac(axis)
    return model_reference(law), ModelReference(
        law=gains, model_rate=50.0, dry_width=1e-3, leak=0.0,
        rates=Rates(input=0.0, viscous=20.0, dry=1.0, constant=1.0),
        limits=Limits(input=0.5, viscous=10.0, dry=1.0, constant=1.0), nominal=axis,
    )  # fmt: skip


def _ahead(axis):
    law, gains = _cascade(axis)
    return position_feedforward(law), Offset(law=gains, offset=PositionFeedforward(amplitude=2e-6))


def _coupled(extra, extra_gains):
    def of(axis):
        law, gains = _cmac(axis)
        return cross_coupled(law, extra), Coupled(
            law=gains, extra=extra_gains(), command_per_acceleration=1 / authority(axis)
        )

    return of


LAWS = {
    "sliding": _sliding,
    "cmac_sliding": _cmac,
    "pi": _pi,
    "cascade": _cascade,
    "pd": _pd,
    "nonlinear_surface": _surface,
    "adaptive_sliding": _adaptive,
    "disturbance_observer": _observed,
    "model_reference": _reference,
    "position_feedforward": _ahead,
    "pid_contour": _coupled(pid_contour(), stage_values.pid_gains),
    "fuzzy_pid_contour": _coupled(fuzzy_pid_contour(), stage_values.fuzzy_gains),
}


def _swing(params, tick):
    phase = 20.0 * DT * tick + jnp.arange(2.0)
    return Setpoint(
        position=params * jnp.sin(phase),
        velocity=20 * params * jnp.cos(phase),
        acceleration=-400 * params * jnp.sin(phase),
        tangent=jnp.array([0.6, 0.8]),
        curvature=jnp.zeros(()),
    )


def _at_command(params, tick, tool):
    return Nearest(point=tool, distance=tool[0], arc=tool[0], reach=tool[0])


#: 2 mm to and fro
SWING = Reference(name="swing", sample=_swing, nearest=_at_command, period=lambda params: DT)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", MACHINES)
def test_any_law_on_any_plant(name, law):
    """Two runs of a few ticks in one batch with the derivative along all gains, uncompiled: a
    compiled program for each pair would cost a minute more, and the ticks are those of a run."""
    plant, params, nominal = MACHINES[name]
    controller, gains = LAWS[law](nominal)
    gains = jax.tree.map(jnp.asarray, gains)
    loop = Loop(
        plant=plant, controller=controller, reference=SWING, load=no_load, sensor=ideal_sensor,
        drive=ideal_drive, metric=tracking, dt=DT,
    )  # fmt: skip
    amplitude = jnp.asarray(2e-3)

    def errors(gains, offset):
        scene = Scenario(
            plant=jax.tree.map(jnp.asarray, params), load=(), sensor=(), drive=(),
            start=Start(offset=offset * jnp.ones(2), velocity=jnp.ones(2)),
            key=jax.random.key(0),
        )  # fmt: skip
        carry = begun = start(loop, gains, scene, amplitude)
        for _ in range(TICKS):
            carry, _ = tick(loop, gains, scene, amplitude, carry)
        assert _kinds(carry) == _kinds(begun), "a scan would not accept it"
        return tracking.finish(carry.metric).ate, carry.memory

    def along(offset):
        return jax.jvp(lambda g: errors(g, offset), (gains,), (jax.tree.map(_move, gains),))

    with jax.disable_jit():
        values, slopes = jax.vmap(along)(jnp.asarray([1e-5, 3e-5]))
    for tree in (values, slopes):
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(tree))
    assert values[0][0] != values[0][1] and (values[0] < 1e-3).all() and (slopes[0] != 0).all()


def _move(x):
    return 0.01 * x + 1e-3


def _kinds(tree):
    return jax.tree.structure(tree), [(x.shape, x.dtype) for x in jax.tree.leaves(tree)]


def _made(package, kind):
    """Public names of a package that are, or whose call gives, a definition of a kind."""
    found = set()
    for name, value in vars(package).items():
        maker = inspect.unwrap(value) if callable(value) else None
        annotation = (
            inspect.signature(maker).return_annotation if inspect.isfunction(maker) else None
        )
        returned = get_origin(annotation) or annotation
        if not name.startswith("_") and (isinstance(value, kind) or returned is kind):
            found.add(name)
    return found


@pytest.mark.fast
def test_every_public_plant_and_law_is_in_the_matrix():
    assert _made(jaxstage.plants, Plant) == set(MACHINES)
    compositions = {"per_axis", "plus", "cross_coupled", "offset_setpoint"}
    assert _made(jaxstage.controllers, Controller) - compositions == set(LAWS)
