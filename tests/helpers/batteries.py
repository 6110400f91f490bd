"""Batteries: the laws under test, and a bench for one control period."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.controllers import (
    Both,
    Coupled,
    DisturbanceObserver,
    Offset,
    Pd,
    Rates,
    adaptive_sliding,
    cascade,
    cmac_sliding,
    crisp,
    cross_coupled,
    difference,
    disturbance_observer,
    fuzzy_pid_contour,
    gaussian,
    model_reference,
    nonlinear_surface,
    offset_setpoint,
    pd,
    per_axis,
    pi,
    pid_contour,
    plus,
    position_feedforward,
    sliding,
)
from jaxstage.controllers.parts import damping, error_rate, reaching
from jaxstage.hardware.drives import ideal_drive
from jaxstage.hardware.loads import no_load
from jaxstage.hardware.sensors import ideal_sensor
from jaxstage.metrics import tracking
from jaxstage.model.blocks import Controller, Loop, Metric
from jaxstage.model.fields import gain, pytree, replace
from jaxstage.model.signals import Measurement, Setpoint
from jaxstage.numerics.smooth import Layer, SmoothWidth, exact, implicit, sat, smooth
from jaxstage.plants import pmsm_table
from jaxstage.references import analytic
from jaxstage.studies.adaptive_smc import values as screw
from jaxstage.studies.fuzzy_ccc import values as stage
from jaxstage.studies.fuzzy_cmac.loops import (
    LAWS,
    cascade_gains,
    cmac_gains,
    dfcmac_gains,
    pi_gains,
    scenario,
    sliding_gains,
)
from jaxstage.studies.law import StudyLaw
from jaxstage.studies.mrac_asmc import values as axis
from jaxstage.testing import DT as DT
from jaxstage.testing import cast as cast

# --- a toy shift ---------------------------------------------------------------------------


@pytree
class Lead:
    """Gain of `ahead`."""

    time: Array = gain("s", "tau", "how far the setpoint is moved along its velocity")


def ahead(gains: Lead, setpoint: Setpoint) -> Array:
    """r' tau, (axes,) m."""
    return gains.time * setpoint.velocity


# --- the laws under test -------------------------------------------------------------------


class Entry(NamedTuple):
    """A law for the axes x and y with its gains. make() composes it anew.

    settled: it has a sliding variable that does not chatter, so single precision follows double.
    """

    name: str
    make: Callable[[], Controller]
    gains: Any
    settled: bool = False


def _pair(x: float, y: float) -> np.ndarray:
    return np.array([x, y])


SWITCHES = {
    "exact": (exact, ()),
    "smooth": (smooth, SmoothWidth(width=_pair(2e-2, 3e-2))),
    "implicit": (implicit, Layer(layer=_pair(1.0, 4.0))),
}


def _switched() -> list[Entry]:
    """The switches that the study does not use: the exact one is in its laws."""
    entries = []
    for name in ("smooth", "implicit"):
        switch, params = SWITCHES[name]
        gains = replace(sliding_gains(), switch=params, switching_gain=_pair(2.0, 3.0))
        make = functools.partial(_per_axis, sliding, switch)
        entries.append(Entry(f"sliding-{name}", make, gains, name == "smooth"))
        for receptive, values in ((crisp, cmac_gains()), (gaussian, dfcmac_gains())):
            make = functools.partial(_per_axis, cmac_sliding, receptive, switch)
            entries.append(
                Entry(f"cmac-{receptive.name}-{name}", make, replace(values, switch=params))
            )
    return entries


def _per_axis(maker: Callable[..., Controller], *arguments: Any) -> Controller:
    return per_axis(maker(*arguments))


def _published(law: StudyLaw) -> Entry:
    settled = law.name in ("pi", "cascade")
    return Entry(law.name, functools.partial(per_axis, law.controller), law.gains(), settled)


def _composed() -> list[Entry]:
    steady = cascade_gains()
    watching = DisturbanceObserver(
        disturbance_gain=_pair(2.5e5, 2e5), velocity_gain=_pair(1e3, 9e2), nominal=steady.nominal
    )
    slid = replace(sliding_gains(), switch=SWITCHES["smooth"][1])
    stiff = Pd(
        proportional_gain=_pair(1e3, 1.2e3),
        derivative_gain=_pair(110.0, 112.0),
        nominal=steady.nominal,
    )
    per_acceleration = 1 / _pair(320.0, 342.0)
    return [
        Entry(
            "cascade+observer",
            lambda: plus(per_axis(cascade), per_axis(disturbance_observer)),
            Both(law=steady, extra=watching),
        ),
        Entry(
            "pid-coupled",
            lambda: cross_coupled(per_axis(sliding(smooth)), pid_contour()),
            Coupled(law=slid, extra=stage.pid_gains(), command_per_acceleration=per_acceleration),
            True,
        ),
        Entry(
            "fuzzy-coupled",
            lambda: cross_coupled(per_axis(pd), fuzzy_pid_contour()),
            Coupled(
                law=stiff, extra=stage.fuzzy_gains(), command_per_acceleration=per_acceleration
            ),
        ),
        Entry(
            "offset",
            lambda: offset_setpoint(per_axis(pi), "lead", ahead),
            Offset(law=pi_gains(), offset=Lead(time=np.array(2e-4))),
            True,
        ),
    ]


