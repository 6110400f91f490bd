"""Reparametrisation: an unconstrained number z as a value inside its box, and back.

| name | value | one unit of z |
|---|---|---|
| `logarithmic` | exp(m + h tanh(z / h)), m and h of the logarithms | about a factor e |
| `boxed` | m + h tanh(z / 2) | about half of h, half the box |
| `linear` | before + scale z, no box | the magnitude of the value before, 1 where that is 0 |
| `ordered` | low + (high - low) cumulative softmax(z, 0) | about a factor e of one gap |

m: middle, h: half width of the box.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxstage.model.fields import definition

#: a value at the edge of its box starts so close to it, in half widths: at the edge nothing moves
EDGE = 0.98
#: smallest gap of ordered values at the start, as a share of the box
SMALLEST_GAP = 1e-3


@definition
class Transform:
    """A bijection between the real numbers and a box.

    All arrays have the shape of the setting.

    Attributes:
        name: as files and options call it.
        forward: (z, low, high, before) -> values; traceable.
        inverse: (values, low, high, before) -> z; on the host.
    """

    name: str
    forward: Callable[[Array, np.ndarray, np.ndarray, np.ndarray], Array]
    inverse: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def _atanh_in_box(value: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """artanh of where a value stands in its box, -EDGE..EDGE."""
    return np.arctanh(np.clip((2 * value - low - high) / (high - low), -EDGE, EDGE))


def _log_forward(z: Array, low: np.ndarray, high: np.ndarray, before: np.ndarray) -> Array:
    middle, half = jnp.asarray(np.log(low * high) / 2), jnp.asarray(np.log(high / low) / 2)
    return jnp.exp(middle + half * jnp.tanh(z / half))


def _log_inverse(
    value: np.ndarray, low: np.ndarray, high: np.ndarray, before: np.ndarray
) -> np.ndarray:
    return np.log(high / low) / 2 * _atanh_in_box(np.log(value), np.log(low), np.log(high))


def _boxed_forward(z: Array, low: np.ndarray, high: np.ndarray, before: np.ndarray) -> Array:
    middle, half = jnp.asarray((low + high) / 2), jnp.asarray((high - low) / 2)
    return middle + half * jnp.tanh(z / 2)


def _boxed_inverse(
    value: np.ndarray, low: np.ndarray, high: np.ndarray, before: np.ndarray
) -> np.ndarray:
    return 2 * _atanh_in_box(value, low, high)


def _scale(before: np.ndarray) -> np.ndarray:
    return np.where(before != 0, np.abs(before), 1.0)


def _linear_forward(z: Array, low: np.ndarray, high: np.ndarray, before: np.ndarray) -> Array:
    return jnp.asarray(before) + jnp.asarray(_scale(before)) * z


def _linear_inverse(
    value: np.ndarray, low: np.ndarray, high: np.ndarray, before: np.ndarray
) -> np.ndarray:
    return (value - before) / _scale(before)


def _ordered_forward(z: Array, low: np.ndarray, high: np.ndarray, before: np.ndarray) -> Array:
    gaps = jax.nn.softmax(jnp.append(z, jnp.zeros((), z.dtype)))
    return jnp.asarray(low) + jnp.asarray(high - low) * jnp.cumsum(gaps)[:-1]


def _ordered_inverse(
    value: np.ndarray, low: np.ndarray, high: np.ndarray, before: np.ndarray
) -> np.ndarray:
    ends = np.concatenate([low[:1], value, high[:1]])
    gaps = np.maximum(np.diff(ends) / (high[0] - low[0]), SMALLEST_GAP)
    return np.log(gaps[:-1] / gaps[-1])


#: A box of positive values: steps are factors.
logarithmic = Transform(name="log", forward=_log_forward, inverse=_log_inverse)

#: A box of values of any sign.
boxed = Transform(name="tanh", forward=_boxed_forward, inverse=_boxed_inverse)

#: No box.
linear = Transform(name="linear", forward=_linear_forward, inverse=_linear_inverse)

#: A vector of increasing values in one box, such as the centres of fuzzy sets.
ordered = Transform(name="ordered", forward=_ordered_forward, inverse=_ordered_inverse)

#: by the names that files and options use
TRANSFORMS: dict[str, Transform] = {t.name: t for t in (logarithmic, boxed, linear, ordered)}
