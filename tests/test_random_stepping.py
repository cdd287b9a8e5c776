"""Random runs of time stepping, of all kinds; the long form is a command, see `stress/random_runs.py`."""

import pytest
from stress.random_runs import KINDS, check


@pytest.mark.parametrize("kind", range(len(KINDS)))
def test_random_runs(kind):
    """No energy from friction or impacts, no NaN, no hang, no error."""
    for seed in range(kind, 48, len(KINDS)):
        _, fault = check(seed)
        assert not fault, seed


@pytest.mark.parametrize("seed", [1611, 2791, 5207, 5399, 5903, 12707])
def test_chains_at_their_stops(seed):
    """Contact and joint stops that hold a chain together, and impacts that wedge it (2791, 12707)."""
    kind, fault = check(seed)
    assert kind == "chain"
    assert not fault
