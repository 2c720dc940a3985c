"""Numbers as a person reads them: two digits of the error, limits, chances, counts."""

import re
from decimal import ROUND_HALF_EVEN, Context, Decimal
from math import isfinite

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from simval.cli.terminal import encodable
from simval.spelling import (
    bounded,
    chance,
    counted,
    duration,
    in_ascii,
    measured,
    rounded,
    standard_errors,
)
from simval.units import OF_A_CALIBRATION, OF_A_DATA_SHEET

SIZES = st.floats(1e-30, 1e30)
SHOWN = re.compile(r"\(?(?P<value>\S+?) ± (?P<sd>[^\s)]+)\)?(?P<tens>e-?\d+)?")


def parts(text):
    """Value and error as decimals, and the power of ten of the last digit of both."""
    found = SHOWN.fullmatch(text)
    value, sd = (Decimal(found[k] + (found["tens"] or "")) for k in ("value", "sd"))
    return value, sd


@given(sd=SIZES, digits=st.floats(-1e9, 1e9), power=st.integers(0, 3))
@example(sd=0.0999, digits=0.0, power=0)  # two digits are 0.10, and not 0.100
@example(sd=0.0996, digits=99.94, power=0)
@example(sd=123.4, digits=800.2, power=0)  # 120, beside hundreds and tens
@example(sd=9.96e4, digits=-1.0, power=0)
@example(sd=205.0, digits=48780486.0, power=0)  # a tie, before a division by 1e10
def test_a_value_has_two_digits_of_its_error(sd, digits, power):
    value = digits * sd * 10.0**-power
    shown, error = parts(measured(value, sd))
    two = Context(prec=2, rounding=ROUND_HALF_EVEN)
    assert error == two.create_decimal(Decimal(f"{sd:.1e}"))
    last = Decimal(1).scaleb(error.adjusted() - 1)
    # the decimal, its own rounding of 17 digits, and half of the last digit
    slack = last / 2 + abs(Decimal(value)) * Decimal("4e-16")
    assert abs(shown - Decimal(value)) <= slack
    assert shown % last == 0


@pytest.mark.parametrize("sd", [0.0, float("nan"), float("inf"), -1.0])
def test_a_value_without_an_error_stands_alone(sd):
    assert measured(2.5, sd) == "2.5"


@given(high=SIZES)
def test_a_limit_has_two_digits(high):
    assert float(bounded(0.0, high)[2:]) == float(f"{high:.1e}")
    assert bounded(high, float("inf")) == f"> {rounded(high)}"
    assert bounded(0.0, float("inf")) == "not bounded"


@given(p=st.floats(0.0, 1.0))
@example(p=1e-3)
@example(p=0.0)
def test_a_chance_is_its_digits_or_below_a_thousandth(p):
    word, sign, digits = chance(p).split(" ")
    assert word == "p"
    assert (sign == "<") == (p < 1e-3)
    assert abs(float(digits) - p) <= max(1e-3, 0.05 * p)
    assert chance(float("nan")) == ""


@given(count=st.integers(0, 10**12))
@example(count=1)
def test_a_count_agrees_with_its_noun(count):
    digits, noun = counted(count, "cell").rsplit(" ", 1)
    assert int(digits.replace(" ", "")) == count
    assert noun == ("cell" if count == 1 else "cells")
    assert counted(count, "axis", "axes").endswith("axis" if count == 1 else "axes")
    assert standard_errors(f"-{count}").endswith("error" if count == 1 else "errors")


@given(seconds=st.floats(1e-3, 1e9))
@example(seconds=59.9)
@example(seconds=3_000_000.0)
def test_a_time_is_in_the_unit_that_suits_it(seconds):
    number, unit = duration(seconds).split(" ")
    size, most = {"s": (1, 60), "min": (60, 60), "h": (3600, 48),
                  "days": (86400, float("inf"))}[unit]  # fmt: skip
    assert float(number) < most
    assert abs(float(number) * size - seconds) <= 0.05 * seconds
    assert duration(3_000_000.0) == "35 days"


class Ascii:
    encoding = "ascii"


def test_a_stream_without_other_characters_gets_ascii():
    units = [u.name for kinds in OF_A_DATA_SHEET.values() for u in kinds.values()]
    units += [unit.name for unit in OF_A_CALIBRATION.values()]
    for text in [measured(1.0, 0.1), *units, "✓ ≤ × σ"]:
        assert in_ascii(text).isascii(), text
        assert encodable(text, Ascii()) == in_ascii(text)
    assert encodable("1.0 ± 0.1 µg/√Hz", Ascii()) == "1.0 +- 0.1 ug/sqrt Hz"
    assert isfinite(float(in_ascii("−2")))
