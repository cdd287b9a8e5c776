"""The short form of the stress suite; `python tests/stress/run.py --long` is the long one."""

import pytest
from stress_cases import CASES


@pytest.mark.parametrize("name", CASES)
def test_case(name):
    findings = list(CASES[name](False))
    assert findings
    assert not [finding for finding in findings if finding.wrong]
