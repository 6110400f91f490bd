"""Cerebellar model articulation controller (CMAC): cells, receptive fields, training.

Two inputs, each quantised into 9 intervals; 4 layers, each shifted by one interval, of 3 blocks
per input: 36 hypercubes, of which 4 (one a layer) are active. Weights have the shape
(layer, block of input 1, block of input 2); the flat order is that of the paper, so that state
(3, 3) activates hypercubes 5, 14, 19, 28 (1-based).

Source: Mao et al., Energies 2021, 14, 7802, equations (5)-(12). One reading of the Gaussian
receptive field's "m = 0.5, sigma = 1" had to be chosen: m is the spacing of the means and sigma a
width in the same unit, so that block centres stand at ``4 block + layer - 1`` intervals.
"""

from collections.abc import Callable
from typing import Generic

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.model.blocks import Params
from jaxstage.model.fields import definition, gain, pytree
from jaxstage.numerics.smooth import cell, within

INTERVALS = 9
LAYERS = 4
BLOCKS = 3
SHAPE = (LAYERS, BLOCKS, BLOCKS)


def coordinate(value: Array, width: Array) -> Array:
    """Quantiser input z = clip(value / W + 4.5, 0, 9): 0 lies in the middle cell.

    Args:
        value: (), in the unit of W.
        width: W, interval of the input.

    Returns:
        z in interval widths, ().
    """
    return within(value / width + INTERVALS / 2, 0, INTERVALS)


def blocks(z: Array) -> tuple[Array, Array]:
    """Active block of each layer.

    Args:
        z: (), see `coordinate`.

    Returns:
        Index of the block, 0..2, and its centre in interval widths, both (LAYERS,).
    """
    layer = jnp.arange(LAYERS, dtype=jnp.int32)
    block = (cell(z, INTERVALS) + LAYERS - 1 - layer) // LAYERS
    return block, (LAYERS * block + layer - 1).astype(z.dtype)


@definition
class Receptive(Generic[Params]):
    """Receptive field: how strongly an active hypercube answers.

    Attributes:
        name: what it is called.
        strength: (params, d1, d2) -> xi, (LAYERS,); d1, d2: distances (LAYERS,) to the block
            centres, in intervals.
    """

    name: str
    strength: Callable[[Params, Array, Array], Array]


def _crisp(params: tuple[()], first: Array, second: Array) -> Array:
    return jnp.ones_like(first)


@pytree
class Gaussian:
    """Parameters of the `gaussian` receptive field; only m / sigma acts."""

    spacing: Array = gain("1", "m", "spacing of the means", above=0.0)
    width: Array = gain("1", "sigma", "width, in the unit of the spacing", above=0.0)


def _gaussian(params: Gaussian, first: Array, second: Array) -> Array:
    scale = params.spacing / params.width
    return jnp.exp(-(scale**2) * (first**2 + second**2))


#: xi = 1 on the active hypercubes (conventional CMAC), equations (5)-(6); params ``()``.
crisp = Receptive(name="crisp", strength=_crisp)

#: xi = exp(-m^2 (d1^2 + d2^2) / sigma^2) on the active ones, (10)-(12); params `Gaussian`.
gaussian = Receptive(name="gaussian", strength=_gaussian)


def features(
    receptive: Receptive[Params], params: Params, first: Array, second: Array
) -> tuple[tuple[Array, Array, Array], Array]:
    """Association: the active hypercubes and their strength.

    Args:
        receptive: the receptive field.
        params: its parameters.
        first: coordinate of the first input, () in interval widths, see `coordinate`.
        second: that of the second.

    Returns:
        The index (layer, block, block), each (LAYERS,), into an array of `SHAPE`; xi, (LAYERS,).
    """
    block_1, centre_1 = blocks(first)
    block_2, centre_2 = blocks(second)
    strength = receptive.strength(params, first - centre_1, second - centre_2)
    return (jnp.arange(LAYERS, dtype=jnp.int32), block_1, block_2), strength


def association_matrix() -> np.ndarray:
    """Association matrix A of equation (8): row 9 q1 + q2 marks the 4 hypercubes of that state.

    Returns:
        (81, 36), of 0 and 1. Its rank is 33: the weights of a trained CMAC are not unique.
    """
    matrix = np.zeros((INTERVALS**2, LAYERS * BLOCKS**2))
    for row, (q1, q2) in enumerate(np.ndindex(INTERVALS, INTERVALS)):
        for layer in range(LAYERS):
            b1, b2 = ((q + LAYERS - 1 - layer) // LAYERS for q in (q1, q2))
            matrix[row, BLOCKS**2 * layer + BLOCKS * b1 + b2] = 1.0
    return matrix


def train(weights: Array, active: Array, target: Array, rate: Array) -> Array:
    """Supervised least-mean-squares step W + (alpha / m) a (y - a^T W), equation (9), m = 4 layers.

    Args:
        weights: W, (36,).
        active: a, (36,), one row of the association matrix.
        target: y, desired output, ().
        rate: alpha, (); 0 < alpha < 2 converges.

    Returns:
        The new weights, (36,).
    """
    return weights + rate / LAYERS * active * (target - active @ weights)
