"""Every claim of the sources, evaluated as printed: tests/errata, docs/errata.md."""

import pytest
import errata.every  # noqa: F401
from errata.claim import CLAIMS, check

EVALUATED = [name for name, claim in CLAIMS.items() if claim.evaluate]


@pytest.mark.parametrize("name", EVALUATED)
def test_claim(name):
    check(CLAIMS[name])
