"""Compiled objective: costs of many gains in all training runs, and their derivatives.

All candidates run in all runs of a group in one batch, candidates first: lane = candidate * runs +
run. The programs take gains, weights and scales as arguments, so nothing is compiled twice.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.model.fields import replace
from jaxstage.model.settings import with_leaf
from jaxstage.simulate.batch import rollouts, spread_axes
from tuning.tuner.problem.objective import LOST, PULL, TIGHT, Objective, pull_factor
from tuning.tuner.problem.run_group import RunGroup
from tuning.tuner.problem.search_space import SearchSpace
from tuning.tuner.problem.training_metrics import MetricColumns, TrainingMetric, training_columns

#: lanes that run together at most
TILE = 128
#: bytes that one batch may take
MEMORY = 4e9


class CompiledObjective(NamedTuple):
    """Compiled functions of (z (m, n), weights (m, terms), scales (terms,), penalty (), data).

    Attributes:
        evaluate: fields of `problem.Evaluation`; plain simulation.
        value_and_grad: fields of `problem.ValueAndGrad`; reverse mode.
        gauss_newton_model: fields of `problem.GaussNewtonModel`; forward mode.
        directional: slopes of the runs' costs along directions (d, n), which come after z, as
            (d, m, runs); forward mode.
    """

    evaluate: Callable[..., Any]
    value_and_grad: Callable[..., Any]
    gauss_newton_model: Callable[..., Any]
    directional: Callable[..., Any]


class _Numbers(NamedTuple):
    """Weights (m, terms), scales (terms,), penalty ()."""

    weights: Array
    scales: Array
    penalty: Array


class _Costs(NamedTuple):
    """residuals: (m, runs, pieces); those of a lost run are 0 and its cost is in ``lost``, the
    barrier (m, runs), 0 of others. violation, share: (m, runs). columns: (m, runs) each."""

    residuals: Array
    lost: Array
    violation: Array
    share: Array
    columns: dict[str, Array]


class _Group(NamedTuple):
    """What is fixed about the runs of a group. segment: ticks between checkpoints."""

    space: SearchSpace
    runs: RunGroup
    metric: TrainingMetric
    objective: Objective
    segment: int


def _lanes(space: SearchSpace, group: RunGroup, z: Array, data: tuple[Any, Any]) -> Any:
    """Arguments of `rollouts` for candidates z (m, n) in all runs of a group."""
    gains, axes = space.gains, jax.tree.map(lambda _: None, space.gains)
    for e in space.entries:
        value = jax.vmap(e.value_of)(z[:, e.first : e.first + e.count])
        names = e.path.split(".")[1:]
        gains = with_leaf(gains, names, jnp.repeat(value, group.runs, axis=0))
        axes = with_leaf(axes, names, 0)
    again = jnp.tile(jnp.arange(group.runs), len(z))
    shared = spread_axes(group.batch.in_axes[1:], data)
    scenario, path = jax.tree.map(lambda x, a: x[again] if a == 0 else x, data, shared)
    return gains, scenario, path, (axes, *group.batch.in_axes[1:])


def _simulate(group: _Group, z: Array, data: tuple[Any, Any]) -> tuple[MetricColumns, Array]:
    """Columns of the lanes, and when each was lost as a share of the run, or NaN."""
    case, runs = group.runs.case, group.runs.runs
    gains, scenario, path, axes = _lanes(group.space, group.runs, z, data)
    loop = replace(case.loop, metric=group.metric.metric, segment=group.segment)
    ticks, lanes = case.window.ticks, len(z) * runs
    tile = min(TILE, -(-lanes // jax.local_device_count()))
    run = rollouts(loop, gains, scenario, path, ticks, in_axes=axes, tile=tile, memory=MEMORY)
    left, broken = run.final.left_path_at, run.final.non_finite_at
    at = jnp.where(left >= 0, left, broken)
    gone = at >= 0

    def finite(x: Array) -> Array:
        """Ones in place of the NaN of a lost run, which no gradient may meet."""
        return jnp.where(gone.reshape(-1, *[1] * (x.ndim - 1)), jnp.ones_like(x), x)

    report = jax.tree.map(finite, run.report)
    share = jnp.where(gone, at / ticks, jnp.nan)
    return training_columns(case, group.metric, report), share


def _too_fast(space: SearchSpace, group: RunGroup, z: Array) -> Array:
    """Control period over the longest that the law's own memory allows, (m,)."""
    limit = group.case.loop.controller.longest_period

    def longest(one: Array) -> Array:
        return jnp.min(jnp.asarray(limit(space.gains_of(one)), one.dtype))

    return group.case.loop.dt / jax.vmap(longest)(z)


