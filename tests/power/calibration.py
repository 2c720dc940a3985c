"""Faults of calibrations: scene, sensor, calibrator, theory, of all three sensors."""

from dataclasses import replace
from functools import partial

import numpy as np

from power.fault import Fault, then, told
from simval.imu.calibrate import equations
from simval.imu.calibrate.gyroscope import path_statistics
from simval.imu.calibrate.magnetometer.calibration import Scaled
from simval.imu.calibrate.magnetometer.result import DIP
from simval.imu.calibrate.minimization import Leverage
from simval.imu.sensor import (
    AccelerometerModel,
    GyroscopeModel,
    MagnetometerModel,
    forms,
)
from simval.imu.sensor import NoiseModel as Noise
from simval.scene import simulate_cached
from simval.studies import calibration, gyroscope, magnetometer, noise_model, scene
from simval.theory import calibration as theory
from simval.theory import magnetometer as magnetometer_theory

# The accelerometer's chain

FOURTH = np.eye(9)[4]

scene_fault = partial(Fault, "scene", "scene", owner=scene, function="simulate")
sensor = partial(
    Fault, "calibration", "sensor", owner=AccelerometerModel, function="distort"
)
calibrator = partial(
    Fault, "calibration", "calibrator", owner=calibration, function="calibrate"
)
equation = partial(Fault, "calibration", "formula", owner=theory, function="_equations")
claim = partial(
    Fault, "calibration", "formula", owner=calibration, function="calibration_moments"
)


def a_row_late(name):
    return then(lambda r: replace(r, **{name: np.roll(getattr(r, name), 1, axis=0)}))


def moving(rests):
    # the window reaches back into the turn before: a fifth of it is not at rest
    forces = rests.forces.copy()
    late = len(forces[0]) // 5
    forces[1:, :late] = (forces[:-1, :late] + forces[1:, :late]) / 2.0
    return replace(rests, forces=forces)


def shared_noise(original, model, f_s, rng):
    raw = original(replace(model, noise_std=0.0), f_s, rng)
    common = rng.standard_normal((*raw.shape[:-1], 1))
    return raw + model.noise_std * (0.6 * common + 0.8 * rng.standard_normal(raw.shape))


def row(change):
    """Change the accelerometer's row in theory, a function of parameters and reading.

    By ``change(row, true parameters)``.
    """

    def changed(equations):
        (block,) = equations.blocks
        other = replace(block, rows=change(block.rows, equations.theta))
        return replace(equations, blocks=(other,))

    return then(changed)


def steeper(factor, some=FOURTH):
    """The derivative by some parameters is that many times itself."""
    return row(
        lambda rows, truth: (
            lambda theta, y: rows(theta + (factor - 1.0) * (theta - truth) * some, y)
        )
    )


def bent(factor, some=FOURTH):
    """The second derivative by some parameters is that many times itself."""

    def changed(rows, truth):
        def other(theta, y):
            off = (theta - truth) * some
            even = rows(truth + off, y) + rows(truth - off, y)
            even = even - 2.0 * rows(truth + 0.0 * off, y)
            return rows(theta, y) + 0.5 * (factor - 1.0) * even

        return other

    return row(changed)


