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


def stepped(dt, gyroscope, accelerometer=None, magnetometer=None):
    own = Mekf(start=START, gravity=G, field=FIELD, **NOISE)
    return own.update(dt, gyroscope, accelerometer, magnetometer)


ARRAY = {"covariance": (np.eye(9), "array"), "value": (np.ones(9), "array")}
SIDES = {"path": (PATH, "object"), "told": (MODEL, "object")}
OTHERWISE = {
    rotation_vector: {"q": (START, "batch")},
    from_rotation_vector: {"v": (START[:, :3], "batch")},
    FilterPath: {
        "dt": (np.array(PATH.dt), "array"),
        "attitude": (np.array(PATH.attitude), "array"),
    },
    VectorSensor: {
        "name": ("a", None), "reference": (UP, "array"), "std": (1.0, "positive"),
        "rows": (2, "count"),
    },
    FilterModel: {
        "gyroscope_noise": (1.0, "number"), "gyroscope_walk": (1.0, "number"),
        "sensors": (MODEL.sensors, "object"), "start": (np.array(MODEL.start), "array"),
    },
    filter_bound: SIDES | {"model": (MODEL, "object"), "keep": (2, "count")},
    filter_prediction: SIDES | {
        "truth": (MODEL, "object"), "start_error": (0.01 * np.ones(6), "array"),
        "errors": ((), "object"), "keep": (2, "count"),
    },
    filter_prediction(PATH, MODEL).nees: {"size": (3, "choice")},
    first_update: SIDES | {
        "truth": (MODEL, "object"), "turn": (0.1 * np.ones(3), "array")
    },
    CalibrationError: ARRAY | {"of": ("gyroscope", None)},
    RowError: {"of": ("gyroscope", None), "rows": (np.ones((6, 3)), "array")},
    calibration_error: ARRAY | {
        "of": ("gyroscope", None), "matrix": (np.eye(3) + 0.1, "array"),
        "form": (None, None),
    },
    Mekf: {
        "start": (START, "quaternion"), "gravity": (G, "positive"),
        "field": (FIELD, "array"), "coning": (True, "switch"),
        **{name: (value, "positive" if "meter" in name else "number")
           for name, value in NOISE.items()},
    },
    stepped: {
        "dt": (0.01, "positive"),
        **{name: (rows, "array") for name, rows in ROWS.items()},
    },
}  # fmt: skip
FACES = {
    function.__name__: (function, *faces.arguments(function, otherwise))
    for function, otherwise in OTHERWISE.items()
}
ALLOWED = {  # the same
    (face, name, "transposed")
    for face, name in (
        ("FilterModel", "start"),
        ("CalibrationError", "covariance"),
        ("calibration_error", "covariance"),
    )
}


@pytest.mark.parametrize("face", FACES)
def test_bad_values_are_refused_in_words(face):
    function, good, *_ = FACES[face]
    function(**good)
    found, tried = faces.accepted(face, FACES, ALLOWED)
    assert found == []
    assert tried > 15
