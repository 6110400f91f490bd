"""Fuzzy inference of two inputs: Gaussian sets, product inference, centre-average defuzzifier.

    mu_k(x) = exp(-((x - c_k) / sigma)^2)
    xi_ab = mu_a(x1) mu_b(x2) / sum,   sum of xi = 1,   y = sum_ab theta_ab xi_ab

Row a belongs to the first input, column b to the second. The normalised mu is computed as a
softmax: far from every set it has no 0/0, where the plain quotient underflows.

Source: Science Progress 2021, doi:10.1177/00368504211011847: product inference engine, singleton
fuzzifier and centre-average defuzzifier, as L.-X. Wang defines them. Number, shape and width of the
sets are lost with its figures and chosen here.
"""

import math
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.model.fields import gain, pytree

#: names of seven sets, from negative big to positive big
LABELS = ("NB", "NM", "NS", "ZO", "PS", "PM", "PB")

#: centre of the outermost set; inputs are limited to it
REACH = 3.0

#: width with which sets at distance 1 cross at one half
HALF_CROSSING = 0.5 / math.sqrt(math.log(2.0))


@pytree
class FuzzySets:
    """Gaussian fuzzy sets of one input."""

    centres: Array = gain("1", "c", "centres of the sets", shape="(sets,)")
    width: Array = gain("1", "sigma", "width of the sets", above=0.0)


def seven_sets() -> FuzzySets:
    """The usual seven sets, NB to PB: centres -3 ... 3, neighbours crossing at one half."""
    centres, width = np.arange(-3.0, 4.0), np.array(HALF_CROSSING)
    return FuzzySets(centres=cast(Array, centres), width=cast(Array, width))


def limited(x: Array) -> Array:
    """Smooth limiter 3 tanh x: any input into the range of the sets."""
    return REACH * jnp.tanh(x)


def _exponent(sets: FuzzySets, x: Array) -> Array:
    return -(((x - sets.centres) / sets.width) ** 2)


def membership(sets: FuzzySets, x: Array) -> Array:
    """Degrees of membership mu_k(x), (sets,), at x, ()."""
    return jnp.exp(_exponent(sets, x))


def degrees(sets: FuzzySets, x: Array) -> Array:
    """Normalised degrees of membership mu_k(x) / sum of mu, (sets,); finite for finite x, ()."""
    return jax.nn.softmax(_exponent(sets, x))


def strengths(first: FuzzySets, second: FuzzySets, x1: Array, x2: Array) -> Array:
    """Normalised rule strengths by product inference.

    Args:
        first: sets of the first input.
        second: sets of the second.
        x1: first input, ().
        x2: second input, ().

    Returns:
        xi, (sets of the first input, sets of the second), of sum 1.
    """
    return degrees(first, x1)[:, None] * degrees(second, x2)[None, :]


def infer(consequents: Array, xi: Array) -> Array:
    """Centre-average defuzzifier y = sum theta xi, (); consequents and xi: (sets, sets)."""
    return jnp.sum(consequents * xi)


def levels(table: str) -> np.ndarray:
    """A rule table in words as numbers -3 (NB) ... 3 (PB).

    Args:
        table: rows in lines, labels apart by blanks.

    Returns:
        (rows, columns), whole numbers.

    Raises:
        ValueError: for an unknown label, and for rows of different lengths.
    """
    rows = [line.split() for line in table.strip().splitlines()]
    if len({len(row) for row in rows}) != 1:
        raise ValueError("the rows of a rule table need the same length")
    unknown = sorted({label for row in rows for label in row} - set(LABELS))
    if unknown:
        raise ValueError(f"unknown set {unknown[0]}: use one of {', '.join(LABELS)}")
    return np.array([[LABELS.index(label) - 3 for label in row] for row in rows])


def consequents(base: float, spread: float, table: str) -> Array:
    """Rule consequents base + spread level / 3.

    Args:
        base: consequent of the rules ZO.
        spread: of the rules PB above it, in its unit.
        table: the rules in words, see `levels`.

    Returns:
        (rows, columns) in the unit of ``base``, a numpy array.
    """
    return cast(Array, base + spread * levels(table) / 3)


def set_names(count: int) -> tuple[str, ...]:
    """Linguistic labels of ``count`` sets: those of seven, else numbers from 1."""
    return LABELS if count == len(LABELS) else tuple(str(k + 1) for k in range(count))


def rules_text(
    values: Array | np.ndarray, output: str, inputs: tuple[str, str] = ("X1", "X2")
) -> str:
    """A rule base as people read it, one line a row of the first input.

    Args:
        values: consequents, (sets of the first input, sets of the second).
        output: name and unit, e.g. ``K_P in 1/s2``.
        inputs: names of the two.
    """
    table = np.asarray(values, float)
    names, labels = map(set_names, table.shape)
    cells = [[f"{value:.4g}" for value in row] for row in table]
    wide = max(len(text) for text in [*labels, *(cell for row in cells for cell in row)])
    head = f"if {inputs[0]} is"
    margin = max(len(head), *map(len, names))
    first = f"{output}: rows {inputs[0]}, columns {inputs[1]}"
    second = f"{head:<{margin}} | " + " ".join(f"{label:>{wide}}" for label in labels)
    body = [
        f"{name:<{margin}} | " + " ".join(f"{cell:>{wide}}" for cell in row)
        for name, row in zip(names, cells, strict=True)
    ]
    return "\n".join([first, second, *body])