ACCELEROMETER = (
    scene_fault("attitude one step late", change=a_row_late("attitude")),
    scene_fault("rates one step late", change=a_row_late("angular_velocity")),
    scene_fault(
        "rates in degrees",
        change=then(
            lambda r: replace(r, angular_velocity=np.degrees(r.angular_velocity))
        ),
    ),
    scene_fault(
        "a detector a window late",
        change=then(lambda r: replace(r, hold=np.roll(r.hold, 200))),
    ),
    scene_fault(
        "a body that trembles",
        change=then(
            lambda r: replace(
                r,
                specific_force=r.specific_force
                + 1e-4 * np.sin(300.0 * r.time)[:, None],
            )
        ),
    ),
    scene_fault(
        "six faces only",
        change=lambda o, name, poses: o(name, poses=np.vstack([np.eye(3), -np.eye(3)])),
    ),
    Fault(
        "calibration", "scene", "rests cut a window late",
        calibration, "simulated_rests", then(moving),
    ),
    sensor("T transposed", change=lambda o, m, *a: o(replace(m, T=m.T.T), *a)),
    sensor(
        "bias before scale",
        change=lambda o, m, *a: o(replace(m, B=np.linalg.solve(m.matrix, m.B)), *a),
    ),
    sensor(
        "scale after misalignment",
        change=lambda o, m, *a: o(
            replace(m, T=np.diag(m.K) @ m.T, K=np.ones(3)), *a
        ),
    ),
    sensor(
        "bias added, not subtracted", change=lambda o, m, *a: o(replace(m, B=-m.B), *a)
    ),
    sensor("noise that the three axes share", change=shared_noise),
    sensor(
        "rounded down, not to nearest",
        change=then(lambda raw: np.floor(raw / 0.01) * 0.01),
    ),
    calibrator("wrong g", change=told(g=lambda g: 1.0005 * g)),
    calibrator(
        "a pose left out",
        change=lambda o, poses, **more: o(np.delete(poses, 0, axis=-2), **more),
    ),
    # within a fraction of a standard error: paired noise shows it, and the response
    Fault(
        "calibration", "calibrator", "the closed-form start taken for the answer",
        Leverage, "_best",
        lambda o, x, at: o(replace(x, start_cost=np.zeros_like(x.start_cost)), at),
    ),
    calibrator(
        "another residual than stated",
        change=lambda o, *a, **more: o(*a, **more | {"residual": "norm"}),
    ),
    Fault(
        "calibration", "calibrator", "order of the parameters",
        forms, "from_gram", then(lambda p: np.roll(p, 3, axis=-1)),
        crash=True,  # the solver starts so far off that it refuses some trials
    ),
    equation("Jacobian: one derivative 20 % off", change=steeper(1.2)),
    equation(
        "Hessian left out of the bias", change=bent(0.0, np.ones(9))
    ),
    claim(
        "calibration bias of the wrong sign",
        change=then(lambda m: replace(m, bias=-m.bias)),
    ),
    claim(
        "Cramer-Rao for the covariance, halved",
        change=then(lambda m: replace(m, covariance=m.cramer_rao / 2.0)),
    ),
    claim("variance of a mean for its root", change=told(noise_std=np.square)),
)  # fmt: skip

# The magnetometer's chain

iron = partial(
    Fault, "magnetometer", "sensor", owner=MagnetometerModel, function="distort"
)
weigher = partial(Fault, "magnetometer", "calibrator")
bound = partial(
    Fault,
    "magnetometer",
    "formula",
    owner=magnetometer,
    function="magnetometer_moments",
)
calibrate = (magnetometer, "calibrate_magnetometer")


def wrong_sign(original, scaled, theta, spread):
    # u'v - s = 0 for u'v + s = 0, in all of its places: the sine changes its sign
    turned = np.array(theta)
    turned[:, DIP] *= -1.0
    return original(scaled, turned, spread)


def one_sign(original, sensor, w, theta):
    norm, dip = original(sensor, w, theta)
    return [norm, dip._replace(value=dip.value - 2.0 * theta[:, -1:])]


def without_accelerometer(original, L):
    # of the third equation, which both sensors' noise is in
    quiet = np.array(L)
    quiet[:, :, 2, :3] *= 1e-9
    return original(quiet)


def unweighted(original, L):
    flat = np.zeros_like(original(L))
    flat[..., range(3), range(3)] = 1.0 / np.sqrt(np.vecdot(L, L)[..., 1].mean())
    return flat


def accelerometer_known(original, information):
    # its rows are not eliminated
    covariance = np.array(original(information))
    covariance[9:, 9:] = np.linalg.inv(information[9:, 9:])
    return covariance


MAGNETOMETER = (
    iron(
        "M of the magnetometer transposed",
        change=lambda o, m, *a: o(replace(m, M=m.M.T), *a),
    ),
    iron("hard iron dropped", change=lambda o, m, *a: o(replace(m, b=0.0 * m.b), *a)),
    weigher("sign of the dip's term", Scaled, "physical", wrong_sign),
    weigher(
        "dip's term, not its derivative", equations.Magnetometer, "equations",
        one_sign, crash=True,
    ),
    weigher(
        "accelerometer's noise left out of the weights",
        equations, "_whitener", without_accelerometer,
    ),
    weigher("all equations weighed alike", equations, "_whitener", unweighted),
    weigher(
        "the twin of the other hemisphere", *calibrate,
        lambda o, *a, **more: o(*a, **more | {"hemisphere": "south"}),
    ),
    weigher(
        "poses of the two sensors a row apart", *calibrate,
        lambda o, a, m, g, **more: o(a, np.roll(m, 1, axis=-2), g, **more), crash=True,
    ),
    bound(
        "recipe for the bound", change=then(lambda m: replace(m, covariance=m.recipe))
    ),
    bound(
        "bound for the recipe", change=then(lambda m: replace(m, recipe=m.covariance))
    ),
    Fault(
        "magnetometer", "formula", "bound with the accelerometer known",
        magnetometer_theory, "inverse_of", accelerometer_known,
    ),
)  # fmt: skip

