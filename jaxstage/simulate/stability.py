"""Is a sampled loop stable? Eigenvalues of one control period, and the largest stable gain.

    z_{k+1} = Phi z_k,   stable while max |eig Phi| < 1

z: all that a tick hands to the next, of plant, drive, sensor and controller: delays, differenced
velocities and adapted gains included. Phi is the derivative of the whole tick by z, so nothing is
approximated but the nonlinearity: for a loop that is linear in z it is exact, else it holds for
small deviations from the run it was taken on. The slope of a sign, or beyond a clip, is 0: give a
switch its smooth form here. A gain that adapts has an eigenvalue of 1, or close to it.
"""

# what JAX gives is partly untyped
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownLambdaType=false

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from numpy.typing import ArrayLike

from jaxstage.model.blocks import Loop
from jaxstage.model.fields import replace
from jaxstage.model.signals import Carry, Scenario
from jaxstage.model.validate import check
from jaxstage.simulate.rollout import scan_ticks, start
from jaxstage.simulate.tick import tick

#: values tried at once in each round of a search
POINTS = 65


def transition(loop: Loop, gains: Any, scenario: Scenario, path: Any, after: int = 2) -> Array:
    """State transition matrix Phi of one tick, linearised on a run.

    Args:
        loop: What is fixed.
        gains: What is tuned.
        scenario: What is uncertain.
        path: Parameters of the reference.
        after: Ticks of the run before that one. A sensor that differences and a drive that delays
            have no past in the first tick: 1 at least, and more than the dead time in periods.

    Returns:
        Phi, (n, n) for n real numbers that a tick hands on.

    Raises:
        ValueError: For bad input, naming the value and its allowed range.
    """
    gains, scenario, path = check(loop, gains, scenario, path)

    def advance(carry: Carry) -> tuple[Carry, None]:
        return tick(loop, gains, scenario, path, carry)[0], None

    first = start(loop, gains, scenario, path)
    carry, _ = scan_ticks(replace(loop, segment=0), after, advance, first)
    z, rebuild = as_vector(carry)
    return jax.jacfwd(lambda z: vector_of(advance(rebuild(z))[0]))(z)


def vector_of(carry: Carry) -> Array:
    """z (n,): every real number that a tick hands to the next, but for the sums of metrics."""
    return ravel_pytree(_split(carry)[0])[0]


def as_vector(carry: Carry) -> tuple[Array, Callable[[Array], Carry]]:
    """z (n,) of a carry, and the function that puts another z in its place."""
    moving, still = _split(carry)
    vector, shaped = ravel_pytree(moving)
    return vector, lambda z: _joined(carry, shaped(z), still)


def _split(carry: Carry) -> tuple[list[Array | None], list[Array | None]]:
    """What one tick hands to the next: the real numbers, and the rest."""
    leaves = jax.tree.leaves((carry.state, carry.drive, carry.sensor, carry.memory))
    real = [jnp.issubdtype(leaf.dtype, jnp.floating) for leaf in leaves]
    moving = [leaf if r else None for leaf, r in zip(leaves, real, strict=True)]
    return moving, [None if r else leaf for leaf, r in zip(leaves, real, strict=True)]


def _joined(carry: Carry, moving: list[Array | None], still: list[Array | None]) -> Carry:
    structure = jax.tree.structure((carry.state, carry.drive, carry.sensor, carry.memory))
    leaves = [b if a is None else a for a, b in zip(moving, still, strict=True)]
    state, drive, sensor, memory = jax.tree.unflatten(structure, leaves)
    return replace(carry, state=state, drive=drive, sensor=sensor, memory=memory)


def spectral_radius(matrix: ArrayLike) -> np.ndarray:
    """Spectral radius max |eig| of matrices, on the host.

    Args:
        matrix: (..., n, n).

    Returns:
        (...); inf where a matrix is not finite.
    """
    matrix = np.asarray(matrix, float)
    finite = np.asarray(np.isfinite(matrix).all(axis=(-2, -1)))
    safe = np.where(finite[..., None, None], matrix, 0.0)
    return np.where(finite, np.abs(np.linalg.eigvals(safe)).max(axis=-1), np.inf)


def stability_limit(
    radius: Callable[[np.ndarray], np.ndarray], low: float, high: float, tolerance: float = 1e-9
) -> float:
    """The value in [low, high] at which a loop, stable from ``low`` on, stops being stable.

    `POINTS` values are tried at once, and again between the two that enclose the limit. An interval
    of instability below (high - low) / 64 can be missed.

    Args:
        radius: Spectral radii (values,) of values (values,), usually of one gain.
        low: A stable value.
        high: The largest value that is of interest.
        tolerance: Width of the last interval, relative to ``high``.

    Returns:
        The largest value known to be stable; inf when the loop is stable up to ``high``.

    Raises:
        ValueError: When the loop is not stable at ``low``.
    """
    stop = high
    while stop - low > tolerance * abs(high):
        values = np.linspace(low, stop, POINTS)
        stable = np.asarray(radius(values)) < 1
        if not stable[0]:
            raise ValueError(f"the loop is not stable at {low:g}")
        if stable.all():
            return math.inf
        first = int(np.argmin(stable))
        low, stop = float(values[first - 1]), float(values[first])
    return low
