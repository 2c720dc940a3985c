"""Small faults of noise, streams and code, in the smoke suite's own cells.

Each leaves errors that look right: noise a hundredth too loud, a stream that is used
twice, n for n - 1, a derivative off by a thousandth, a detector off by a sample.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from power.attitude import normals
from power.calibration import bent, louder, steeper
from power.fault import Fault, given, result, then, times, told
from simval.imu.calibrate import covariance, equations
from simval.imu.calibrate.gyroscope import rotation
from simval.imu.calibrate.minimization import Leverage
from simval.imu.filters import Mekf, mekf
from simval.imu.sensor import AccelerometerModel, NoiseModel
from simval.imu.statics import detector
from simval.montecarlo import plain
from simval.streams import Streams
from simval.studies import (
    attitude_vectors,
    calibration,
    coverage,
    gyroscope,
    ladder,
    magnetometer,
    noise_model,
    response,
    scene,
    trials,
)
from simval.studies import detector as study_of_detector
from simval.theory import calibration as calibration_theory
from simval.theory import filter_model
from simval.theory import gyroscope as gyroscope_theory
from simval.theory import magnetometer as magnetometer_theory

LOUDER, OFF = 1.01, 1.001
TOO_SMALL = (
    "1/n of a variance that n trials tell to sqrt(2/n); the functions that all studies "
    "share are judged by `sampling`, a study's own lines are not"
)
# studies that draw their normals from the generator of a block
DRAWN = (
    "ladder", "coverage", "magnetometer", "gyroscope", "filter", "attitude_vectors",
)  # fmt: skip
FELT = ("calibration", "end_to_end")  # whose accelerometer draws its own


def smoke(study, part, owner, function, name, *change, **more):
    """A fault in a study of the smoke suite."""
    name = f"{name}, {study}"
    return Fault(f"smoke {study}", part, owner, function, name, *change, **more)


def each(studies, *fault):
    """The same fault in the smoke suite of each of these studies."""
    part, owner, function, name, change = fault
    return (smoke(study, part, owner, function, name, change) for study in studies)


class Again:
    """A generator whose second draw repeats the first one's numbers."""

    def __init__(self, original, *given):
        self.make = partial(original, *given)

    def standard_normal(self, shape=None):
        """The first numbers."""
        return self.make().standard_normal(shape)


def first_sensor_twice(noise):
    if np.ndim(noise) == 3 and len(noise) == 2:
        noise[1] = noise[0]
    return noise


def more(*names):
    return told(**dict.fromkeys(names, lambda std: LOUDER * std))


def only(number):
    """Blocks of noise by another number."""
    return lambda original, streams, asked: original(streams, number(asked))


LOUD, MORE = "noise 1 % louder", "told 1 % more noise"
SHARED = "two sensors share a stream"
block = ("noise", Streams, "block")
NOISE = (
    *each(DRAWN, *block, LOUD, normals(lambda x: LOUDER * x)),
    *each(
        FELT, "noise", AccelerometerModel, "distort", LOUD,
        given(noise_std=lambda m: LOUDER * m.noise_std),
    ),
    smoke("noise_model", "noise", NoiseModel, "draw", LOUD, louder(LOUDER)),
    smoke(
        "magnetometer", "calibrator", magnetometer, "Recording", MORE,
        more("pose_std", "field_std"),
    ),
    smoke(
        "gyroscope", "calibrator", gyroscope, "Recording", MORE,
        more("angle_random_walk"),
    ),
    smoke(
        "filter", "calibrator", Mekf, "__init__", MORE,
        more("accelerometer_noise", "magnetometer_noise"),
    ),
    *each(
        (*FELT, *DRAWN, "noise_model"), *block,
        "every block the same noise", only(lambda number: 0),
    ),
    *each(
        ("calibration", "gyroscope", "noise_model", "end_to_end", "filter"), *block,
        "one block's noise used twice",
        only(lambda number: 0 if number == 1 else number),
    ),
    *each(["magnetometer"], *block, SHARED, normals(first_sensor_twice)),
    *each(("gyroscope", "filter"), *block, SHARED, Again),
)  # fmt: skip


# n for n - 1


def mean_by_n(given):
    value, error, n = given
    return value, error * np.sqrt((n - 1) / n), n


def reduced_by_n(original, values, *given):
    value, error = original(values, *given)
    return value, error * np.sqrt((len(values) - 1) / len(values))


def type_a_by_fewer(original, poses, *given, **named):
    # Type A variances by n - 8
    fit = original(poses, *given, **named)
    n = poses.shape[-2]
    return replace(fit, covariance=fit.covariance * ((n - 9) / (n - 8)))


def by_n(study, part, owner, function, where, *change, **more):
    name = f"n for n - 1{where}"
    return smoke(study, part, owner, function, name, *change, **more)


shared = partial(by_n, "sampling", "estimator", everywhere=True)
FREEDOM = (
    shared(
        plain, "_variance", "",
        lambda o, sums: o(sums) * ((sums.batches - 1) / sums.batches),
    ),
    shared(trials, "mean_of", " in an error of a mean", then(mean_by_n)),
    shared(response, "reduced_mean", " under control variates", reduced_by_n),
    by_n("coverage", "calibrator", coverage, "calibrate", "", type_a_by_fewer),
    by_n(
        "magnetometer", "calibrator", magnetometer.Scenario, "fitted", "",
        result(dof=lambda fit: fit.dof + 1),
    ),
    by_n(
        "ladder", "estimator", ladder, "moments_of", " in the study's own lines",
        result(covariance=lambda m: m.covariance * ((m.samples - 1) / m.samples)),
        baseline=TOO_SMALL,
    ),
)  # fmt: skip


