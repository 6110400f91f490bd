"""Diagnostics: gradients, active bounds, identifiability of the parameters, agreement of starts,
stability of the sampled loop."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxstage.simulate.stability import spectral_radius, transition
from jaxstage.studies import Case
from tuning.tuner.problem.problem import Problem, gauss_newton_model
from tuning.tuner.problem.search_space import parameters
from tuning.tuner.search.optimise import METHODS, SearchResult

#: a parameter whose move by one unit (about a factor e) changes the objective by less than this
#: share has no effect
EFFECT = 1e-3
#: combinations of parameters whose curvature, with every single one scaled to 1, is below this
REDUNDANT = 1e-3
#: share of a combination that a parameter must have to be named
MEMBER = 0.3
#: more parameters than these get no Gauss-Newton matrix: it costs a unit or more for each
MOST_CURVED = 40
#: starts agree when the best of the others ends within this share of the best objective
AGREE = 0.05


class Effects(NamedTuple):
    """Local identifiability of the parameters.

    Attributes:
        insensitive: labels of parameters without effect.
        redundant: groups of labels that do the same: moved together in the right ratio, they
            change nothing.
        eigenvalues: of the Gauss-Newton matrix, ascending, (n,).
    """

    insensitive: tuple[str, ...]
    redundant: tuple[tuple[str, ...], ...]
    eigenvalues: np.ndarray


class Diagnostics(NamedTuple):
    """What is said of a result beside its metrics; None where it could not be had.

    Attributes:
        gradient_error: run -> relative error of its slopes.
        gradient_ok: whether a search by gradients can be trusted.
        non_finite: runs whose slope is not finite.
        at_bounds: labels of parameters on an edge of their box.
        effects: of the parameters.
        starts: J where each start ended, ascending.
        starts_agree: whether the two best do.
        radius: spectral radius of one control period of the nominal loop, before and after.
        notes: why something could not be had.
    """

    gradient_error: dict[str, float] | None
    gradient_ok: bool | None
    non_finite: int
    at_bounds: tuple[str, ...]
    effects: Effects | None
    starts: tuple[float, ...]
    starts_agree: bool | None
    radius: tuple[float, float] | None
    notes: tuple[str, ...]


def effects(
    gauss_newton: np.ndarray, gradient: np.ndarray, objective: float, labels: Sequence[str]
) -> Effects:
    """Which parameters have no effect, and which do the same: small eigenvalues of the scaled
    Gauss-Newton matrix and the members of their eigenvectors.

    Args:
        gauss_newton: (n, n) at the result, per unit of z.
        gradient: (n,) there.
        objective: J there.
        labels: of the parameters.
    """
    own = np.abs(gradient) + 0.5 * np.diag(gauss_newton)
    acting = own > EFFECT * objective
    idle = tuple(label for label, acts in zip(labels, acting, strict=True) if not acts)
    every = np.linalg.eigvalsh(gauss_newton)
    kept = np.flatnonzero(acting & (np.diag(gauss_newton) > 0))
    root = np.sqrt(np.diag(gauss_newton)[kept])
    scaled = gauss_newton[np.ix_(kept, kept)] / np.outer(root, root)
    values, vectors = np.linalg.eigh(scaled) if len(kept) else (np.empty(0), np.empty((0, 0)))
    groups = []
    for value, vector in zip(values, vectors.T, strict=True):
        members = tuple(labels[kept[i]] for i in np.flatnonzero(np.abs(vector) > MEMBER))
        if value < REDUNDANT and len(members) > 1:
            groups.append(members)
    return Effects(idle, tuple(groups), every)


def diagnose(problem: Problem, result: SearchResult, z: np.ndarray, case: Case) -> Diagnostics:
    """Diagnostics of a result.

    Args:
        problem: that was searched.
        result: of the search.
        z: the gains selected, (n,).
        case: the nominal loop.
    """
    check, notes = result.check, [result.note] if result.note else []
    if check is None:
        notes.append(unchecked(result.method))
    known, note = _effects(problem, z, len(result.starts))
    errors = dict(zip(check.runs, map(float, check.error), strict=True)) if check else None
    ends = tuple(sorted(start.objective for start in result.starts))
    return Diagnostics(
        gradient_error=errors,
        gradient_ok=check.ok if check else None,
        non_finite=check.non_finite if check else 0,
        at_bounds=tuple(p.label for p in parameters(problem.space, z) if p.at_bound),
        effects=known,
        starts=ends,
        starts_agree=ends[1] <= ends[0] * (1 + AGREE) if len(ends) > 1 else None,
        radius=_radii(case, problem.space.gains, problem.space.gains_of(jnp.asarray(z))),
        notes=(*notes, *note),
    )


def unchecked(method: str) -> str:
    """Why a search by a method did not check the gradients: only the automatic choice needs to."""
    used = METHODS[method]().needs
    why = f"--method {method} was asked for" if used else "the method does not use it"
    return f"the gradient was not checked: {why}"


def _effects(problem: Problem, z: np.ndarray, starts: int) -> tuple[Effects | None, list[str]]:
    """Effects of the parameters at z, or why there are none. starts: of the search."""
    if len(z) > MOST_CURVED:
        return None, [f"no Gauss-Newton matrix of {len(z)} parameters: it would cost too much"]
    every = np.repeat(z[None], starts, axis=0)  # as in training: compiled already
    model = gauss_newton_model(problem, every)
    numbers = (model.gauss_newton[0], model.gradient[0], float(model.objective[0]))
    if all(np.isfinite(np.asarray(x)).all() for x in numbers):
        return effects(*numbers, problem.space.labels), []
    return None, ["the Gauss-Newton matrix is not finite here"]


def _radii(case: Case, before: Any, after: Any) -> tuple[float, float] | None:
    """Spectral radii of one control period of the nominal loop, after a few; None where not
    finite."""
    past = 2 + case.loop.drive.max_delay

    @jax.jit
    def matrix(gains: Any) -> jax.Array:
        return transition(case.loop, gains, case.scenario, case.path, past)

    first, second = (float(spectral_radius(matrix(gains))) for gains in (before, after))
    return (first, second) if np.isfinite([first, second]).all() else None
