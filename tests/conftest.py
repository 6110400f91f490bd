"""Double precision and strict types in every test; single precision where a test asks for it."""

import os
import tempfile
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

# the workers of one test session share what they compile
_SESSION = os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid()))
_CACHE = Path(tempfile.gettempdir()) / f"jaxstage-tests-{_SESSION}"
jax.config.update("jax_compilation_cache_dir", str(_CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


@pytest.fixture
def single():
    """Run a test in single precision."""
    with jax.enable_x64(False):
        yield
