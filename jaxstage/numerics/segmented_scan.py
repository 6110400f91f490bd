"""``lax.scan`` in checkpointed segments: less memory in reverse mode, the same values."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax


def segmented(
    step: Callable[[Any, Any], tuple[Any, Any]], carry: Any, ticks: int, segment: int
) -> tuple[Any, Any]:
    """Scan over the ticks; in checkpointed segments, where ``segment`` is not 0."""

    def plain(carry: Any, length: int) -> tuple[Any, Any]:
        return lax.scan(step, carry, None, length=length)

    if not segment or segment >= ticks:
        return plain(carry, ticks)
    whole, rest = divmod(ticks, segment)
    inner = jax.checkpoint(lambda c: plain(c, segment), prevent_cse=False)
    carry, rows = lax.scan(lambda c, _: inner(c), carry, None, length=whole)
    rows = jax.tree.map(lambda r: r.reshape(whole * segment, *r.shape[2:]), rows)
    if rest:
        carry, last = plain(carry, rest)
        rows = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), rows, last)
    return carry, rows
