"""Small faults of noise, streams and code, in the smoke suite's own cells.

Each leaves errors that look right: noise a hundredth too loud, a stream that is used
twice, n for n - 1, a derivative off by a thousandth, a detector off by a sample.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from power.calibration import bent, steeper
from power.fault import Fault, then, told
from simval.imu.calibrate import equations, evidence
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
EVERY = slice(None)
TOO_SMALL = (
    "1/n of a variance that n trials tell to sqrt(2/n); the functions that all studies "
    "share are judged by `sampling`, a study's own lines are not"
)
# studies that draw their normals from the generator of a block
DRAWN = (
    "ladder", "coverage", "magnetometer", "gyroscope", "filter", "attitude_vectors",
)  # fmt: skip
FELT = ("calibration", "end_to_end")  # whose accelerometer draws its own


def smoke(study, part, name, *change, **more):
    return Fault(f"smoke {study}", part, f"{name}, {study}", *change, **more)


class ChangedNormals(np.random.Generator):
    """A generator whose normals are changed on their way."""

    def __init__(self, generator, change):
        super().__init__(generator.bit_generator)
        self.generator, self.change = generator, change

    def standard_normal(self, size=None):
        """Normals, changed."""
        return self.change(self.generator.standard_normal(size))


class Again:
    """A generator whose second draw repeats the first one's numbers."""

    def __init__(self, original, *given):
        self.make = partial(original, *given)

    def standard_normal(self, shape=None):
        """The first numbers."""
        return self.make().standard_normal(shape)


def normals(change):
    return lambda original, *given: ChangedNormals(original(*given), change)


def first_sensor_twice(noise):
    if np.ndim(noise) == 3 and len(noise) == 2:
        noise[1] = noise[0]
    return noise


def louder_accelerometer(original, model, f_s, rng):
    return original(replace(model, noise_std=LOUDER * model.noise_std), f_s, rng)


def louder_white(original, model, *given):
    own = LOUDER * np.asarray(model.white_raw_per_sqrt_hz)
    return original(replace(model, white_raw_per_sqrt_hz=own), *given)


def more(*names):
    return told(**dict.fromkeys(names, lambda std: LOUDER * std))


