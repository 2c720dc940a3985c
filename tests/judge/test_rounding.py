"""A cell computed again is shown beside theory, with the digits that mean something."""

import math

from hypothesis import example, given
from hypothesis import strategies as st

from simval.cli.repro import apart, beside_theory, rounded
from simval.results import exact, limit, plain, unjudged
from simval.statistics import BIAS, NORM_OVER_NOISE
from simval.sweep.run import load_run

NUMBERS = st.floats(-1e200, 1e200)
CELL = "attitude(geometry=3,noise_std=0.02,samples=65536)@1"


@given(NUMBERS, st.floats(1e-200, 1e200))
@example(0.0, 1e-3)
@example(-2.5e-4, 1.0)  # far below its error
@example(9.9999, 0.0099)
@example(1.0, 1e-30)  # an error below the digits of a float
def test_rounding_costs_a_twentieth_of_the_error_at_most(value, error):
    written = float(rounded(value, error))
    # the last digit is the second one of the error, from a tenth to a hundredth of it;
    # beyond 16 digits a float has none, and below its error a value has one digit
    room = max(0.05 * error, 0.5e-15 * abs(value)) * (1.0 + 1e-9)
    assert abs(written - value) <= room
    if abs(value) > error > 1e-13 * abs(value):
        digits = len(rounded(value, error).lstrip("-").partition("e")[0]) - 1
        assert digits <= math.log10(abs(value) / error) + 3.0


@given(st.floats(), st.floats() | st.just(0.0))
def test_any_numbers_are_written_and_read_back(value, error):
    text = rounded(value, error)
    assert math.isnan(float(text)) == math.isnan(value)
    assert len(text) < 30


@given(NUMBERS, NUMBERS, st.floats(1e-100, 1e200))
def test_the_distance_is_in_standard_errors(value, prediction, error):
    (row,) = plain(BIAS("x"), value, error, 1000, prediction, "order 2")
    number = (value - prediction) / error
    # to a tenth; of a great one as many digits as a float has
    found = float(apart(row).removesuffix(" s.e."))
    assert abs(found - number) <= 0.05 + 1e-15 * abs(number)


def test_a_table_of_each_kind_of_row():
    rows = (
        *plain(BIAS("x"), -2.34e-4, 1.76e-5, 10**6, -2.52e-4, "order 2"),
        *exact(BIAS("y"), 1.0, 1.0 + 2**-52, "exact", 1e-15),
        *limit(BIAS("z"), 0.25, 0.5, "limit"),
        *unjudged(NORM_OVER_NOISE(), 41.425344528),
    )
    assert [line.split() for line in beside_theory(rows)] == [
        ["statistic", "measured", "standard", "error", "predicted", "apart", "theory"],
        ["bias[x]", "-2.34e-04", "1.8e-05", "-2.52e-04", "+1.0", "s.e.", "order", "2"],
        ["bias[y]", "1", "1", "-2e-16", "exact"],
        ["bias[z]", "0.25", "at", "most", "0.5", "limit"],
        ["norm_over_noise", "41.4253"],
    ]


def test_repro_shows_each_row_of_the_run_beside_theory(simval, tiny_run):
    (cell,) = (c for c in load_run(tiny_run).cells if c.name == CELL)
    code, out, _ = simval("repro", CELL, "--run", tiny_run)
    assert code == 0
    assert out.splitlines()[1:-1] == list(beside_theory(cell.rows))[1:]
    code, out, _ = simval("repro", CELL, "--run", tiny_run, "--exact")
    assert code == 0
    for row, line in zip(cell.rows, out.splitlines(), strict=False):
        assert line.startswith(f"{row.statistic} = {row.value!r}")
        assert row.prediction is None or repr(row.prediction) in line
