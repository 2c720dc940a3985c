"""1e5 is a whole number wherever one is asked for, and 1.5 is none."""

from fractions import Fraction

import click
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from simval.arguments import whole_number
from simval.cli.options import Whole
from simval.studies import find_study
from simval.sweep import load_suite
from simval.text import DIGITS, EXACT, as_whole, read_whole


@given(st.integers(-EXACT, EXACT))
@example(0)
@example(EXACT)
def test_a_float_that_is_a_whole_number_is_one(number):
    for form in (float(number), np.float64(number), Fraction(number)):
        assert as_whole(form) == number
        assert type(as_whole(form)) is int
        assert whole_number("n", form, -EXACT, EXACT) == number
    assert as_whole(number) is number
    for other in (1.5, 2.0**54, float("nan"), float("inf"), True, "5", None, 1j):
        assert as_whole(other) is other


@given(st.integers(-(10**20), 10**20))
def test_text_is_read_in_each_way_of_writing(number):
    assert read_whole(str(number)) == number
    assert read_whole(f" {number}.0 ") == number
    assert read_whole(f"{number}e0") == number
    assert read_whole(f"{number:_}") == number
    assert read_whole(f"{10 * number}e-1") == number


@pytest.mark.ci
@given(st.text(max_size=30))
@example("1e5")
@example("1e-1")
@example("1e999999999")
@example("-1e999999999")
@example("9" * 10_000)
@example("0e999999999")
@example("nan")
@example("inf")
@example("0x10")
@example("")
def test_any_text_is_a_whole_number_or_none(text):
    number = read_whole(text)
    assert number is None or abs(number) < 10**DIGITS
    try:
        plain = int(text)
    except ValueError:
        plain = None
    if plain is not None and abs(plain) < 10**DIGITS:
        assert number == plain


def test_suites_take_it_and_the_cell_is_the_same(tmp_path):
    text = "seed = 2e0\n[attitude]\nsamples = [{}]\n"
    names = []
    for samples in ("100_000, 200_000", "1e5, 2e5"):
        path = tmp_path / "suite.toml"
        path.write_text(text.format(samples))
        cells = load_suite(str(path)).cells
        names.append([cell.name for cell in cells])
        assert {type(cell.parameters.samples) for cell in cells} == {int}
    assert names[0] == names[1]
    assert names[0][0].endswith("samples=100000)@2")
    (cell,) = load_suite(str(path), ["attitude.samples=1e6"]).cells
    assert cell.parameters.samples == 1_000_000
    assert find_study("attitude").parameters(samples=1e6) == cell.parameters


@pytest.mark.parametrize(
    ("text", "number"), [("1e5", 100_000), ("7", 7), ("2.0", 2), ("1_000", 1000)]
)
def test_options_take_it(text, number):
    assert Whole(min=1).convert(text, None, None) == number
    with pytest.raises(click.BadParameter, match=r"a whole number|in the range"):
        Whole(min=1).convert(text + ".5", None, None)
