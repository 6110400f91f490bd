"""A small share of the random uses in the ordinary tests; ``python -m tests.fuzz`` makes many."""

import pytest

from tests.fuzz.__main__ import run_case
from tests.fuzz.kinds import KINDS

#: cases of each kind
CASES = 25


@pytest.fixture(autouse=True)
def configured(monkeypatch):
    """JAX is configured by the tests."""
    monkeypatch.setattr("jaxstage.system.runtime.configure", lambda *_, **__: None)


@pytest.mark.parametrize("kind", KINDS)
def test_random_uses_are_done_or_refused(kind):
    ends = {seed: run_case(kind, seed) for seed in range(CASES)}
    wrong = {seed: faults for seed, (_, faults) in ends.items() if faults}
    assert not wrong, wrong
    assert {how for how, _ in ends.values()} <= {"done", "refused"}
