"""Random keys among the types of arrays."""

from typing import Any

import jax
import jax.numpy as jnp


def is_key_type(dtype: Any) -> bool:
    """Whether a type is that of random keys."""
    return jnp.issubdtype(dtype, jax.dtypes.prng_key)