def _surfaces() -> list[Entry]:
    """The nonlinear surface in two of its forms; psi without a bound overflows far off."""
    width = SmoothWidth(width=_pair(2e-2, 3e-2))
    steady = screw.gains(screw.adaptive_gain(), q=0.5, switch=width)
    rising = screw.gains(screw.integral_gain(rate=20.0), q=0.5, switch=width)
    differenced = (reaching.adaptive, smooth, damping.differenced(), error_rate.differenced)
    modelled = (reaching.integral, sat, damping.modelled(-1))
    forms = (("adaptive", steady, differenced), ("modelled", rising, modelled))
    return [
        Entry(
            f"surface-{name}",
            functools.partial(_per_axis, nonlinear_surface, damping.bounded, *parts),
            gains,
        )
        for name, gains, parts in forms
    ]


def _adaptive() -> list[Entry]:
    """The adaptive law inside its inner loop and behind a feed-forward; soft, so that nothing
    saturates where gradients are compared."""
    law = replace(
        axis.adaptive(100.0, 2e3, 2e-2), slope_rate=1e3, switching_rate=9.0, sharpness_rate=1e3
    )
    rates = Rates(input=1e-2, viscous=20.0, dry=20.0, constant=4.0)  # type: ignore[arg-type]
    inner = replace(axis.inner(law), dry_width=0.05, leak=0.1, rates=rates)
    gains = jax.tree.map(lambda x: x * _pair(1.0, 1.1), axis.ahead(inner))
    return [
        Entry(
            "adaptive-mrac",
            lambda: position_feedforward(per_axis(model_reference(adaptive_sliding(difference)))),
            gains,
        ),
    ]


ENTRIES = [*map(_published, LAWS), *_switched(), *_composed(), *_surfaces(), *_adaptive()]


# --- a bench -------------------------------------------------------------------------------


def setpoint(
    position: Any, velocity: Any, acceleration: Any = (0.0, 0.0), dtype: Any = jnp.float64
) -> Setpoint:
    """A setpoint whose tangent is along x."""
    position = np.asarray(position, float)
    return cast(
        Setpoint(
            position=position,
            velocity=np.asarray(velocity, float),
            acceleration=np.asarray(acceleration, float),
            tangent=np.eye(len(position))[0],
            curvature=0.0,
        ),
        dtype,
    )


def seen(position: Any, velocity: Any, dtype: Any = jnp.float64) -> Measurement:
    """A measurement of a rigid axis."""
    x, v = np.asarray(position, float), np.asarray(velocity, float)
    return cast(Measurement(position=x, velocity=v, drive_position=x, drive_velocity=v), dtype)


def turning(radius: float = 0.025, period: float = 1.0, dt: float = DT):
    """A circle at uniform angle as a computed reference, and its parameters."""
    return analytic("turning", _turning, dt), {
        "radius": jnp.asarray(radius),
        "rate": jnp.asarray(2 * np.pi / period),
    }


def _turning(params: Any, time: Array) -> Array:
    angle = params["rate"] * time
    return params["radius"] * jnp.stack([jnp.cos(angle), jnp.sin(angle)])


@functools.cache
def tracing(pick: Callable[[Any], Any]) -> Metric:
    """A metric that stores ``pick(sample)`` of every tick, and nothing else."""
    return Metric(
        name="tracing",
        init=lambda setpoint: (),
        update=lambda acc, sample, dt: (acc, pick(sample)),
        finish=lambda acc: None,
    )


def table_loop(controller: Controller, metric: Metric = tracking, **changes: Any):
    """The published table under a law, on `turning`; with its scenario and path."""
    reference, path = turning(**{k: changes.pop(k) for k in ("period",) if k in changes})
    loop = Loop(
        plant=pmsm_table(),
        controller=controller,
        reference=reference,
        load=no_load,
        sensor=ideal_sensor,
        drive=ideal_drive,
        metric=metric,
        dt=DT,
    )
    return replace(loop, **changes), scenario(), path


def one_size(paths: list[Any]) -> list[Any]:
    """Laps whose arrays have equal shapes: a shorter table ends in copies of its last row."""

    def padded(*leaves: Array) -> list[Array]:
        sizes = np.array([x.shape for x in leaves])
        ends = [[(0, n) for n in sizes.max(axis=0) - size] for size in sizes]
        pairs = zip(leaves, ends, strict=True)
        return [jnp.asarray(np.pad(x, end, mode="edge")) if end else x for x, end in pairs]

    leaves, structure = zip(*map(jax.tree.flatten, paths), strict=True)
    every = [padded(*same) for same in zip(*leaves, strict=True)]
    return [jax.tree.unflatten(structure[0], own) for own in zip(*every, strict=True)]


def stacked(paths: list[Any]) -> Any:
    """Laps of one length as a batch."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *one_size(paths))