def _residuals(
    group: _Group, z: Array, numbers: _Numbers, columns: MetricColumns, violations: list[Array]
) -> Array:
    """All whose squares add up to the cost of a run, (m, runs, pieces)."""
    shape = (len(z), group.runs.runs)
    weights = numbers.weights
    roots = jnp.sqrt(weights / jnp.sum(weights, axis=-1, keepdims=True))
    parts = []
    for t, term in enumerate(group.objective.terms):
        value = columns.pieces.get(term.column, columns.columns[term.column])
        parts.append(value.reshape(*shape, -1) / numbers.scales[t] * roots[:, t, None, None])
    for value in violations:
        over = jnp.maximum(value + TIGHT, jnp.zeros_like(value))
        parts.append(jnp.sqrt(numbers.penalty) * over[..., None])
    moved = z - jnp.asarray(group.space.start(), z.dtype)[None]
    return _pulled(jnp.concatenate(parts, axis=-1), moved)


def _pulled(residuals: Array, moved: Array) -> Array:
    """Residuals whose squares add up to d (1 + PULL |moved|^2), d being those of ``residuals``.

    A residual sqrt(PULL d) moved for each coordinate gives the pull its curvature; d in it is held
    fixed, and what its own slope would give is put on the slopes of the others, so that values and
    gradients are exact.

    Args:
        residuals: (m, runs, pieces).
        moved: z - z before, (m, n).
    """
    fixed, factor = jax.lax.stop_gradient((residuals, pull_factor(moved)))
    steeper = fixed + factor[:, None, None] * (residuals - fixed)
    root = jnp.sqrt(PULL * jnp.sum(fixed**2, axis=-1, keepdims=True))
    return jnp.concatenate([steeper, root * moved[:, None]], axis=-1)


def _costs(group: _Group, z: Array, numbers: _Numbers, data: tuple[Any, Any]) -> _Costs:
    """Costs of all candidates in the runs of a group.

    A run is lost, too, where the gains need a shorter control period than the loop has.
    """
    measured, lost = _simulate(group, z, data)
    shape = (len(z), group.runs.runs)
    fast = jnp.maximum(_too_fast(group.space, group.runs, z), 1.0)[:, None]
    share = jnp.where(fast > 1, jnp.zeros(shape, z.dtype), lost.reshape(shape))
    gone = ~jnp.isnan(share)
    columns = {name: value.reshape(shape) for name, value in measured.columns.items()}
    missed = [goal.violation(columns) for goal in group.objective.goals]
    residuals = _residuals(group, z, numbers, measured, missed)
    none = jnp.zeros(shape, z.dtype)
    barrier = LOST * (2.0 - jnp.where(gone, share, none) + jnp.log(fast))
    largest = jnp.max(jnp.stack(missed), axis=0) if missed else none - 1
    return _Costs(
        residuals=jnp.where(gone[..., None], jnp.zeros_like(residuals), residuals),
        lost=jnp.where(gone, barrier, none),
        violation=jnp.where(gone, jnp.full_like(none, jnp.inf), largest),
        share=share,
        columns={name: jnp.where(gone, jnp.nan, value) for name, value in columns.items()},
    )


