"""Adaptive fuzzy PID cross-coupled contour control: a fuzzy system schedules the gains and learns.

    X1 = 3 tanh(-E / eps_sc),  X2 = 3 tanh(-E' / deps_sc),  xi = rule strengths of (X1, X2)
    K_q = clip(theta_q)^T xi,  q in {P, I, D};   U = K_P eps + K_I I + K_D D
    S = (lam eps + D) / (lam eps_sc)
    theta_P' = g_P (S . eps / eps_sc) xi - leak (theta_P - theta_P(0))
    theta_I' = g_I (S . I / int_sc) xi - leak (...)
    theta_D' = g_D (S . D / deps_sc) xi - leak (...)

eps, I, D: contour error, its integral and rate (`parts.contour_error`, in either form); E, E': its
rounded magnitude and rate; xi: `parts.fuzzy`. After every step theta is clipped to its bounds, and
what the drive cut off is taken out of I.

| symbol | field | unit |
|---|---|---|
| theta_q(0) | rules | 1/s2, 1/s3, 1/s |
| eps_sc, deps_sc, int_sc | scales | m, m/s, m s |
| lam, g_P, g_I, g_D, leak | adaptation | 1/s, 1/s3, 1/s4, 1/s2, 1/s |
| thmin_q, thmax_q | bounds | as the gains |
| w, v_0 | rounding, rest_speed | m, m/s |

The minus in X1 and X2: the rules (`parts.pid_rules`) are written for the error "actual minus
reference". E >= 0, so only the rows NB ... ZO are excited. With g = 0 the rules stay as they are.
The law follows from V = |s|^2/2 + sum |theta - theta*|^2/(2 G) with s = lam eps + D. The bounds
keep theta finite; nothing is claimed of its convergence, and without leak theta_P only drifts up,
for its rate integrates the square of the contour error.

Source: Science Progress 2021, doi:10.1177/00368504211011847: fuzzy gains, their two inputs and
"adaptive weights" in words. Scales, adaptation law, bounds and leak are chosen here.
"""

import functools
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxstage.controllers.parts.contour_error import (
    ContourError,
    Form,
    contour_error,
    magnitude,
    unwinding,
    vector,
)
from jaxstage.controllers.parts.fuzzy import FuzzySets, infer, limited, strengths
from jaxstage.model.blocks import Controller
from jaxstage.model.fields import gain, part, pytree, replace, signal
from jaxstage.model.signals import Measurement, Setpoint
from jaxstage.numerics.geometry import dot
from jaxstage.numerics.integrate import shifted
from jaxstage.numerics.smooth import within

RULES = "(sets, sets)"


@pytree
class Rules:
    """Rule consequents at the start; rows contour error, columns its rate."""

    proportional: Array = gain("1/s2", "theta_P0", "rules of K_P", shape=RULES)
    integral: Array = gain("1/s3", "theta_I0", "rules of K_I", shape=RULES)
    derivative: Array = gain("1/s", "theta_D0", "rules of K_D", shape=RULES)


@pytree
class Scales:
    """Normalisation of contour error, rate and integral."""

    deviation: Array = gain("m", "eps_sc", "contour error", above=0.0, shown="um")
    rate: Array = gain("m/s", "deps_sc", "its rate", above=0.0, shown="mm/s")
    integral: Array = gain("m s", "int_sc", "its integral", above=0.0)


@pytree
class Adaptation:
    """Adaptation rates of the consequents."""

    slope: Array = gain("1/s", "lam", "slope of the contour surface", above=0.0)
    proportional_rate: Array = gain("1/s3", "g_P", "learning rate of K_P", low=0.0)
    integral_rate: Array = gain("1/s4", "g_I", "learning rate of K_I", low=0.0)
    derivative_rate: Array = gain("1/s2", "g_D", "learning rate of K_D", low=0.0)
    leak: Array = gain("1/s", "leak", "rate of return to the rules of the start", low=0.0)


@pytree
class Bounds:
    """Bounds of the consequents."""

    proportional_least: Array = gain("1/s2", "thmin_P", "least K_P")
    proportional_most: Array = gain("1/s2", "thmax_P", "most", at_least="proportional_least")
    integral_least: Array = gain("1/s3", "thmin_I", "least K_I")
    integral_most: Array = gain("1/s3", "thmax_I", "most", at_least="integral_least")
    derivative_least: Array = gain("1/s", "thmin_D", "least K_D")
    derivative_most: Array = gain("1/s", "thmax_D", "most", at_least="derivative_least")


@pytree
class FuzzyPidContour:
    """Gains of the adaptive fuzzy PID cross-coupled law, shared by all axes."""

    rules: Rules = part("consequents at the start")
    error_sets: FuzzySets = part("sets of the contour error")
    rate_sets: FuzzySets = part("sets of its rate")
    scales: Scales = part("normalisation")
    adaptation: Adaptation = part("how the rules learn")
    bounds: Bounds = part("between what the consequents are kept")
    rounding: Array = gain(
        "m", "w", "contour error below which its magnitude is rounded", above=0.0, shown="um"
    )
    rest_speed: Array = gain(
        "m/s", "v_0", "feed below which the path counts as at rest", above=0.0, shown="mm/s"
    )
    form: Any = part("parameters of the form")