# The gyroscope's chain

rates = partial(Fault, "gyroscope", "scene", owner=gyroscope, function="average_rates")
turns = partial(Fault, "gyroscope", "calibrator")
QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def instant(_, run, every=1):
    return np.asarray(run.angular_velocity[::every])


def force_felt(original, tumble, parameters):
    # 1e-3 rad/s for each g, which nobody takes out
    original(tumble, parameters)
    run = simulate_cached(
        "gimbal", poses=parameters.poses, first_hold=20.0,
        move_time=parameters.move_time,
    )  # fmt: skip
    tumble.rates = tumble.rates + 1e-4 * run.specific_force[:: parameters.every]


def row_lost(original, time, rows, *more, **named):
    late = np.array(rows)
    # one in twenty is the row before
    late[..., 1::20, :] = np.asarray(rows)[..., 0:-1:20, :]
    return original(time, late, *more, **named)


def no_coning(steps):
    steps[..., path_statistics._A, :] = 0.0
    return np.asarray(steps)


def poses_apart(original, V):
    # the noise of a pose as if each gap had its own; what is no covariance of rows, the
    # information of 21 parameters, stays
    if V.shape[-1] <= 21:
        return original(V)
    own, gaps = np.array(V), 2 * ((V.shape[-1] - 4) // 3)
    own[:, :gaps] = own[:, :, :gaps] = 0.0
    for k in range(0, gaps, 2):
        own[:, k : k + 2, k : k + 2] = V[:, k : k + 2, k : k + 2]
    return original(own)


GYROSCOPE = (
    rates("rates of an instant for averages", change=instant),
    rates("axes of the gyroscope turned", change=then(lambda w: w @ QUARTER.T)),
    rates("sign of the rates", change=then(np.negative), crash=True),
    Fault(
        "gyroscope", "sensor", "M of the gyroscope transposed",
        GyroscopeModel, "distort",
        lambda o, m, *a, **more: o(replace(m, M=m.M.T), *a, **more),
    ),
    Fault(
        "gyroscope", "sensor", "g-sensitivity dropped",
        gyroscope.Tumble, "__init__", force_felt,
    ),
    turns(
        "a clock that is 0.1 % slow", gyroscope, "inter_rest_rotations",
        lambda o, time, *a, **more: o(1.001 * time, *a, **more),
    ),
    turns("one row in twenty repeated", gyroscope, "inter_rest_rotations", row_lost),
    turns("coning term lost", path_statistics, "_step", then(no_coning)),
    turns(
        "covariance without the shared poses", equations, "_inverse_root", poses_apart
    ),
    turns(
        "told 0.7 of its noise", gyroscope, "calibrate_gyroscope",
        told(angle_random_walk=lambda x: 0.7 * x),
    ),
    Fault(
        "gyroscope", "formula", "bound with poses of a third of their noise",
        gyroscope, "gyroscope_moments", told(pose_std=lambda x: 0.3 * x),
    ),
)  # fmt: skip


def louder(original, model, *given):
    white = 1.05 * np.asarray(model.white_raw_per_sqrt_hz)
    return original(replace(model, white_raw_per_sqrt_hz=white), *given)


NOISE = (
    Fault("noise", "noise", "white noise 5 % louder", Noise, "draw", louder),
    Fault(
        "noise", "noise", "flicker noise dropped", Noise, "draw",
        lambda o, model, *a: o(replace(model, flicker_raw=0.0), *a),
    ),
    Fault(
        "noise", "estimator", "Allan variances 5 % too small",
        noise_model, "allan_variance", then(lambda v: 0.95 * v),
    ),
    Fault(
        "noise", "formula", "(V4) of half the averages",  # of `simval.imu.noise.allan`
        noise_model, "allan_covariance", then(lambda v: 2.0 * v),
    ),
)  # fmt: skip

FAULTS = (*ACCELEROMETER, *MAGNETOMETER, *GYROSCOPE, *NOISE)
