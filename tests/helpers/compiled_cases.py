"""Loops for the tests of the compiled engine."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

import jaxstage as js
from jaxstage.metrics import tracking
from jaxstage.model.fields import replace
from jaxstage.simulate.rollout import compiled_form, start

TICKS = 30


@functools.cache
def case(name):
    found = js.build(name)
    return found._replace(loop=replace(found.loop, metric=tracking))


def run(c, engine, gains, ticks=TICKS, **changes):
    loop = replace(c.loop, engine=engine, **changes)
    return js.simulate(loop, gains, c.scenario, c.path, ticks)


def many(c, engine, gains, **more):
    return jax.jit(jax.vmap(lambda g: run(c, engine, g, **more)))(gains)


def close(a, b, tolerance):
    """Leaf by leaf, relative to the largest number of the leaf."""
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        x, y = np.asarray(x, float), np.asarray(y, float)
        np.testing.assert_array_equal(np.isnan(x), np.isnan(y))
        scale = np.nanmax(np.abs(x), initial=1e-12) if x.size else 1.0
        np.testing.assert_allclose(y / scale, x / scale, rtol=0, atol=tolerance)


def program(c, **changes):
    loop = replace(c.loop, **changes)
    carry = jax.eval_shape(lambda: start(loop, c.gains, c.scenario, c.path))
    zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), carry)
    return compiled_form(loop, c.gains, c.scenario, c.path, zeros)[0]


def shared_by_all(one):
    """What `kernel` is told of a program whose runs differ in their inputs alone."""
    return (False,) * (len(one.shared) + len(one.carry))
