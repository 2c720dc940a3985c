"""Recordings of three sensors on one tumble, for the tests of their one fit."""

from dataclasses import dataclass

import numpy as np
from magnetometer_sets import FIELD, IRON, IRON_STD
from tumbles import ACCELEROMETER, GYROSCOPE, WALK, M, fitted, readings

from simval.geometry import attitude_matrix
from simval.imu.calibrate import (
    calibrate_gyroscope,
    calibrate_magnetometer,
    calibrate_nine_axis,
)

DIP = np.radians(60.0)
TRUTH = np.concatenate(
    [ACCELEROMETER.parameters, M.ravel(), GYROSCOPE.B, IRON.M.ravel(), IRON.b, [DIP]]
)
ACC, GYRO, MAG = slice(0, 9), slice(9, 21), slice(21, 34)


def attitudes(truth):
    """True attitude of each rest."""
    return np.array([truth.attitude[(a + b) // 2] for a, b in truth.intervals])


def fields_of(truth):
    """Means of the magnetometer without noise."""
    along = np.array([np.cos(DIP), 0.0, -np.sin(DIP)])
    turned = FIELD * attitude_matrix(attitudes(truth)) @ along
    return IRON.distort(turned, np.random.default_rng(0))  # draws nothing


@dataclass(frozen=True)
class Three:
    """The fits of two sensors each, and that of all, of the same trials."""

    gyroscope: object
    magnetometer: object
    fit: object
    inter_rest: object


def drawn(truth, trials, rng):
    """Pose means of both sensors and rows of the gyroscope."""
    poses, rows = readings(truth, trials, rng)
    noise = rng.standard_normal((trials, len(truth.intervals), 3))
    return poses, rows, fields_of(truth) + IRON_STD * noise


def calibrated(truth, poses, rows, fields):
    """All fits of some trials."""
    acc, inter_rest = fitted(truth, poses, rows)
    noise = {"pose_std": truth.pose_std, "angle_random_walk": WALK}
    gyroscope = calibrate_gyroscope(inter_rest, poses, acc, start=np.eye(3), **noise)
    magnetometer = calibrate_magnetometer(
        poses, fields, truth.g, FIELD, hemisphere="north",
        accelerometer_std=truth.pose_std, magnetometer_std=IRON_STD,
    )  # fmt: skip
    fit = calibrate_nine_axis(
        inter_rest, poses, fields, gyroscope, magnetometer, field_std=IRON_STD, **noise
    )
    return Three(gyroscope, magnetometer, fit, inter_rest)
