"""Objective: weighted least squares of metrics, penalised goals, and a risk measure over runs.

    d_s = sum_t w_t (v_ts / scale_t)^2 / sum_t w_t + mu sum_g max(0, violation_gs + TIGHT)^2
    c_s = d_s (1 + PULL |z - z of the gains before|^2)
    J   = sum_s omega_s c_s,   omega: mean, worst case or CVaR of the c_s

v_ts: metric t of run s; scale: what counts as 1, by default the metric of the gains before (for the
changes of a smooth command a little more, `training_metrics.least_scale`), so that J is about 1
before and a halved error gives a quarter. Everything is a square, so Gauss-Newton applies. The pull
is a weak regularisation, relative to what is left of the cost: what does not matter stays as it
was, no search drifts to the edge of a box, and however far J falls, a step that gains more than
some tenths of a per cent is worth it.

A goal is an inequality constraint; its violation is (left - right) / |right|, positive when it is
missed. The quadratic penalty mu grows while the best gains miss a goal: the terms are minimised
among what meets the goals. A lost run has an extended barrier in place of its cost,
LOST (2 - share of the run done): finite, above every run that is not lost, less the later it is
lost.
"""

import ast
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxstage.model.fields import definition
from tuning.uncertainty.specification import number, parse

#: what a lost run costs at least
LOST = 1e6
#: goals are aimed at this share inside of them, so that a small rest of violation does not matter
TIGHT = 0.01
#: share of the cost that a gain costs which moves by one unit of z, about a factor e
PULL = 1e-4


def pull_factor(moved: Any) -> Any:
    """1 + PULL |z - z before|^2, by which the pull towards the gains before raises J.

    Args:
        moved: z - z before, (..., n).

    Returns:
        (...,).
    """
    return 1 + PULL * (moved**2).sum(axis=-1)


class Term(NamedTuple):
    """A metric to make small.

    Attributes:
        column: of `training_metrics`.
        weight: w, > 0.
        scale: what counts as 1, in the unit of the column; None: the metric of the gains before,
            root mean square over the runs, or `training_metrics.least_scale` where that is more.
    """

    column: str
    weight: float = 1.0
    scale: float | None = None


@definition
class Risk:
    """Risk measure: how the costs of the runs are summed up.

    Attributes:
        name: of the measure.
        weights: (costs (m, runs), shares (runs,)) -> omega (m, runs), which sum to 1 over the
            runs. shares: how much each run counts, sum 1.
    """

    name: str
    weights: Callable[[Array, Array], Array]


def _mean(costs: Array, shares: Array) -> Array:
    return jnp.broadcast_to(shares, costs.shape)


def _tail(level: float) -> Callable[[Array, Array], Array]:
    """Weights of the worst runs that hold a share ``level``; the one at the border in part."""

    def weights(costs: Array, shares: Array) -> Array:
        order = jnp.argsort(-costs, axis=-1)
        sorted_shares = shares[order]
        above = jnp.cumsum(sorted_shares, axis=-1) - sorted_shares
        taken = jnp.clip(level - above, 0.0, sorted_shares) / level
        back = jnp.argsort(order, axis=-1)
        return jnp.take_along_axis(taken, back, axis=-1)

    return weights


def _worst(costs: Array, shares: Array) -> Array:
    """Runs that count little are the worst only when they are lost."""
    counts = (shares > 0.5 * jnp.max(shares))[None] | (costs >= LOST)
    best = jnp.argmax(jnp.where(counts, costs, jnp.zeros_like(costs)), axis=-1)
    return (jnp.arange(costs.shape[-1])[None] == best[:, None]).astype(costs.dtype)


#: Expected cost: the mean over the runs.
mean = Risk(name="mean", weights=_mean)

#: Worst case: the worst run alone.
worst = Risk(name="worst", weights=_worst)


def cvar(share: float = 0.25) -> Risk:
    """Conditional value at risk (CVaR): the mean of the worst share of the runs.

    Args:
        share: in (0, 1].

    Raises:
        ValueError: the share is out of its range.
    """
    if not 0 < share <= 1:
        raise ValueError(f"cvar share = {share:g}: must be in (0, 1]")
    return Risk(name=f"cvar {share:g}", weights=_tail(share))


#: by the names that options use
RISKS: dict[str, Callable[[], Risk]] = {"mean": lambda: mean, "worst": lambda: worst, "cvar": cvar}


class Goal(NamedTuple):
    """Inequality constraint that every training run must meet.

    Attributes:
        text: the comparison as it was written.
        names: the columns that it reads.
        violation: columns -> relative violation, positive where it is missed.
    """

    text: str
    names: tuple[str, ...]
    violation: Callable[[Mapping[str, Any]], Array]


class Objective(NamedTuple):
    """What matters: terms to make small, goals to meet, and the risk measure over the runs."""

    terms: tuple[Term, ...]
    goals: tuple[Goal, ...] = ()
    risk: Risk = mean


def parse_goals(text: str, columns: Iterable[str]) -> tuple[Goal, ...]:
    """The goals of ``contour_max_um < 20 and growth < 1.2``.

    Args:
        text: comparisons joined by ``and``.
        columns: the names that they may read.

    Raises:
        ValueError: in one line, for anything else.
    """
    tree = parse(text, dict.fromkeys(columns, float), "--goal").tree
    return tuple(goal for part in _conjuncts(tree) for goal in _goals(part, text))


def _conjuncts(tree: ast.expr) -> list[ast.expr]:
    if isinstance(tree, ast.BoolOp) and isinstance(tree.op, ast.And):
        return [part for value in tree.values for part in _conjuncts(value)]
    return [tree]


def _goals(tree: ast.expr, text: str) -> list[Goal]:
    """One comparison, or a chain of them as several."""
    wrong = ValueError(
        f"--goal '{text}': '{ast.unparse(tree)}' must be a comparison by < <= > or >=, several "
        "joined by and"
    )
    if not isinstance(tree, ast.Compare):
        raise wrong
    sides = [tree.left, *tree.comparators]
    goals = []
    for left, op, right in zip(sides, tree.ops, sides[1:], strict=False):
        if not isinstance(op, ast.Lt | ast.LtE | ast.Gt | ast.GtE):
            raise wrong
        pair = (left, right) if isinstance(op, ast.Lt | ast.LtE) else (right, left)
        goals.append(_goal(ast.unparse(ast.Compare(left, [op], [right])), *pair))
    return goals


def _names(tree: ast.expr) -> list[str]:
    return [node.id for node in ast.walk(tree) if isinstance(node, ast.Name)]


def _goal(text: str, smaller: ast.expr, larger: ast.expr) -> Goal:
    def violation(columns: Mapping[str, Any]) -> Array:
        """(smaller - larger) over the magnitude of the side without columns, else of the sum."""
        low, high = number(smaller, columns), number(larger, columns)
        fixed = [jnp.asarray(number(side, {})) for side in (smaller, larger) if not _names(side)]
        size = jnp.abs(fixed[0]) if fixed else jnp.abs(low) + jnp.abs(high)
        return (low - high) / jnp.where(size > 0, size, jnp.ones_like(size))

    return Goal(text, tuple(dict.fromkeys(_names(smaller) + _names(larger))), violation)
