"""``lax.scan`` in checkpointed segments: less memory in reverse mode, the same values."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import lax

Carry = TypeVar("Carry")


def segmented(
    step: Callable[[Carry, None], tuple[Carry, Any]], carry: Carry, ticks: int, segment: int
) -> tuple[Carry, Any]:
    """``lax.scan`` over ticks, in checkpointed segments where ``segment`` is not 0.

    Reverse mode then keeps the carry at the borders of the segments, and computes each segment
    again.

    Args:
        step: ``(carry, None) -> (carry, row)``.
        carry: what the first tick begins with.
        ticks: number of steps.
        segment: steps of a segment.

    Returns:
        The last carry, and the rows (ticks, ...).
    """

    def plain(carry: Carry, length: int) -> tuple[Carry, Any]:
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
