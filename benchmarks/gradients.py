"""What a gradient costs, as a multiple of the run itself."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

import jaxstage as js

from .cases import Work, compiled, work

#: tuned parameters: two axes of each
NAMES = ("slope", "rate", "credit", "error_width")


def parameters(work: Work) -> Array:
    """The eight tuned parameters of every run, (lanes, 8)."""
    return jnp.concatenate([getattr(work.gains, name) for name in NAMES], axis=1)


def _error(work: Work) -> Callable[[Array, Any, Any], Array]:
    """ATE of one run from its eight parameters."""

    def error(values: Array, gains: Any, plant: Any) -> Array:
        own = js.replace(gains, **dict(zip(NAMES, values.reshape(4, 2), strict=True)))
        scenario = js.replace(work.scenario, plant=plant)
        return js.simulate(work.loop, own, scenario, work.path, work.ticks).report

    return error


def gradient(work: Work, derivative: Callable[..., Any]) -> Callable[[], Any]:
    """``derivative`` (of one run) over the batch: jax.grad, jax.jacfwd, or nothing."""
    every = jax.jit(jax.vmap(derivative(_error(work))))
    return lambda: every(parameters(work), work.gains, work.scenario.plant)


def segmented(dtype: str, lanes: int, ticks: int) -> Work:
    """Runs whose scan is checkpointed in segments of about sqrt(ticks)."""
    return work("dfcmac", dtype, lanes, ticks, segment=math.isqrt(ticks))


def programs(dtype: str, lanes: int, ticks: int) -> dict[str, Callable[[], Any]]:
    """The run, and its derivatives by three ways."""
    plain = work("dfcmac", dtype, lanes, ticks)
    return {
        "forward": gradient(plain, lambda f: f),
        "reverse, segments": gradient(segmented(dtype, lanes, ticks), jax.grad),
        "reverse, plain scan": gradient(plain, jax.grad),
        "jacfwd, 8 parameters": gradient(plain, jax.jacfwd),
        "engine, forward": gradient(compiled(plain), lambda f: f),
        "engine, reverse": gradient(compiled(plain), jax.grad),
        "engine, jacfwd, 8": gradient(compiled(plain), jax.jacfwd),
    }
