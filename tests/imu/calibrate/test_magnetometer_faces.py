"""Every bad value of every argument of the magnetometer's faces ends in words."""

import numpy as np
import pytest
import test_public_faces as faces
from magnetometer_sets import BODY, BODY_STD, FIELD, IRON, IRON_STD, G, random_set

from simval.imu.calibrate import (
    calibrate,
    calibrate_magnetometer,
    ellipsoid_then_rotation,
)
from simval.imu.sensor import MagnetometerModel
from simval.theory import magnetometer_moments, plan_magnetometer

pytestmark = [pytest.mark.usefixtures("unchecked"), pytest.mark.ci]

CASE = random_set(14, 3)
READINGS = [x[0] for x in CASE.noisy(1, np.random.default_rng(1))]
OTHER = random_set(14, 4).noisy(1, np.random.default_rng(2))[0][0]
FIT = calibrate_magnetometer(
    *READINGS, G, FIELD, accelerometer_std=BODY_STD, magnetometer_std=IRON_STD
)
NOISE = {"accelerometer_std": BODY_STD, "magnetometer_std": IRON_STD}
FACES = {
    "MagnetometerModel": (
        MagnetometerModel,
        {"M": IRON.M, "b": IRON.b, "noise_std": 1.0},
        {"M": "array", "b": "array", "noise_std": "number"},
    ),
    "distort magnetometer": (
        IRON.distort,
        {"field_b": READINGS[0], "rng": np.random.default_rng(1)},
        {"field_b": "batch", "rng": "object"},
    ),
    "correct magnetometer": (IRON.correct, {"raw": READINGS[1]}, {"raw": "batch"}),
    "calibrate_magnetometer": (
        calibrate_magnetometer,
        {"accelerometer": READINGS[0], "magnetometer": READINGS[1], "g": G,
         "field": FIELD, **NOISE, "hemisphere": "north", "model": "triangular",
         "known": calibrate(OTHER, G, noise_std=BODY_STD), "time": np.arange(14.0),
         "max_iterations": 50},
        {"accelerometer": "array", "magnetometer": "array", "g": "positive",
         "field": "positive", "accelerometer_std": "noise",
         "magnetometer_std": "noise", "hemisphere": "choice", "model": "choice",
         "known": "object", "time": "array", "max_iterations": "count"},
    ),
    "ellipsoid_then_rotation": (
        ellipsoid_then_rotation,
        {"accelerometer": READINGS[0], "magnetometer": READINGS[1]},
        {"accelerometer": "array", "magnetometer": "array"},
    ),
    "intervals of a magnetometer": (
        FIT.confidence_intervals, {"level": 0.9}, {"level": "positive"}
    ),
    "magnetometer_moments": (
        magnetometer_moments,
        {"accelerometer": BODY, "magnetometer": IRON, "attitudes": CASE.q, "dip": 1.0,
         **NOISE, "g": G, "field": FIELD, "form": "upper"},
        {"accelerometer": "object", "magnetometer": "object", "attitudes": "array",
         "dip": "number", "accelerometer_std": "noise", "magnetometer_std": "noise",
         "g": "positive", "field": "positive", "form": "choice"},
    ),
    "plan_magnetometer": (
        plan_magnetometer,
        {"attitudes": CASE.q, "dip": 1.0, "accelerometer_noise": 1e-4,
         "magnetometer_noise": 5e-3},
        {"attitudes": "array", "dip": "number", "accelerometer_noise": "positive",
         "magnetometer_noise": "positive"},
    ),
}  # fmt: skip
ALLOWED = {
    ("calibrate_magnetometer", "known", "None"),
    ("calibrate_magnetometer", "time", "None"),
    ("magnetometer_moments", "dip", "negative"),  # a southern one
    ("plan_magnetometer", "dip", "negative"),
}


@pytest.mark.parametrize("face", FACES)
def test_bad_values_are_refused_in_words(face):
    function, good, _ = FACES[face]
    function(**good)
    found, tried = faces.accepted(face, FACES, ALLOWED)
    assert found == []
    assert tried > 20
