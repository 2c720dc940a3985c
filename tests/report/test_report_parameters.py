"""What a parameter is called on a page agrees with what the study says that it is."""

import pytest

from simval.report.words import PARAMETERS, axis_words, named, setting_words
from simval.studies import STUDIES

# a unit as the page has it, and as the descriptions of the parameters do
SPELLED = {
    "s": (", s.",),
    "Hz": (" Hz",),
    "√Hz": (", root Hz.",),
    "T": (", T.",),
    "m/s²": (", m/s^2",),
    "°": (", degrees.",),
    "°/√s": ("degrees/s per root hertz",),
    "samples": ("amples",),
    "of gravity": ("share of gravity",),
    "of the field": ("share of the field",),
    "standard deviations": ("in standard deviations",),
}


def used():
    """Study, key and description of each parameter that the page has words for."""
    return [
        (study, key, field.description)
        for study, module in STUDIES.items()
        for key, field in module.parameters.model_fields.items()
        if key in PARAMETERS
    ]


def test_the_unit_of_a_parameter_is_that_of_its_study():
    found = {(study, key): named(study, key).unit for study, key, _ in used()}
    assert {key for _, key in found} == set(PARAMETERS)  # none is of no study
    for study, key, description in used():
        unit = found[study, key]
        if unit:
            assert any(words in description for words in SPELLED[unit]), (study, key)
        else:  # a ratio, a count, or relative to a vector of length 1
            assert not description.rstrip(".").endswith((", s", "m/s^2", ", T", ", Hz"))
    # each unit is of some parameter, so none of the words above is idle
    assert set(found.values()) - {""} == set(SPELLED)


@pytest.mark.parametrize(
    ("study", "key", "value", "setting", "axis"),
    [
        ("filter", "seconds", 8.0, "length 8 s", "length, s"),
        ("calibration", "noise_std", 0.01, "noise 0.01 m/s²", "noise, m/s²"),
        ("attitude", "noise_std", 0.01, "noise 0.01", "noise"),
        ("calibration", "poses", 12, "12 poses", "number of poses"),
        ("magnetometer", "dip_deg", 60.0, "dip 60°", "dip, °"),
        ("calibration", "some_word", "die", "die", "some word"),
        ("calibration", "some_word", "", "no some word", "some word"),
        ("calibration", "some_word", None, "no some word", "some word"),
        ("calibration", "some_word", True, "some word", "some word"),
        ("calibration", "some_word", False, "no some word", "some word"),
    ],
)
def test_a_setting_is_spelled_with_its_unit(study, key, value, setting, axis):
    assert setting_words(study, key, value) == setting
    assert axis_words(study, key) == axis
