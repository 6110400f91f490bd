"""Gains and scenarios of the fuzzy cross-coupling study, varied: what its test files share."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.model.fields import replace
from jaxstage.studies.fuzzy_ccc import values

STEPS = 10_000  # 10 s at 1 ms


def constant(proportional: float, integral: float, derivative: float):
    """A fuzzy coupling all of whose rules say the same, and stay: a PID coupling."""
    gains, one = values.fuzzy_gains(adapting=False), np.ones((7, 7))
    rules = replace(
        gains.rules,
        proportional=proportional * one, integral=integral * one, derivative=derivative * one,
    )  # fmt: skip
    return replace(gains, rules=rules)


def none():
    """A coupling with its gains bounded to 0."""
    gains, zero = constant(0.0, 0.0, 0.0), np.zeros(())
    bounds = replace(gains.bounds, proportional_most=zero, integral_most=zero, derivative_most=zero)
    return replace(gains, bounds=bounds)


def learning(factor: float = 1.0, leak: float = 0.0):
    """The adaptive coupling with other learning rates."""
    gains = values.fuzzy_gains()
    a = gains.adaptation
    return replace(
        gains,
        adaptation=replace(
            a,
            proportional_rate=factor * a.proportional_rate,
            integral_rate=factor * a.integral_rate,
            derivative_rate=factor * a.derivative_rate,
            leak=np.asarray(leak),
        ),
    )


def pid():
    """The PID coupling of the study."""
    return constant(*values.BASE)


def stage(
    coupling: Any,
    mass: Any = 1.0,
    eta: float = 0.5,
    observer: bool = True,
    switch: Any = None,
    law: Any = None,
):
    """Gains of all three laws; mass: assumed over true. Without observer its gain is next to 0.

    law: gains of the law of the axes, else sliding mode with ``eta`` and ``switch``.
    """
    axis = values.nominal(np.asarray(mass))
    watched = values.observed(law or values.sliding_gains(axis, eta, switch), axis)
    if not observer:
        blind = replace(watched.extra, disturbance_gain=np.full(3, 1e-30))
        watched = replace(watched, extra=blind)
    return values.coupled(watched, coupling, axis)


def scene(offset: Any = None, velocity: float = 1.0, load: float = 1.0):
    """The scenario with another offset in m, start (0 at rest) and share of the load."""
    base = values.scenario()
    start = replace(
        base.start,
        offset=base.start.offset if offset is None else np.asarray(offset, float),
        velocity=np.full(3, velocity),
    )
    return replace(base, start=start, load=replace(base.load, amplitude=load * base.load.amplitude))


def path(**changes: float):
    """The helix of the study with some numbers changed."""
    return replace(values.path(), **{name: np.asarray(x) for name, x in changes.items()})


def stacked(trees: Any) -> Any:
    """Trees of one structure as one, with a leading axis."""
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(x) for x in leaves]), *trees)


def indices(signal: np.ndarray) -> np.ndarray:
    """MAX, MEAN and RMS of the magnitude, by the trapezoidal rule; time is the first axis."""
    size = np.abs(signal)

    def mean(x):
        return (x.sum(axis=0) - (x[0] + x[-1]) / 2) / (len(x) - 1)

    return np.stack([size.max(axis=0), mean(size), np.sqrt(mean(size**2))], axis=-1)
