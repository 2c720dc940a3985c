"""Every bad value of every argument of the filters' faces ends in words."""

import numpy as np
import pytest
import test_public_faces as faces
from filter_paths import FIELD, UP, G, model, wobble

from simval.geometry import from_rotation_vector, rotation_vector
from simval.imu.filters import Mekf
from simval.theory import (
    CalibrationError,
    FilterModel,
    FilterPath,
    RowError,
    VectorSensor,
    calibration_error,
    filter_bound,
    filter_prediction,
    first_update,
)

pytestmark = [pytest.mark.usefixtures("unchecked"), pytest.mark.ci]

PATH, MODEL = wobble(6), model()
NOISE = {
    "gyroscope_noise": 1e-4, "gyroscope_walk": 1e-5, "accelerometer_noise": 0.02,
    "magnetometer_noise": 1e-7, "start_std": 0.1, "bias_std": 0.01,
}  # fmt: skip
START = np.tile([0.0, 0.6, 0.0, 0.8], (3, 1))
ROWS = {"gyroscope": np.ones((3, 3)), "accelerometer": np.ones((3, 3)),
        "magnetometer": 1e-5 * np.ones((3, 3))}  # fmt: skip


def stepped(**rows):
    return Mekf(start=START, gravity=G, field=FIELD, **NOISE).update(**rows)


FACES = {
    "rotation_vector": (rotation_vector, {"q": START}, {"q": "batch"}),
    "from_rotation_vector": (
        from_rotation_vector, {"v": START[:, :3]}, {"v": "batch"}
    ),
    "FilterPath": (
        FilterPath,
        {"dt": np.array(PATH.dt), "attitude": np.array(PATH.attitude)},
        {"dt": "array", "attitude": "array"},
    ),
    "VectorSensor": (
        VectorSensor,
        {"name": "a", "reference": UP, "std": 1.0, "rows": 2},
        {"reference": "array", "std": "positive", "rows": "count"},
    ),
    "FilterModel": (
        FilterModel,
        {"gyroscope_noise": 1.0, "gyroscope_walk": 1.0, "sensors": MODEL.sensors,
         "start": np.array(MODEL.start)},
        {"gyroscope_noise": "number", "gyroscope_walk": "number", "sensors": "object",
         "start": "array"},
    ),
    "filter_bound": (
        filter_bound,
        {"path": PATH, "model": MODEL, "keep": 2},
        {"path": "object", "model": "object", "keep": "count"},
    ),
    "filter_prediction": (
        filter_prediction,
        {"path": PATH, "truth": MODEL, "told": MODEL, "start_error": 0.01 * np.ones(6),
         "errors": (), "keep": 2},
        {"path": "object", "truth": "object", "told": "object", "start_error": "array",
         "errors": "object", "keep": "count"},
    ),
    "nees": (filter_prediction(PATH, MODEL).nees, {"size": 3}, {"size": "choice"}),
    "first_update": (
        first_update,
        {"path": PATH, "truth": MODEL, "turn": 0.1 * np.ones(3), "told": MODEL},
        {"path": "object", "truth": "object", "turn": "array", "told": "object"},
    ),
    "CalibrationError": (
        CalibrationError,
        {"of": "gyroscope", "covariance": np.eye(9), "value": np.ones(9)},
        {"covariance": "array", "value": "array"},
    ),
    "RowError": (
        RowError,
        {"of": "gyroscope", "rows": np.ones((6, 3))},
        {"rows": "array"},
    ),
    "calibration_error": (
        calibration_error,
        {"of": "gyroscope", "matrix": np.eye(3) + 0.1, "covariance": np.eye(9)},
        {"matrix": "array", "covariance": "array"},
    ),
    "Mekf": (
        Mekf,
        {"start": START, "gravity": G, "field": FIELD, "coning": True, **NOISE},
        {"start": "quaternion", "gravity": "positive", "field": "array",
         "coning": "switch", "start_std": "number", "bias_std": "number",
         "gyroscope_noise": "number", "gyroscope_walk": "number",
         "accelerometer_noise": "positive", "magnetometer_noise": "positive"},
    ),
    "update": (
        stepped,
        {"dt": 0.01, **ROWS},
        {"dt": "positive", "gyroscope": "array", "accelerometer": "array",
         "magnetometer": "array"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("face", FACES)
def test_bad_values_are_refused_in_words(face):
    found, tried = faces.accepted(face, FACES, ALLOWED)
    assert found == []
    assert tried > 15


ALLOWED = {
    ("filter_prediction", "told", "None"),
    ("first_update", "told", "None"),
    ("filter_prediction", "start_error", "None"),
    ("CalibrationError", "covariance", "None"),
    ("CalibrationError", "value", "None"),
    ("FilterModel", "start", "transposed"),  # the same
    ("CalibrationError", "covariance", "transposed"),
    ("calibration_error", "covariance", "transposed"),
    ("update", "accelerometer", "None"),  # a row without it
    ("update", "magnetometer", "None"),
}


def test_good_values_are_accepted():
    for function, good, _ in FACES.values():
        function(**good)
