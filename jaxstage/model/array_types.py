"""Shapes of the arrays that cross the borders between blocks, as jaxtyping annotations.

``axes`` is the number of machine axes, ``substeps`` that of the plant's steps in a control period.
All shapes are those of ONE run: batches are made by ``jax.vmap``.
"""

from typing import TypeAlias

from jaxtyping import Array, Float, Int, Key

#: one real number
Scalar: TypeAlias = Float[Array, ""]

#: one real number an axis
PerAxis: TypeAlias = Float[Array, " axes"]

#: a count of control periods
Tick: TypeAlias = Int[Array, ""]

#: a random key of `jax.random.key`
RandomKey: TypeAlias = Key[Array, ""]