# Code


def off(values, index):
    result = np.array(values)
    result[index] *= OFF
    return result


def scaled(*index):
    """Change some entries of what a function returns by a thousandth."""
    return then(lambda values: off(values, index))


def field_row(original, p, theta, y):
    rows = original(p, theta, y)
    some = (OFF - 1.0) * np.eye(22)[10]
    rows[..., 1] = original(p, theta + (theta - p.theta) * some, y)[..., 1]
    return rows


def pulled(original, leverage, bias, *, newton):
    local = original(leverage, bias, newton=newton)
    # of the leverage's slope, a term of what the start left
    return replace(local, gradient=local.gradient + 1e-3 * leverage.start_cost[:, None])


def a_turn_steeper(original, theta, *given, **named):
    # of M's second diagonal element, in the rows of the moves
    found = original(theta, *given, **named)
    turns, *others = found.blocks
    off = (OFF - 1.0) * (np.arange(len(theta)) == 13)

    def rows(at, y):
        return turns.rows(at + off * (at - theta), y)

    return replace(found, blocks=(turns._replace(rows=rows), *others))


THEORY, ONE = "a derivative of theory 0.1 % off", "a derivative 0.1 % off"
SECOND, VARIANCE = "a second derivative 0.1 % off", "a covariance 0.2 % off"
own_theory = (calibration_theory, "_equations")
CODE = (
    smoke("calibration", "formula", *own_theory, THEORY, steeper(OFF)),
    smoke("ladder", "formula", *own_theory, THEORY, steeper(OFF)),
    smoke("ladder", "formula", *own_theory, SECOND, bent(OFF)),
    smoke(
        "magnetometer", "formula", magnetometer_theory, "equations", THEORY, field_row
    ),
    smoke(
        "gyroscope", "formula", gyroscope_theory, "equations", THEORY, a_turn_steeper
    ),
    smoke("filter", "formula", filter_model, "left_jacobian", THEORY, times(OFF)),
    smoke(
        "noise_model", "formula", noise_model, "allan_covariance", VARIANCE,
        times(OFF**2),
    ),
    smoke(
        "coverage", "calibrator", covariance, "value_derivatives",
        "a derivative 0.1 % off in the error bars", scaled(..., 4),
    ),
    smoke(
        "calibration", "calibrator", Leverage, "local", "a gradient 0.1 % off", pulled
    ),
    smoke(
        "magnetometer", "calibrator", equations.Problem, "rests", ONE,
        then(lambda rows: (rows[0], off(rows[1], (..., 2, 10)), rows[2])),
    ),
    smoke("gyroscope", "calibrator", rotation, "map_slopes", ONE, scaled(..., 4)),
    smoke(
        "filter", "estimator", mekf, "_transition", ONE,
        scaled(..., slice(0, 3), slice(3, 6)),
    ),
    smoke(
        "attitude_vectors", "estimator", attitude_vectors, "wahba_covariance", VARIANCE,
        times(OFF**2),
    ),
)  # fmt: skip


# Rests


def moved(rests):
    return np.roll(rests.forces.reshape(-1, 3), -1, axis=0).reshape(rests.forces.shape)


def longer(rests):
    rests = np.array(rests)
    rests[:-1, 1] += 1
    return rests


def rest_by_n(found):
    n = found.stop - found.start
    return found.variance * (n - 1) / n


def shifted(start, stop):
    return then(lambda rests: rests + np.array([start, stop]))


found = partial(smoke, "end_to_end", "estimator", everywhere=True)
below = partial(found, detector, "intervals_below")
magnitude = partial(found, detector, "variance_magnitude")
RESTS = (
    smoke(
        "scene", "scene", scene, "checked_trajectory", "rests a row late",
        result(hold=lambda r: np.roll(r.hold, 1)),
    ),
    smoke(
        "calibration", "scene", calibration, "simulated_rests", "rests a row late",
        result(forces=moved),
    ),
    smoke(
        "gyroscope", "scene", gyroscope, "_rests", "rests end a row late", then(longer)
    ),
    below("detector a sample early", shifted(-1, 0)),
    below("detector a sample late", shifted(0, 1)),
    below("detector shifted by a sample", shifted(1, 1)),
    found(
        study_of_detector, "detect", "detector untrimmed",
        lambda o, raw, many, window, trim: o(raw, many, window, 0),
    ),
    magnitude("detector's window a sample late", then(lambda v: np.roll(v, 1))),
    magnitude(
        "a window's variance by n for n - 1",
        lambda o, samples, window: o(samples, window) * ((window - 1) / window),
    ),
    found(
        detector, "initial_rest", "a rest's variance by n for n - 1",
        result(variance=rest_by_n),
    ),
    found(
        detector, "interval_means", "means without the last sample",
        lambda o, samples, rests: o(samples, rests - np.array([0, 1])),
    ),
    found(
        detector, "interval_counts", "a sample too many counted",
        then(lambda counts: counts + 1),
    ),
)  # fmt: skip

FAULTS = (*NOISE, *FREEDOM, *CODE, *RESTS)
