"""Numbers and tables as text: columns apart at any width, and rounding is 0."""

from itertools import cycle, zip_longest

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from simval.cli.repro import beside_theory
from simval.results import limit, plain
from simval.statistics import BIAS, RECOVERY
from simval.text import columns, number

CELLS = st.text("ab0.-", min_size=1, max_size=30)
SIZES = st.floats(1e-30, 1e30)


@given(
    rows=st.lists(st.lists(CELLS, min_size=1, max_size=5), min_size=1, max_size=6),
    least=st.tuples(*[st.sampled_from([-12, -1, 1, 12])] * 5),
)
def test_columns_are_apart_and_one_below_the_other(rows, least):
    lines = columns(rows, *least)
    assert [line.split() for line in lines] == rows
    for place, width in enumerate(least):
        ends = set()
        for row, line in zip(rows, lines, strict=True):
            if place < len(row):
                before = sum(map(len, row[:place]))
                left = np.flatnonzero(np.char.not_equal(list(line), " "))[before]
                ends.add(left + (len(row[place]) - 1 if width > 0 else 0))
        assert len(ends) <= 1


def measured(x):
    """The table of `simval repro`."""
    value, error = next(x), next(x)
    return beside_theory(plain(BIAS("a"), value, error, 9, -value, "theory"))


@given(sizes=st.lists(SIZES, min_size=3, max_size=30))
@example(sizes=[1.23456789e-30, 9.87654321e29, 123.456789])
def test_numbers_of_any_width_leave_a_blank(sizes):
    """As many words in each line as with numbers that are short."""
    wide, short = measured(cycle(sizes)), measured(cycle([2.0]))
    for one, other in zip_longest(wide, short):
        assert len(one.split()) == len(other.split()), one


@given(value=SIZES, share=st.floats(0.0, 1e-12), sign=st.sampled_from([1, -1]))
def test_what_is_only_rounding_is_0(value, share, sign):
    assert number(sign * share * value, 6, value) == "0"
    assert float(number(sign * value, 17)) == sign * value  # nothing is without a size
    assert number(1.1e-12 * value, 2, value) != "0"


def test_a_computed_row_shows_rounding_as_0_but_none_that_is_judged():
    shown = [
        row.shown
        for row in (
            *limit(RECOVERY("T"), 3e-16, 1e-9, "truth"),
            *limit(RECOVERY("T"), 3e-16, 1e-16, "truth"),  # beyond its limit
            *limit(RECOVERY("T"), 3e-11, 1e-9, "truth"),
            *plain(BIAS("x"), 3e-16, 1e-17, 9, 3e-16, "theory"),
        )
    ]
    assert shown == [0.0, 3e-16, 3e-11, 3e-16]
