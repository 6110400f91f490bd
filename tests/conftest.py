"""Double precision and strict types in every test; single precision where a test asks for it."""

import jax
import pytest

from jaxstage.system.runtime import collect_seldom

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
collect_seldom()


def pytest_collection_modifyitems(items):
    """Files marked `long` go first, so that no worker is left alone with one of them at the end."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)


@pytest.fixture
def single():
    """Run a test in single precision."""
    with jax.enable_x64(False):
        yield
