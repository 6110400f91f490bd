"""The sets and the rules of a fuzzy system."""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from jaxstage.controllers.parts.fuzzy import (
    REACH,
    FuzzySets,
    infer,
    membership,
    set_names,
    strengths,
)
from jaxstage.plot.page import page
from jaxstage.plot.style import AXIS_COLOURS, NORMAL, REFERENCE, SMALL, dress

POINTS = 121


def memberships(sets: FuzzySets, name: str = "normalised input") -> Figure:
    """The membership functions of one input over its range. name: of the input."""
    drawn = page("membership functions", "", "", (10.0, 4.5))
    ax = drawn.add_subplot()
    x = np.linspace(-REACH, REACH, 601)
    values = np.asarray(jax.vmap(lambda v: membership(sets, v))(jnp.asarray(x)))
    for k, (label, values_k) in enumerate(zip(set_names(values.shape[1]), values.T, strict=True)):
        colour = AXIS_COLOURS[k % len(AXIS_COLOURS)]
        ax.plot(x, values_k, color=colour, linewidth=1.8)
        ax.annotate(label, (float(np.asarray(sets.centres)[k]), 1.02), ha="center", color=colour)
    dress(ax, name, "degree of membership")
    ax.set_ylim(0, 1.12)
    return drawn


def rule_surface(
    first: FuzzySets,
    second: FuzzySets,
    consequents: jax.Array,
    output: str,
    inputs: tuple[str, str] = ("X1", "X2"),
) -> Figure:
    """What the rules infer over both inputs, with the consequents written at their centres.

    consequents: (sets of the first, of the second). output: name and unit, e.g. ``K_P in 1/s2``.
    """
    x = 1.15 * jnp.linspace(-REACH, REACH, POINTS)  # room for the numbers at the edge

    def inferred(a: jax.Array, b: jax.Array) -> jax.Array:
        return infer(consequents, strengths(first, second, a, b))

    surface = jax.jit(jax.vmap(lambda a: jax.vmap(lambda b: inferred(a, b))(x)))(x)
    drawn = page(output, "", "", (9.0, 7.6))
    ax = drawn.add_subplot()
    filled = ax.contourf(np.asarray(x), np.asarray(x), np.asarray(surface), 24, cmap="cividis")
    drawn.colorbar(filled, ax=ax, label=output)
    box = {"facecolor": "white", "alpha": 0.6, "linewidth": 0, "pad": 1}
    for a, row in zip(np.asarray(first.centres), np.asarray(consequents), strict=True):
        for b, value in zip(np.asarray(second.centres), row, strict=True):
            ax.annotate(
                f"{value:.4g}",
                (b, a),
                ha="center",
                va="center",
                fontsize=SMALL - 2,
                color=REFERENCE,
                bbox=box,
            )
    ax.set_xlabel(inputs[1], fontsize=NORMAL)
    ax.set_ylabel(inputs[0], fontsize=NORMAL)
    return drawn
