"""What several test files share: the laws under test and a bench for one control period."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.blocks import Controller, Loop, Metric
from jaxstage.controllers import (
    Both,
    Coupled,
    Offset,
    cascade,
    cmac_sliding,
    crisp,
    cross_coupled,
    gaussian,
    offset_setpoint,
    per_axis,
    pi,
    plus,
    sliding,
)
from jaxstage.drives import ideal_drive
from jaxstage.fields import gain, pytree, replace, signal
from jaxstage.loads import no_load
from jaxstage.metrics import tracking
from jaxstage.numerics.geometry import normal_part
from jaxstage.numerics.smooth import Layer, SmoothWidth, exact, implicit, smooth
from jaxstage.plants import pmsm_table
from jaxstage.references import analytic
from jaxstage.sensors import ideal_sensor
from jaxstage.signals import Measurement, Setpoint
from jaxstage.studies.fuzzy_cmac import loops

DT = 1e-4


# --- toy laws ------------------------------------------------------------------------------


@pytree
class ContourGain:
    """Gain of `contour_law`."""

    stiffness: Array = gain("1/s2", "K_P", "acceleration per contour error", low=0.0)


def _contour_control(
    gains: ContourGain, memory: tuple[()], setpoint: Setpoint, seen: Measurement, dt: float
) -> tuple[Array, tuple[()]]:
    aside = normal_part(setpoint.position - seen.position, setpoint.tangent)
    return gains.stiffness * aside, ()


#: U = K_P eps, eps the tangent estimate of the contour error, any number of axes
contour_law = Controller(
    name="contour_law", init=lambda gains, setpoint, seen: (), control=_contour_control
)


@pytree
class Observer:
    """Gains of `observer`, one axis."""

    first: Array = gain("1/s2", "k1", "gain on the disturbance", above=0.0)
    second: Array = gain("1/s", "k2", "gain on the velocity", above=0.0)
    authority: Array = gain("m/s2", "a_n", "acceleration per command", above=0.0)
    damping: Array = gain("1/s", "b_n", "damping over mass", low=0.0)


@pytree
class ObserverMemory:
    """Estimates, and the velocity last seen."""

    disturbance: Array = signal("m/s2", "d^", "estimated disturbance")
    velocity: Array = signal("m/s", "w^", "estimated velocity")
    seen: Array = signal("m/s", "v", "measured velocity")


def _observer_init(gains: Observer, setpoint: Setpoint, seen: Measurement) -> ObserverMemory:
    return ObserverMemory(
        disturbance=jnp.zeros_like(seen.velocity), velocity=seen.velocity, seen=seen.velocity
    )


def _observer_control(
    gains: Observer, memory: ObserverMemory, setpoint: Setpoint, seen: Measurement, dt: float
) -> tuple[Array, ObserverMemory]:
    return memory.disturbance / gains.authority, replace(memory, seen=seen.velocity)


def _observer_settle(
    gains: Observer, memory: ObserverMemory, demand: Array, command: Array, dt: float
) -> ObserverMemory:
    """d^' = k1 (w^ - v); w^' = -d^ + a_n u - k2 (w^ - v) - b_n v; u the total command."""
    off = memory.velocity - memory.seen
    slope = gains.authority * command - memory.disturbance - gains.second * off
    return ObserverMemory(
        disturbance=memory.disturbance + dt * gains.first * off,
        velocity=memory.velocity + dt * (slope - gains.damping * memory.seen),
        seen=memory.seen,
    )


observer = Controller(
    name="observer", init=_observer_init, control=_observer_control, settle=_observer_settle
)


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
    made = []
    for name in ("smooth", "implicit"):
        switch, params = SWITCHES[name]
        gains = replace(loops.sliding_gains(), switch=params, switching_gain=_pair(2.0, 3.0))
        make = functools.partial(_per_axis, sliding, switch)
        made.append(Entry(f"sliding-{name}", make, gains, name == "smooth"))
        for receptive, values in ((crisp, loops.cmac_gains()), (gaussian, loops.dfcmac_gains())):
            make = functools.partial(_per_axis, cmac_sliding, receptive, switch)
            made.append(
                Entry(f"cmac-{receptive.name}-{name}", make, replace(values, switch=params))
            )
    return made


def _per_axis(maker: Callable[..., Controller], *arguments: Any) -> Controller:
    return per_axis(maker(*arguments))


def _published(law: loops.Law) -> Entry:
    settled = law.name in ("pi", "cascade")
    return Entry(law.name, functools.partial(per_axis, law.controller), law.gains(), settled)


def _composed() -> list[Entry]:
    spy = Observer(
        first=_pair(2.5e5, 2e5), second=_pair(1e3, 9e2), authority=_pair(320.0, 342.0),
        damping=_pair(33.0, 43.0),
    )  # fmt: skip
    steady = loops.cascade_gains()
    return [
        Entry(
            "cascade+observer",
            lambda: plus(per_axis(cascade), per_axis(observer)),
            Both(law=steady, extra=spy),
        ),
        Entry(
            "cross_coupled",
            lambda: cross_coupled(per_axis(sliding(smooth)), contour_law),
            Coupled(
                law=replace(loops.sliding_gains(), switch=SWITCHES["smooth"][1]),
                extra=ContourGain(stiffness=np.array(900.0)),
                command_per_acceleration=1 / _pair(320.0, 342.0),
            ),
            True,
        ),
        Entry(
            "offset",
            lambda: offset_setpoint(per_axis(pi), "lead", ahead),
            Offset(law=loops.pi_gains(), offset=Lead(time=np.array(2e-4))),
            True,
        ),
    ]


ENTRIES = [*map(_published, loops.LAWS), *_switched(), *_composed()]


# --- a bench -------------------------------------------------------------------------------


def cast(tree: Any, dtype: Any = jnp.float64) -> Any:
    """The tree with every leaf a strong array of one type."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), tree)


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
    return replace(loop, **changes), loops.scenario(), path
