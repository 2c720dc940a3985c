"""A ranking with ties."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from simval.ranking import ranked

SIZES = st.dictionaries(
    st.text("abcdef", min_size=1, max_size=3), st.floats(1e-3, 1e3), min_size=1
)


@given(SIZES, st.floats(0.0, 10.0))
def test_who_is_not_told_apart_from_an_end_stands_beside_it(sizes, width):
    def apart(one, other):
        return abs(sizes[one] - sizes[other]) > width

    found = ranked(sizes, apart)
    assert sorted(found.order) == sorted(sizes)
    assert all(np.diff([sizes[name] for name in found.order]) >= 0.0)
    for end, tied in ((found.order[0], found.best), (found.order[-1], found.worst)):
        assert tied[0] == end
        for name in sizes:
            alike = f"{sizes[name]:.3g}" == f"{sizes[end]:.3g}"
            assert (name in tied) == (name == end or alike or not apart(end, name))
    assert found.tied == (found.order[-1] in found.best)


def test_what_reads_the_same_is_tied_however_surely_it_differs():
    sizes = {"a": 1.0001, "b": 1.0004, "c": 1.006}
    found = ranked(sizes, lambda one, other: True)
    assert found.best == ("a", "b")
    assert found.worst == ("c",)
    assert ranked({"a": 1.0, "b": 1.0004}, lambda one, other: True).tied
