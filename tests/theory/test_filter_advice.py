"""Advice on a filter's settings: its parts against predictions of their own."""

from dataclasses import replace

import numpy as np
import pytest
from faces import check_faces
from filter_paths import wobble
from filter_trials import model_of

from simval.account.terminal import lines
from simval.theory import CalibrationError
from simval.theory.filter_advice import filter_advice
from simval.theory.filter_settings import FilterCase, effect

LEFT = CalibrationError(of="gyroscope", covariance=4e-6 * np.eye(9))


@pytest.fixture(scope="module")
def advised():
    """Eight seconds at 10 Hz, the gyroscope's matrix off by 0.2 % an entry."""
    case = FilterCase(
        path=wobble(80, 0.1), truth=model_of(), errors=(LEFT,), settle=1.0
    )
    return case, filter_advice([case], ends=({"N": 0.5}, {"accelerometer": 2.0}))


pytestmark = pytest.mark.slow  # one search, and one for each of four sources


def test_what_it_says_of_other_settings(advised):
    case, found = advised
    ten = found.others["10 times the gyroscope's noise"]
    assert ten.worst == effect([case], {"N": 10.0, "K": 10.0}).worst
    assert found.bound == effect([replace(case, errors=())], {}).worst
    assert (
        found.bound < found.settings.effect.worst < found.others["the true noise"].worst
    )
    # what is told stays as it is where the truth is another
    half = replace(case, truth=replace(case.truth, gyroscope_noise=8.75e-5))
    told = found.settings.factors | {"N": 2.0 * found.settings.factors["N"]}
    assert found.ends[0].worst == pytest.approx(effect([half], told).worst, rel=1e-9)
    assert found.ends[1].worst > found.settings.effect.worst


def test_what_would_help(advised):
    _, found = advised
    assert set(found.halves) == {
        "gyroscope noise", "accelerometer noise", "magnetometer noise",
        "gyroscope calibration",
    }  # fmt: skip
    # found anew, no half of a source makes it worse, but for a search's end
    assert max(found.halves.values()) < 1.01
    assert found.halves["gyroscope calibration"] < 0.95


def test_a_shift_makes_as_large_an_error_alone(advised):
    """An offset of every reading, of each axis by itself, in place of calibrations."""
    case, found = advised
    size = found.shifts["magnetometer"]
    quiet = case.scaled(
        dict.fromkeys(("N", "K", "accelerometer", "magnetometer"), 1e-6)
    )
    told = {n: 1e6 * found.settings.factors.get(n, 1.0) for n in case.factors}
    square = 0.0
    for axis in size * np.eye(3):
        offset = np.append(np.zeros(9), axis)
        error = CalibrationError(of="magnetometer", value=offset)
        one = replace(quiet, errors=(error,))
        prediction = one.prediction(told)
        square += np.mean(np.sum(prediction.mean[:, :3] ** 2, axis=1)) / 3.0
    assert np.sqrt(square) == pytest.approx(found.settings.effect.worst, rel=1e-6)


def test_what_helps_nothing_is_not_advised(advised):
    _, found = advised
    none = replace(found, halves={"start": 1.00003, "gyroscope noise": 0.9999999})
    helps = none.account.replies[-1]
    assert helps.headline.startswith("Nothing much")
    assert helps.do == ""
    assert helps.lines == ("gyroscope noise: less than 1 %", "start: less than 1 %")


def test_where_no_setting_is_right(advised):
    _, found = advised
    none = replace(found, settings=found.settings._replace(honest=False))
    give = none.account.replies[0]
    assert give.answer == "fail"
    assert give.headline.startswith("No setting")
    assert "--band" in give.do
    for each in (found, none):
        check_faces(each.account)
    text = " ".join("\n".join(lines(found.account, verbose=True)).split())
    assert found.account.replies[0].headline in text


def test_an_axis_that_is_stated_far_too_wide_is_said(advised):
    """A NEES of 3 is a sum: of two axes that are stated too small, it hides one."""
    case, found = advised
    factors = {"N": 5e3, "accelerometer": 4e3, "magnetometer": 3.5}
    wide = effect([case], factors)
    assert wide.overstated > 20.0
    shown = replace(found, settings=found.settings._replace(effect=wide))
    give = shown.account.replies[0]
    assert give.answer == "inconclusive"
    assert give.headline.endswith("times about one axis.")
    assert found.account.replies[0].answer == "pass"
