"""Checks at public boundaries: the message names the argument and the entry."""

import numpy as np
import pytest

from simval.arrays import (
    finite_array,
    frozen,
    nonnegative_number,
    physical_array,
    positive_number,
)
from simval.errors import InputError


def test_good_arrays_pass_unchanged():
    value = np.arange(6.0).reshape(2, 3)
    assert finite_array("poses", value, (3,)) is value
    assert finite_array("poses", [[1, 2, 3]], (None, 3)).dtype == np.float64


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ([1.0, 2.0], r"`poses` has shape \(2,\); the last axes must be \(3\)"),
        ([[1.0, np.nan, 2.0]], r"first \(nan\) at index \(0, 1\)"),
        ([[1.0, 2.0, np.inf]], r"first \(inf\) at index \(0, 2\)"),
        (["a", "b", "c"], "not an array of real numbers"),
        ([[1.0, 2.0], [1.0]], "not an array of real numbers"),
        (1.0, "the last axes must be"),
        (np.array([1.0, 2.0, 3.0j]), "not an array of real numbers .it is complex"),
    ],
)
def test_bad_arrays_are_named(value, words):
    with pytest.raises(InputError, match=words):
        finite_array("poses", value, (3,))


@pytest.mark.parametrize("value", [1e37, -1e37])
def test_values_beyond_any_sensor_are_refused_of_either_sign(value):
    assert physical_array("poses", [1e36, -1e36], ()).size == 2
    with pytest.raises(InputError, match=r"`poses` has a value of 1e\+37, beyond"):
        physical_array("poses", [1.0, value], ())


def test_numbers_pass():
    assert positive_number("g", 9.8, "m/s^2") == 9.8
    assert nonnegative_number("noise_std", 0, "m/s^2") == 0.0
    with pytest.raises(InputError, match="`noise_std` is -1"):
        nonnegative_number("noise_std", -1, "m/s^2")


def test_frozen_is_a_read_only_copy():
    value = np.ones(3)
    copy = frozen(value)
    value[0] = 2.0
    assert copy[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        copy[0] = 3.0
