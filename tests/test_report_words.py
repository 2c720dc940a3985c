"""A value with its standard error is spelled for any two doubles."""

import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from simval.report.words import measured

MOST = 1e307  # what is rounded up from the greatest double cannot be read


@given(st.floats(-MOST, MOST), st.floats(5e-324, MOST))
@example(0.0, 5e-324)
@example(1e-310, 5e-324)
@example(1e300, 1e-300)
@example(-1e307, 1e307)
def test_any_double_is_spelled_shortly_and_read_back(value, error):
    words = measured(value, error)
    assert len(words) < 60
    first, second = re.fullmatch(r"\(?(\S+) ± (\S+?)(?:\)e.*)?", words).groups()
    ten = re.search(r"\)(e.*)", words)
    power = ten[1] if ten else ""
    assert float(first + power) == pytest.approx(value, abs=0.51 * error, rel=5e-3)
    assert float(second + power) == pytest.approx(
        error, rel=0.6, abs=1e-16 * abs(value)
    )
