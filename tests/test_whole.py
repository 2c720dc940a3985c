"""1e5 is a whole number wherever one is asked for, and 1.5 is none."""

from fractions import Fraction

import click
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from simval.arguments import MOST, whole_number
from simval.cli.options import Whole
from simval.errors import InputError
from simval.scene.driven import pose_directions
from simval.studies import find_study
from simval.sweep import load_suite
from simval.whole import DIGITS, EXACT, exact, read


@given(st.integers(-EXACT, EXACT))
@example(0)
@example(EXACT)
def test_a_float_that_is_a_whole_number_is_one(number):
    for form in (float(number), np.float64(number), Fraction(number)):
        assert exact(form) == number
        assert type(exact(form)) is int
    assert exact(number) is number


@given(st.floats().filter(lambda x: not (x.is_integer() and abs(x) <= EXACT)))
@example(float("nan"))
@example(float("inf"))
@example(1.5)
@example(2.0**54)  # which of two integers it was is not known
@example(5e-324)
def test_any_other_float_is_left_as_it_is(value):
    assert exact(value) is value


@pytest.mark.parametrize("value", [True, "5", None, [1.0], np.ones(1), 1j, object()])
def test_what_is_no_number_is_left_as_it_is(value):
    assert exact(value) is value


@given(st.integers(-(10**20), 10**20))
def test_text_is_read_in_each_way_of_writing(number):
    assert read(str(number)) == number
    assert read(f" {number}.0 ") == number
    assert read(f"{number}e0") == number
    assert read(f"{number:_}") == number
    assert read(f"{10 * number}e-1") == number


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
    number = read(text)
    assert number is None or abs(number) < 10**DIGITS
    try:
        plain = int(text)
    except ValueError:
        plain = None
    if plain is not None and abs(plain) < 10**DIGITS:
        assert number == plain


@pytest.mark.parametrize("value", [1e3, np.float32(1000.0), "no", 1000])
def test_arguments_take_it(value):
    if value == "no":
        with pytest.raises(InputError, match="`n` is 'no'; it must be a whole number"):
            whole_number("n", value, 1)
    else:
        assert whole_number("n", value, 1) == 1000
        assert type(whole_number("n", value, 1)) is int


@given(st.floats() | st.booleans() | st.text(max_size=5) | st.none())
@example(1000000000001.0)
@example(float(2**53))
def test_arguments_refuse_the_rest_in_words(value):
    number = exact(value)
    if isinstance(number, int) and not isinstance(value, bool) and 1 <= number <= MOST:
        assert whole_number("n", value, 1) == value
        return
    with pytest.raises(InputError, match=r"a whole number, (1 or more|from 1 )"):
        whole_number("n", value, 1)


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


@given(
    st.floats(1.0, 1e20)
    | st.integers(2**16, 10**6).map(float)
    | st.floats()
    | st.booleans()
)
@example(65536.5)
@example(1e16)
@settings(max_examples=30)
def test_suites_refuse_the_rest_in_words(value):
    text = "nan" if value != value else str(value).lower()
    whole = isinstance(exact(value), int) and not isinstance(value, bool)
    override = [f"attitude.samples={text}"]
    if whole and 2**16 <= value <= 10**6:
        cells = load_suite("smoke", override).cells
        samples = {c.parameters.samples for c in cells if c.study == "attitude"}
        assert samples == {value}
    elif not (whole and value > 10**6):  # up to what more is allowed, is its own
        with pytest.raises(InputError, match=r"`attitude\.samples`: .*given"):
            load_suite("smoke", override)


@pytest.mark.parametrize(
    ("text", "number"), [("1e5", 100_000), ("7", 7), ("2.0", 2), ("1_000", 1000)]
)
def test_options_take_it(text, number):
    assert Whole(min=1).convert(text, None, None) == number


@given(st.text(max_size=10))
@example("1.5")
@example("0")
@example("1e400")
def test_options_refuse_the_rest_in_words(text):
    number = read(text)
    if number is not None and number >= 1:
        assert Whole(min=1).convert(text, None, None) == number
        return
    with pytest.raises(click.BadParameter, match=r"a whole number|in the range"):
        Whole(min=1).convert(text, None, None)


def test_scenes_and_plans_take_it(simval):
    assert len(pose_directions(1e2)) == 100
    for wrong in (2.5, True, float("nan"), 0.0, 1e9):
        with pytest.raises(InputError, match="must be a whole number, from 1 to"):
            pose_directions(wrong)
    code, out, _ = simval("plan", "--poses", "fibonacci:1e2", "--noise-std", "1e-3")
    assert code == 0
    assert out.startswith("poses           100,")
    for wrong in ("fibonacci:1.5", "fibonacci:", "fibonacci:nan", "fibonacci:1e6"):
        code, _, err = simval("plan", "--poses", wrong, "--noise-std", "1e-3")
        assert code == 2, wrong
        assert "Traceback" not in err
