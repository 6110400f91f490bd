"""Steppers for ordinary differential equations on any pytree state."""

import math
from collections.abc import Callable
from typing import Any

import jax

Derivative = Callable[[Any, float], Any]


def shifted(state: Any, slope: Any, step: float) -> Any:
    """state + step * slope, leaf by leaf."""
    return jax.tree.map(lambda x, k: x + step * k, state, slope)


def rk4(derivative: Derivative, state: Any, dt: float) -> Any:
    """One classical Runge-Kutta step, fourth order.

    derivative(state, fraction): slope at a fraction 0, 1/2 or 1 of the step, so that loads which
    vary with time are evaluated inside the step. dt: step in s.
    """
    k1 = derivative(state, 0.0)
    k2 = derivative(shifted(state, k1, dt / 2), 0.5)
    k3 = derivative(shifted(state, k2, dt / 2), 0.5)
    k4 = derivative(shifted(state, k3, dt), 1.0)
    mean = jax.tree.map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, k1, k2, k3, k4)
    return shifted(state, mean, dt)


#: (base, h, fraction) -> y = base + h f(y, fraction): one implicit Euler step
ImplicitStage = Callable[[Any, float, float], Any]


def sdirk2(stage: ImplicitStage, state: Any, dt: float) -> Any:
    """One step of the two-stage diagonally implicit Runge-Kutta method, second order, L-stable.

    g = 1 - 1/sqrt(2); y1 = x + g h f(y1), y2 = x + (1 - g) h f(y1) + g h f(y2); x' = y2.
    stage(base, g h, fraction): one implicit Euler step, its slope taken at the fraction g or 1 of
    the step. dt: step in s. Source: Alexander, SIAM J. Numer. Anal. 14 (1977).
    """
    share = 1 - math.sqrt(0.5)
    first = stage(state, share * dt, share)
    between = jax.tree.map(lambda y, x: x + (1 / share - 1) * (y - x), first, state)
    return stage(between, share * dt, 1.0)