def compile_objective(
    space: SearchSpace,
    groups: tuple[RunGroup, ...],
    metrics: Sequence[TrainingMetric],
    objective: Objective,
) -> CompiledObjective:
    """The compiled functions of a problem.

    Args:
        space: what is searched.
        groups: training runs.
        metrics: what the runs of each group compute.
        objective: what matters.
    """
    plain = [_Group(space, *pair, objective, 0) for pair in zip(groups, metrics, strict=True)]
    segmented = [p._replace(segment=math.isqrt(p.runs.case.window.ticks)) for p in plain]
    each = np.concatenate([group.weights for group in groups])
    shares = each / each.sum()

    def costs(parts: list[_Group], z: Array, *arguments: Any) -> tuple[list[_Costs], Array, Array]:
        """Those of each group, then c (m, runs) and the violation (m,) of all."""
        *numbers, data = arguments
        every = [_costs(p, z, _Numbers(*numbers), own) for p, own in zip(parts, data, strict=True)]
        summed = _joined(*(jnp.sum(c.residuals**2, axis=-1) + c.lost for c in every))
        return every, summed, jnp.max(_joined(*(c.violation for c in every)), axis=1)

    def omega(every: Array) -> Array:
        detached = jax.lax.stop_gradient(every)
        return objective.risk.weights(detached, jnp.asarray(shares, every.dtype))

    def evaluate(z: Array, *arguments: Any) -> tuple[Any, ...]:
        groups_costs, every, violation = costs(plain, z, *arguments)
        lengths = [group.case.window.ticks * group.case.loop.dt for group in groups]
        lost = [c.share * length for c, length in zip(groups_costs, lengths, strict=True)]
        columns = jax.tree.map(_joined, *(c.columns for c in groups_costs))
        return jnp.sum(omega(every) * every, axis=1), every, violation, _joined(*lost), columns

    def value_and_grad(z: Array, *arguments: Any) -> tuple[Array, ...]:
        def total(z: Array) -> tuple[Array, Any]:
            _, every, violation = costs(segmented, z, *arguments)
            value = jnp.sum(omega(every) * every, axis=1)
            return jnp.sum(value), (value, violation)

        gradient, (value, violation) = jax.grad(total, has_aux=True)(z)
        return value, gradient, violation

    def tangents(z: Array, directions: Array, *arguments: Any) -> Any:
        """dr along each direction, (d, m, runs, pieces) a group; r, c and violation."""

        def residuals(z: Array) -> tuple[list[Array], Any]:
            groups_costs, every, violation = costs(plain, z, *arguments)
            values = [c.residuals for c in groups_costs]
            return values, (values, every, violation)

        def along(direction: Array) -> Any:
            moved = jnp.broadcast_to(direction, z.shape)
            _, slope, rest = jax.jvp(residuals, (z,), (moved,), has_aux=True)
            return slope, rest

        return jax.vmap(along, out_axes=(0, None))(directions)

    def gauss_newton_model(z: Array, *arguments: Any) -> tuple[Array, ...]:
        directions = jnp.eye(z.shape[1], dtype=z.dtype)
        slope, (values, every, violation) = tangents(z, directions, *arguments)
        weight = omega(every)
        ends = np.cumsum([group.runs for group in groups])[:-1].tolist()
        of_runs = [
            2 * jnp.einsum("imsp,msp->msi", dr, r) for r, dr in zip(values, slope, strict=True)
        ]
        matrices = [
            2 * jnp.einsum("imsp,jmsp,ms->mij", dr, dr, w)
            for dr, w in zip(slope, jnp.split(weight, ends, axis=1), strict=True)
        ]
        gradients = _joined(*of_runs)
        gradient = jnp.sum(weight[..., None] * gradients, axis=1)
        matrix = sum(matrices[1:], start=matrices[0])
        return jnp.sum(weight * every, axis=1), gradient, matrix, violation, gradients

    def directional(z: Array, directions: Array, *arguments: Any) -> Array:
        slope, (values, _, _) = tangents(z, directions, *arguments)
        each = [2 * jnp.sum(dr * r, axis=-1) for dr, r in zip(slope, values, strict=True)]
        return jnp.concatenate(each, axis=-1)

    return CompiledObjective(
        *map(jax.jit, (evaluate, value_and_grad, gauss_newton_model, directional))
    )


def _joined(*values: Any) -> Any:
    """Arrays (m, runs, ...) of the groups side by side."""
    return jnp.concatenate(values, axis=1)
