"""Steppers for ordinary differential equations on any pytree state."""

import math
from collections.abc import Callable
from typing import TypeAlias, TypeVar

import jax

State = TypeVar("State")

#: (state, fraction of the step) -> its rate of change, a tree of the same form
Derivative: TypeAlias = Callable[[State, float], State]


def shifted(state: State, slope: State, step: float) -> State:
    """state + step * slope, leaf by leaf."""
    return jax.tree.map(lambda x, k: x + step * k, state, slope)


def rk4(derivative: Derivative[State], state: State, dt: float) -> State:
    """One classical Runge-Kutta step, fourth order.

    x' = x + h (k1 + 2 k2 + 2 k3 + k4) / 6

    Args:
        derivative: slope of a state at a fraction 0, 1/2 or 1 of the step, so that loads which vary
            with time are evaluated inside the step.
        state: x.
        dt: h in s.

    Returns:
        The state after the step.
    """
    k1 = derivative(state, 0.0)
    k2 = derivative(shifted(state, k1, dt / 2), 0.5)
    k3 = derivative(shifted(state, k2, dt / 2), 0.5)
    k4 = derivative(shifted(state, k3, dt), 1.0)
    mean = jax.tree.map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, k1, k2, k3, k4)
    return shifted(state, mean, dt)


#: (base, h, fraction) -> y = base + h f(y, fraction): one implicit Euler step
ImplicitStage: TypeAlias = Callable[[State, float, float], State]


def sdirk2(stage: ImplicitStage[State], state: State, dt: float) -> State:
    """One step of the two-stage diagonally implicit Runge-Kutta method, second order, L-stable.

    g = 1 - 1/sqrt(2); y1 = x + g h f(y1), y2 = x + (1 - g) h f(y1) + g h f(y2); x' = y2.
    Source: Alexander, SIAM J. Numer. Anal. 14 (1977).

    Args:
        stage: ``(base, g h, fraction)``, one implicit Euler step whose slope is taken at the
            fraction g or 1 of the step.
        state: x.
        dt: h in s.

    Returns:
        The state after the step.
    """
    share = 1 - math.sqrt(0.5)
    first = stage(state, share * dt, share)
    between = jax.tree.map(lambda y, x: x + (1 / share - 1) * (y - x), first, state)
    return stage(between, share * dt, 1.0)
