"""The bench of `jaxstage.testing` for the laws under test, each compiled once."""

import functools

import jax.numpy as jnp

from jaxstage import testing
from jaxstage.testing import CASES as CASES
from jaxstage.testing import MOVING as MOVING
from jaxstage.testing import bench as bench
from jaxstage.testing import close as close
from tests.helpers.batteries import ENTRIES


@functools.cache
def compiled(name, dtype=jnp.float64):
    """`testing.compiled` of an entry; one program a type, so that no test traces it again."""
    (law,) = (entry.make() for entry in ENTRIES if entry.name == name)
    return testing.compiled(law)
