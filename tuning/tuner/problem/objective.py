"""What matters: weighted terms, hard goals, and how the runs of a training set are summed up.

    c_s = sum_t w_t (v_ts / scale_t)^2 / sum_t w_t + mu sum_g max(0, violation_gs + TIGHT)^2
          + PULL |z - z of the gains before|^2
    J   = sum_s omega_s c_s,   omega: `mean`, `worst` or `cvar` of the c_s

v_ts: figure t of run s; scale: what counts as 1, by default the figure of the gains before (for the
changes of a smooth command a little more, `figures.least_scale`), so that J is about 1 before and a
halved error gives a quarter. Everything is a square, so least squares applies.
The pull is weak: what does not matter stays as it was, and no search drifts to the edge of a box.

A goal is a comparison; its violation is (left - right) / |right|, positive when it is missed. mu
grows while the best gains miss a goal: the terms are minimised among what meets the goals. A lost
run costs LOST (2 - share of the run done): finite, above every run that is not lost, less the later
it is lost.
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
#: what a gain costs that moves by one unit of z, about a factor e
PULL = 1e-4


class Term(NamedTuple):
    """A figure to make small. column: see `figures`. scale: what counts as 1, in the unit of the
    column; None: the figure of the gains before, root mean square over the runs, or
    `figures.least_scale` where that is more."""

    column: str
    weight: float = 1.0
    scale: float | None = None


@definition
class Risk:
    """How runs are summed up. weights(costs (m, runs), shares (runs,)) -> (m, runs), which sum to 1
    over the runs; shares: how much each run counts, sum 1."""

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


#: The mean over the runs.
mean = Risk(name="mean", weights=_mean)

#: The worst run alone.
worst = Risk(name="worst", weights=_worst)


def cvar(share: float = 0.25) -> Risk:
    """Conditional value at risk: the mean of the worst share of the runs. share: in (0, 1]."""
    if not 0 < share <= 1:
        raise ValueError(f"cvar share = {share:g}: must be in (0, 1]")
    return Risk(name=f"cvar {share:g}", weights=_tail(share))


#: by the names that options use
RISKS: dict[str, Callable[[], Risk]] = {"mean": lambda: mean, "worst": lambda: worst, "cvar": cvar}


class Goal(NamedTuple):
    """A comparison that every training run must meet. names: the columns it reads."""

    text: str
    names: tuple[str, ...]
    violation: Callable[[Mapping[str, Any]], Array]


def parse_goals(text: str, columns: Iterable[str]) -> tuple[Goal, ...]:
    """The goals of ``contour_max_um < 20 and growth < 1.2``.

    Raises ValueError, one line, for what is not a comparison or several joined by ``and``.
    """
    found = parse(text, dict.fromkeys(columns, float), "--goal")
    return tuple(goal for part in _joined(found.tree, text) for goal in _goals(part, text))


def _joined(tree: ast.expr, text: str) -> list[ast.expr]:
    if isinstance(tree, ast.BoolOp) and isinstance(tree.op, ast.And):
        return [part for value in tree.values for part in _joined(value, text)]
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
    made = []
    for left, op, right in zip(sides, tree.ops, sides[1:], strict=False):
        if not isinstance(op, ast.Lt | ast.LtE | ast.Gt | ast.GtE):
            raise wrong
        pair = (left, right) if isinstance(op, ast.Lt | ast.LtE) else (right, left)
        single = ast.Compare(left, [op], [right])
        made.append(_goal(ast.unparse(single), *pair))
    return made


def _goal(text: str, smaller: ast.expr, larger: ast.expr) -> Goal:
    sides = [node for side in (smaller, larger) for node in ast.walk(side)]
    names = tuple(dict.fromkeys(node.id for node in sides if isinstance(node, ast.Name)))

    def violation(columns: Mapping[str, Any]) -> Array:
        """(smaller - larger) over the magnitude of the side without columns, else of the sum."""
        low, high = number(smaller, columns), number(larger, columns)
        fixed = [
            jnp.asarray(number(side, {}))
            for side in (smaller, larger)
            if not any(isinstance(node, ast.Name) for node in ast.walk(side))
        ]
        size = jnp.abs(fixed[0]) if fixed else jnp.abs(low) + jnp.abs(high)
        return (low - high) / jnp.where(size > 0, size, jnp.ones_like(size))

    return Goal(text, names, violation)
