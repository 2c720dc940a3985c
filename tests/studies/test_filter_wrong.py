"""What a filter is told wrongly, in one string: read, refused, applied."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from simval.errors import InputError
from simval.filters.signals import Told
from simval.studies.filter_scenarios import (
    MOST,
    NAMES,
    Wrong,
    scenario_of,
    spelled,
    wrong_of,
)

TRUE = Told(
    gyroscope_noise=1.0,
    gyroscope_walk=2.0,
    accelerometer_noise=3.0,
    magnetometer_noise=4.0,
    gravity=9.8,
    field=np.array([1.0, 0.0, -1.0]),
    start_std=0.1,
    bias_std=0.2,
)


def test_nothing_is_wrong_with_nothing():
    assert wrong_of([]) == Wrong()
    told = wrong_of([]).told(TRUE)
    assert all(
        np.array_equal(getattr(told, name), getattr(TRUE, name))
        for name in Told.__dataclass_fields__
    )
    assert np.array_equal(wrong_of([]).M, np.eye(3))


@given(st.dictionaries(st.sampled_from(sorted(MOST)), st.floats(0.0, 1.0), min_size=1))
def test_words_and_numbers_are_read_as_they_are_written(shares):
    values = {}
    for name, share in shares.items():
        least, most = MOST[name]
        values[name] = min(max(least + share * (most - least), least), most)
    words = [f"{name}  {value!r}" for name, value in values.items()]
    text = ",   ".join(["  long   rest", *words])
    scenario, found = scenario_of(spelled(text))
    assert scenario == "long rest"
    assert spelled(spelled(text)) == spelled(text)
    for name in MOST:
        right = getattr(Wrong(), name.replace(" ", "_"))
        assert getattr(found, name.replace(" ", "_")) == values.get(name, right)


def test_the_gyroscope_is_scaled_and_turned():
    found = wrong_of(["scale 0.01", "turned 0.02"]).M
    turn = Rotation.from_rotvec(0.02 * np.ones(3) / np.sqrt(3.0)).as_matrix()
    assert np.abs(found - 1.01 * turn.T).max() < 1e-15


def test_a_noise_is_told_so_many_times_too_great():
    told = wrong_of(["gyroscope noise 3", "magnetometer noise 0.5"]).told(TRUE)
    noises = told.gyroscope_noise, told.accelerometer_noise, told.magnetometer_noise
    assert noises == (3.0, 3.0, 2.0)
    assert told.gyroscope_walk == TRUE.gyroscope_walk


REFUSED = [
    ("", "it must be one of gimbal slow"),
    ("scale 1e-3", "it must be one of gimbal slow"),
    ("gimbal", "it must be one of gimbal slow"),
    ("pivot, scale", "has 'scale'; after its name there may be"),
    ("pivot, scale nan", "must be from -0.1 to 0.1"),
    ("pivot, scale inf", "must be from -0.1 to 0.1"),
    ("pivot, scale one", "must be from -0.1 to 0.1"),
    ("pivot, scale 0.2", "must be from -0.1 to 0.1"),
    ("pivot, gyroscope noise 0", "must be from 0.001 to 1000"),
    ("pivot, calibration -1e-3", "must be from 0 to 0.1"),
    ("pivot, scale 1e-3, scale 1e-3", "has `scale` twice"),
    ("pivot, bias 1e-3", "has 'bias 1e-3'; after its name there may be"),
    ("pivot, scale 1e-3,", "has ''; after its name there may be"),
    ("pivot, long rest", "has 'long rest'; after its name there may be"),
]


@pytest.mark.parametrize(("text", "words"), REFUSED)
def test_what_cannot_be_read_is_refused_with_what_can(text, words):
    with pytest.raises(InputError, match="`scenario` ") as refusal:
        scenario_of(spelled(text))
    assert words in str(refusal.value)


@given(st.text(max_size=40), st.sampled_from(["", *NAMES]))
def test_no_text_is_read_by_chance(text, name):
    whole = spelled(f"{name}, {text}" if name else text)
    try:
        found = scenario_of(whole)
    except InputError:
        return
    assert found[0] in NAMES
    assert len(whole.split(", ")) == 1 or any(word in text for word in MOST)
