"""Frequency response of a sampled linear model, and the closed-loop functions of control.

H(e^{j w dt}) = C (e^{j w dt} I - A)^{-1} B + D
S = response behind the cut to what is added there,   L = 1/S - 1,   T = 1 - S
tracking G = G_r + j w G_r' - w^2 G_r''               tool against a sampled sine setpoint
compliance = -G_F                                     tool against force; stiffness = 1/|compliance|
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.frequency.linear import LinearModel

#: eigenvectors that are worse conditioned give way to a solve at each frequency
CONDITION = 1e9


def response(model: LinearModel, omega: Array) -> Array:
    """H at angular frequencies, by one solve each; differentiable by the model.

    Args:
        model: the model, of one loop.
        omega: (w,) rad/s.

    Returns:
        (w, outputs, inputs), complex.
    """
    eye = jnp.eye(model.a.shape[-1])

    def at(w: Array) -> Array:
        z = jnp.exp(1j * w * model.dt)
        return model.c @ jnp.linalg.solve(z * eye - model.a, model.b.astype(z.dtype)) + model.d

    return jax.vmap(at)(jnp.asarray(omega))


class Modal(NamedTuple):
    """A model in modal form, H = C V diag(1/(z - lambda)) V^{-1} B + D, on the host.

    Attributes:
        model: what it was made of, without the states that no input reaches or no output sees.
        eigenvalues: (n,).
        left: (n, inputs), V^{-1} B.
        right: (outputs, n), C V. Both empty where the eigenvectors are ill-conditioned.
    """

    model: LinearModel
    eigenvalues: np.ndarray
    left: np.ndarray
    right: np.ndarray

    def at(self, omega: np.ndarray) -> np.ndarray:
        """(..., outputs, inputs) at omega (...) in rad/s."""
        omega = np.asarray(omega, float)
        z = np.exp(1j * omega * float(self.model.dt))[..., None]
        if self.left.size or not self.eigenvalues.size:
            scaled = self.right / (z - self.eigenvalues)[..., None, :]
            return scaled @ self.left + np.asarray(self.model.d)
        a, b, c, d = (np.asarray(x) for x in self.model[:4])
        return c @ np.linalg.solve(z[..., None] * np.eye(len(a)) - a, b + 0j) + d


def modal(model: LinearModel) -> Modal:
    """The model made ready for many frequencies: n^3 once, n for each."""
    small = connected(model)
    a, b, c = (np.asarray(x) for x in small[:3])
    values, vectors = np.linalg.eig(a) if len(a) else (np.empty(0), np.empty((0, 0)))
    if len(values) and np.linalg.cond(vectors) > CONDITION:
        empty = np.empty((0, 0))
        return Modal(small, values, empty, empty)
    left = np.linalg.solve(vectors, b + 0j) if len(values) else b
    return Modal(small, values, left, c @ vectors)


def connected(model: LinearModel) -> LinearModel:
    """The model without states that no input reaches or no output sees, judged by exact zeros.

    The response is the same. A table of cells, of which a few are active, shrinks to these.
    """
    a, b, c, d = (np.asarray(x, float) for x in model[:4])
    reached = _closure(a != 0, (b != 0).any(axis=1))
    seen = _closure((a != 0).T, (c != 0).any(axis=0))
    kept = np.flatnonzero(reached & seen)
    return LinearModel(a[np.ix_(kept, kept)], b[kept], c[:, kept], d, float(model.dt))  # type: ignore[arg-type]


def _closure(arrows: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """States that follow from those of ``begin``; arrows[i, j]: j acts on i."""
    while True:
        grown = begin | (arrows & begin).any(axis=1)
        if (grown == begin).all():
            return begin
        begin = grown


def sensitivity(model: LinearModel) -> Callable[[np.ndarray], np.ndarray]:
    """S as a function of omega (w,) in rad/s: (w, axes, axes), on the host."""
    return modal(model.between("cut", "cut")).at


def tracking(model: LinearModel, feedforward: bool = True) -> Callable[[np.ndarray], np.ndarray]:
    """Tool against setpoint: (w, axes, axes). feedforward: with r' and r'', else r alone."""
    names = ("position", "velocity", "acceleration")
    parts = [modal(model.between("tool", name)).at for name in names]

    def at(omega: np.ndarray) -> np.ndarray:
        w = np.asarray(omega, float)[..., None, None]
        whole = parts[0](omega)
        return whole + 1j * w * parts[1](omega) - w**2 * parts[2](omega) if feedforward else whole

    return at


def compliance(model: LinearModel) -> Callable[[np.ndarray], np.ndarray]:
    """Tool displacement per external force in m/N: (w, axes, axes)."""
    part = modal(model.between("tool", "force")).at
    return lambda omega: -part(omega)