@pytree
class Learned:
    """Adapted consequents, and the integral of the contour error."""

    proportional: Array = signal("1/s2", "theta_P", "rules of K_P", shape=RULES)
    integral: Array = signal("1/s3", "theta_I", "rules of K_I", shape=RULES)
    derivative: Array = signal("1/s", "theta_D", "rules of K_D", shape=RULES)
    error_integral: Array = signal("m s", "I", "integral of the contour error", shape="any")


@pytree
class FuzzyPidMemory:
    """Adapted consequents, the contour error last measured and the gains it was met with."""

    learned: Learned = part("what the law integrates")
    error: ContourError = part("contour error of the tick")
    proportional_gain: Array = signal("1/s2", "K_P", "gain on the contour error")
    integral_gain: Array = signal("1/s3", "K_I", "gain on its integral")
    derivative_gain: Array = signal("1/s", "K_D", "gain on its rate")


def rule_strengths(gains: FuzzyPidContour, error: ContourError) -> Array:
    """Normalised rule strengths xi, (sets, sets), at a contour error; their sum is 1."""
    size, rate, _ = magnitude(error, gains.rounding)
    return strengths(
        gains.error_sets,
        gains.rate_sets,
        limited(-size / gains.scales.deviation),
        limited(-rate / gains.scales.rate),
    )


def kept(bounds: Bounds, learned: Learned) -> Learned:
    """Projection: the consequents clipped to their bounds."""
    b = bounds
    return replace(
        learned,
        proportional=within(learned.proportional, b.proportional_least, b.proportional_most),
        integral=within(learned.integral, b.integral_least, b.integral_most),
        derivative=within(learned.derivative, b.derivative_least, b.derivative_most),
    )


def rate(form: Form, gains: FuzzyPidContour, memory: FuzzyPidMemory) -> Learned:
    """State derivative: theta_q' and I' at the contour error in the memory.

    Args:
        form: how the contour error is read.
        gains: of the law.
        memory: after ``control`` of the sample.

    Returns:
        The derivatives per second, in the fields of a `Learned`.
    """
    error, learned, learn = memory.error, memory.learned, gains.adaptation
    terms = form.terms(gains.form, error, learned.error_integral)
    xi = rule_strengths(gains, error)
    surface = (error.deviation + error.rate / learn.slope) / gains.scales.deviation

    def adapted(speed: Array, term: Array, moved: Array) -> Array:
        return speed * dot(surface, term) * xi - learn.leak * moved

    scales, rules = gains.scales, gains.rules
    return Learned(
        proportional=adapted(
            learn.proportional_rate,
            terms.proportional / scales.deviation,
            learned.proportional - rules.proportional,
        ),
        integral=adapted(
            learn.integral_rate,
            terms.integral / scales.integral,
            learned.integral - rules.integral,
        ),
        derivative=adapted(
            learn.derivative_rate,
            terms.derivative / scales.rate,
            learned.derivative - rules.derivative,
        ),
        error_integral=form.rate(gains.form, error, learned.error_integral),
    )


def _shown(gains: FuzzyPidContour, learned: Learned, error: ContourError) -> FuzzyPidMemory:
    """The memory of a tick: the scheduled gains beside what they come from."""
    xi, clipped = rule_strengths(gains, error), kept(gains.bounds, learned)
    return FuzzyPidMemory(
        learned=learned,
        error=error,
        proportional_gain=infer(clipped.proportional, xi),
        integral_gain=infer(clipped.integral, xi),
        derivative_gain=infer(clipped.derivative, xi),
    )


@functools.cache
def fuzzy_pid_contour(form: Form = vector) -> Controller[FuzzyPidContour, FuzzyPidMemory]:
    """Fuzzy PID contour law of any number of axes, for `cross_coupled`; gains `FuzzyPidContour`.

    Args:
        form: how the contour error is read, `vector` or `scalar`.

    Returns:
        The controller, whose demand is an acceleration, (axes,) m/s2.
    """

    def init(gains: FuzzyPidContour, setpoint: Setpoint, seen: Measurement) -> FuzzyPidMemory:
        learned = Learned(
            proportional=gains.rules.proportional,
            integral=gains.rules.integral,
            derivative=gains.rules.derivative,
            error_integral=form.start(jnp.zeros_like(seen.position)),
        )
        return _shown(gains, learned, contour_error(setpoint, seen, gains.rest_speed))

    def control(
        gains: FuzzyPidContour,
        memory: FuzzyPidMemory,
        setpoint: Setpoint,
        seen: Measurement,
        dt: float,
    ) -> tuple[Array, FuzzyPidMemory]:
        error = contour_error(setpoint, seen, gains.rest_speed)
        memory = _shown(gains, memory.learned, error)
        terms = form.terms(gains.form, error, memory.learned.error_integral)
        demand = terms.weighted(
            memory.proportional_gain, memory.integral_gain, memory.derivative_gain
        )
        return demand, memory

    def settle(
        gains: FuzzyPidContour, memory: FuzzyPidMemory, demand: Array, command: Array, dt: float
    ) -> FuzzyPidMemory:
        stiffness = memory.proportional_gain + memory.integral_gain * dt
        unwound = unwinding(form, gains.form, memory.error, command - demand, stiffness)
        slope = rate(form, gains, memory)
        slope = replace(slope, error_integral=slope.error_integral + unwound)
        return replace(memory, learned=kept(gains.bounds, shifted(memory.learned, slope, dt)))

    return Controller(
        name=f"fuzzy_pid_contour[{form.name}]", init=init, control=control, settle=settle
    )
