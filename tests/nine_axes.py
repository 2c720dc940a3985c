"""Recordings of three sensors on one tumble, for the tests of their one fit."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from magnetometer_sets import FIELD, IRON, IRON_STD
from test_gyroscope_monte_carlo import path_of
from tumbles import ACCELEROMETER, GYROSCOPE, WALK, M, fitted, readings, tumble

from simval.calibrate import (
    calibrate_gyroscope,
    calibrate_magnetometer,
    calibrate_nine_axis,
)
from simval.geometry import attitude_matrix
from simval.theory import nine_axis_moments

DIP = np.radians(60.0)
TRUTH = np.concatenate(
    [ACCELEROMETER.parameters, M.ravel(), GYROSCOPE.B, IRON.M.ravel(), IRON.b, [DIP]]
)
EVERY, ACC, GYRO, MAG = slice(None), slice(0, 9), slice(9, 21), slice(21, 34)


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
    moves: object

    @property
    def error(self):
        return self.fit.parameters - TRUTH


def drawn(truth, trials, rng, *, times=1.0, chunk=2):
    """Pose means of both sensors and rows of the gyroscope."""
    poses, rows = readings(truth, trials, rng, times=times)
    noise = rng.standard_normal((trials, len(truth.intervals), 3))
    return poses, rows, fields_of(truth) + times * IRON_STD * noise


def calibrated(truth, poses, rows, fields, *, chunk=2, walk=WALK, std=IRON_STD, **more):
    """All fits of some trials."""
    acc, moves = fitted(truth, poses, rows, chunk=chunk)
    noise = {"pose_std": truth.pose_std, "angle_random_walk": walk}
    gyroscope = calibrate_gyroscope(moves, poses, acc, start=np.eye(3), **noise)
    magnetometer = calibrate_magnetometer(
        poses, fields, truth.g, FIELD, hemisphere="north",
        accelerometer_std=truth.pose_std, magnetometer_std=std,
    )  # fmt: skip
    fit = calibrate_nine_axis(
        moves, poses, fields, gyroscope, magnetometer, field_std=std, **noise, **more
    )
    return Three(gyroscope, magnetometer, fit, moves)


@cache
def bound(directions=40, walk=WALK, field_std=IRON_STD, times=1.0):
    """Cramer-Rao bound of all 34 at a tumble of so many poses."""
    truth = tumble(directions)
    seconds = np.diff(truth.intervals)[:, 0] * (truth.time[1] - truth.time[0])
    return nine_axis_moments(
        GYROSCOPE, ACCELEROMETER, IRON, attitudes(truth), DIP, path_of(truth),
        pose_std=times * truth.pose_std, field_std=field_std,
        bias_std=WALK / np.sqrt(seconds.sum()), g=truth.g, field=FIELD,
        angle_random_walk=walk,
    ).cramer_rao  # fmt: skip