LOUD, MORE = "noise 1 % louder", "told 1 % more noise"
SHARED = "two sensors share a stream"
block = (Streams, "block")
NOISE = (
    *(
        smoke(s, "noise", LOUD, *block, normals(lambda x: LOUDER * x))
        for s in DRAWN
    ),
    *(
        smoke(s, "noise", LOUD, AccelerometerModel, "distort", louder_accelerometer)
        for s in FELT
    ),
    smoke("noise_model", "noise", LOUD, NoiseModel, "draw", louder_white),
    smoke(
        "magnetometer", "calibrator", MORE, magnetometer, "calibrate_magnetometer",
        more("accelerometer_std", "magnetometer_std"),
    ),
    smoke(
        "gyroscope", "calibrator", MORE, gyroscope, "calibrate_gyroscope",
        more("angle_random_walk"),
    ),
    smoke(
        "filter", "calibrator", MORE, Mekf, "__init__",
        more("accelerometer_noise", "magnetometer_noise"),
    ),
    *(
        smoke(
            s, "noise", "every block the same noise", *block,
            lambda o, streams, number: o(streams, 0),
        )
        for s in (*FELT, *DRAWN, "noise_model")
    ),
    *(
        smoke(
            s, "noise", "one block's noise used twice", *block,
            lambda o, streams, number: o(streams, 0 if number == 1 else number),
        )
        for s in ("calibration", "gyroscope", "noise_model", "end_to_end", "filter")
    ),
    smoke("magnetometer", "noise", SHARED, *block, normals(first_sensor_twice)),
    *(smoke(s, "noise", SHARED, *block, Again) for s in ("gyroscope", "filter")),
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


def by_n(study, part, where, *change, **more):
    return smoke(study, part, f"n for n - 1{where}", *change, **more)


shared = partial(by_n, "sampling", "estimator", everywhere=True)
FREEDOM = (
    shared(
        "", plain, "_variance",
        lambda o, sums: o(sums) * ((sums.batches - 1) / sums.batches),
    ),
    shared(" in an error of a mean", trials, "mean_of", then(mean_by_n)),
    shared(" under control variates", response, "reduced_mean", reduced_by_n),
    by_n("coverage", "calibrator", "", coverage, "calibrate", type_a_by_fewer),
    by_n(
        "magnetometer", "calibrator", "", magnetometer.Scenario, "fitted",
        then(lambda fit: replace(fit, dof=fit.dof + 1)),
    ),
    by_n(
        "ladder", "estimator", " in the study's own lines", ladder, "moments_of",
        then(lambda m: replace(
            m, covariance=m.covariance * ((m.samples - 1) / m.samples)
        )),
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


def first_scaled(*index):
    return then(lambda given: (off(given[0], index), *given[1:]))


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

    return replace(found, blocks=(replace(turns, rows=rows), *others))


THEORY, ONE = "a derivative of theory 0.1 % off", "a derivative 0.1 % off"
CODE = (
    smoke(
        "calibration", "formula", THEORY, calibration_theory, "_equations", steeper(OFF)
    ),
    smoke("ladder", "formula", THEORY, calibration_theory, "_equations", steeper(OFF)),
    smoke(
        "ladder", "formula", "a second derivative 0.1 % off",
        calibration_theory, "_equations", bent(OFF),
    ),
    smoke(
        "magnetometer", "formula", THEORY, magnetometer_theory, "equations", field_row,
    ),
    smoke(
        "gyroscope", "formula", THEORY, gyroscope_theory, "equations", a_turn_steeper,
    ),
    smoke(
        "filter", "formula", THEORY, filter_model, "left_jacobian",
        then(lambda L: OFF * L),
    ),
    smoke(
        "noise_model", "formula", "a covariance 0.2 % off",
        noise_model, "allan_covariance", then(lambda v: OFF**2 * v),
    ),
    smoke(
        "coverage", "calibrator", "a derivative 0.1 % off in the error bars",
        evidence, "value_derivatives", scaled(..., 4),
    ),
    smoke(
        "calibration", "calibrator", "a gradient 0.1 % off", Leverage, "local", pulled
    ),
    smoke(
        "magnetometer", "calibrator", ONE, equations.Problem, "rests",
        then(lambda rows: (rows[0], off(rows[1], (..., 2, 10)), rows[2])),
    ),
    smoke("gyroscope", "calibrator", ONE, rotation, "map_slopes", scaled(..., 4)),
    smoke(
        "filter", "estimator", ONE, mekf, "_transition",
        scaled(..., slice(0, 3), slice(3, 6)),
    ),
    smoke(
        "attitude_vectors", "estimator", "a covariance 0.2 % off",
        attitude_vectors, "wahba_covariance", then(lambda v: OFF**2 * v),
    ),
)  # fmt: skip


# Rests


def moved(rests):
    forces = np.roll(np.array(rests.forces).reshape(-1, 3), -1, axis=0)
    return replace(rests, forces=forces.reshape(rests.forces.shape))


def longer(rests):
    rests = np.array(rests)
    rests[:-1, 1] += 1
    return rests


def rest_by_n(found):
    n = found.stop - found.start
    return replace(found, variance=found.variance * (n - 1) / n)


def found(name, owner, function, change):
    return smoke(
        "end_to_end", "estimator", name, owner, function, change, everywhere=True
    )


def shifted(start, stop):
    return then(lambda rests: rests + np.array([start, stop]))


below = (detector, "intervals_below")
RESTS = (
    smoke(
        "scene", "scene", "rests a row late", scene, "simulate",
        then(lambda r: replace(r, hold=np.roll(r.hold, 1))),
    ),
    smoke(
        "calibration", "scene", "rests a row late",
        calibration, "simulated_rests", then(moved),
    ),
    smoke(
        "gyroscope", "scene", "rests end a row late", gyroscope, "_rests", then(longer)
    ),
    found("detector a sample early", *below, shifted(-1, 0)),
    found("detector a sample late", *below, shifted(0, 1)),
    found("detector shifted by a sample", *below, shifted(1, 1)),
    found(
        "detector untrimmed", study_of_detector, "detect",
        lambda o, raw, many, window, trim: o(raw, many, window, 0),
    ),
    found(
        "detector's window a sample late", detector, "variance_magnitude",
        then(lambda v: np.roll(v, 1)),
    ),
    found(
        "a window's variance by n for n - 1", detector, "variance_magnitude",
        lambda o, samples, window: o(samples, window) * ((window - 1) / window),
    ),
    found(
        "a rest's variance by n for n - 1", detector, "initial_rest", then(rest_by_n)
    ),
    found(
        "means without the last sample", detector, "interval_means",
        lambda o, samples, rests: o(samples, rests - np.array([0, 1])),
    ),
    found(
        "a sample too many counted", detector, "interval_counts",
        then(lambda counts: counts + 1),
    ),
)  # fmt: skip

FAULTS = (*NOISE, *FREEDOM, *CODE, *RESTS)
