"""Double precision and strict types in every test; single precision where a test asks for it."""

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture
def single():
    """Run a test in single precision."""
    with jax.enable_x64(False):
        yield
