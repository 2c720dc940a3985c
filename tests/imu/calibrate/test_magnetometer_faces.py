"""Every bad value of every argument of the magnetometer's faces ends in words."""

import numpy as np
import pytest
import test_public_faces as faces
from magnetometer_sets import BODY, BODY_STD, FIELD, IRON, IRON_STD, G, random_set

from simval.imu.calibrate import (
    Recording,
    calibrate,
    ellipsoid_then_rotation,
    fit,
)
from simval.imu.sensor import MagnetometerModel
from simval.theory import magnetometer_moments, plan_magnetometer

pytestmark = [pytest.mark.usefixtures("unchecked"), pytest.mark.ci]

CASE = random_set(14, 3)
READINGS = [x[0] for x in CASE.noisy(1, np.random.default_rng(1))]
OTHER = random_set(14, 4).noisy(1, np.random.default_rng(2))[0][0]
RECORDING = Recording(
    poses=READINGS[0], fields=READINGS[1], g=G, field=FIELD, pose_std=BODY_STD,
    field_std=IRON_STD,
)  # fmt: skip
FIT = fit(RECORDING)
PAIR = {
    name: (means, "array")
    for name, means in zip(("accelerometer", "magnetometer"), READINGS, strict=True)
}
KNOWN = {
    "accelerometer_std": (BODY_STD, "noise"), "g": (G, "positive"),
    "magnetometer_std": (IRON_STD, "noise"), "field": (FIELD, "positive"),
}  # fmt: skip
TURNED = {"attitudes": (CASE.q, "array"), "dip": (1.0, "number")}
OTHERWISE = {
    MagnetometerModel: {
        "M": (IRON.M, "array"), "b": (IRON.b, "array"), "noise_std": (1.0, "number")
    },
    IRON.distort: {"field_b": (READINGS[0], "batch")},
    IRON.correct: {},
    Recording: {
        "poses": (READINGS[0], "array"), "fields": (READINGS[1], "array"),
        "pose_std": (BODY_STD, "noise"), "field_std": (IRON_STD, "noise"),
        "g": (G, "positive"), "field": (FIELD, "positive"),
        "hemisphere": ("north", "choice"),
    },
    fit: {
        "recording": (RECORDING, "object"), "estimator": ("joint", "choice"),
        "known": (calibrate(OTHER, G, noise_std=BODY_STD), "object"),
    },
    ellipsoid_then_rotation: PAIR,
    FIT.confidence_intervals: {},
    magnetometer_moments: TURNED | KNOWN | {
        "accelerometer": (BODY, "object"), "magnetometer": (IRON, "object")
    },
    plan_magnetometer: TURNED | {
        "accelerometer_noise": (1e-4, "positive"),
        "magnetometer_noise": (5e-3, "positive"),
    },
}  # fmt: skip
FACES = {
    function.__name__: (function, *faces.arguments(function, otherwise))
    for function, otherwise in OTHERWISE.items()
}
ALLOWED = {  # a southern one
    (face, "dip", "negative") for face in ("magnetometer_moments", "plan_magnetometer")
}


@pytest.mark.parametrize("face", FACES)
def test_bad_values_are_refused_in_words(face):
    function, good, *_ = FACES[face]
    function(**good)
    found, tried = faces.accepted(face, FACES, ALLOWED)
    assert found == []
    assert tried > 20
