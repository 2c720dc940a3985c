"""Faults of calibrations: scene, sensor, calibrator, theory, of all three sensors."""

from dataclasses import replace
from functools import partial

import numpy as np

from power.fault import Fault, given, result, then, times, told, told_instead
from simval.imu.calibrate import equations, path_statistics
from simval.imu.calibrate.magnetometer.calibration import Scaled
from simval.imu.calibrate.magnetometer.result import DIP
from simval.imu.calibrate.minimization import Leverage
from simval.imu.noise import evidence
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
FACES = np.vstack([np.eye(3), -np.eye(3)])


def a_row_late(name):
    return result(**{name: lambda r: np.roll(getattr(r, name), 1, axis=0)})


def trembling(r):
    return r.specific_force + 1e-4 * np.sin(300.0 * r.time)[:, None]


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
        other = block._replace(rows=change(block.rows, equations.theta))
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


scene_fault = partial(Fault, "scene", "scene", scene, "checked_trajectory")
chain = partial(Fault, "calibration")
sensor = partial(chain, "sensor", AccelerometerModel, "distort")
calibrator = partial(chain, "calibrator", calibration, "calibrate")
equation = partial(chain, "formula", theory, "_equations")
claim = partial(chain, "formula", calibration, "calibration_moments")
ACCELEROMETER = (
    scene_fault("attitude one step late", a_row_late("attitude")),
    scene_fault("rates one step late", a_row_late("angular_velocity")),
    scene_fault(
        "rates in degrees",
        result(angular_velocity=lambda r: np.degrees(r.angular_velocity)),
    ),
    scene_fault(
        "a detector a window late", result(hold=lambda r: np.roll(r.hold, 200))
    ),
    scene_fault("a body that trembles", result(specific_force=trembling)),
    Fault(
        "scene", "scene", scene, "plan_run", "six faces only", told_instead(poses=FACES)
    ),
    chain(
        "scene", calibration, "simulated_rests", "rests cut a window late", then(moving)
    ),
    sensor("T transposed", given(T=lambda m: m.T.T)),
    sensor("bias before scale", given(B=lambda m: np.linalg.solve(m.matrix, m.B))),
    sensor(
        "scale after misalignment",
        given(T=lambda m: np.diag(m.K) @ m.T, K=lambda m: np.ones(3)),
    ),
    sensor("bias added, not subtracted", given(B=lambda m: -m.B)),
    sensor("noise that the three axes share", shared_noise),
    sensor(
        "rounded down, not to nearest", then(lambda raw: np.floor(raw / 0.01) * 0.01)
    ),
    calibrator("wrong g", told(g=lambda g: 1.0005 * g)),
    calibrator(
        "a pose left out",
        lambda o, poses, **more: o(np.delete(poses, 0, axis=-2), **more),
    ),
    # within a fraction of a standard error: paired noise shows it, and the response
    chain(
        "calibrator", Leverage, "_best", "the closed-form start taken for the answer",
        lambda o, x, at: o(replace(x, start_cost=np.zeros_like(x.start_cost)), at),
    ),
    calibrator("another residual than stated", told_instead(residual="norm")),
    chain(
        "calibrator", forms, "from_gram", "order of the parameters",
        then(lambda p: np.roll(p, 3, axis=-1)),
        crash=True,  # the solver starts so far off that it refuses some trials
    ),
    equation("Jacobian: one derivative 20 % off", steeper(1.2)),
    equation("Hessian left out of the bias", bent(0.0, np.ones(9))),
    claim("calibration bias of the wrong sign", result(bias=lambda m: -m.bias)),
    claim(
        "Cramer-Rao for the covariance, halved",
        result(covariance=lambda m: m.cramer_rao / 2.0),
    ),
    claim("variance of a mean for its root", told(noise_std=np.square)),
)  # fmt: skip

# The magnetometer's chain


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


magnetic = partial(Fault, "magnetometer")
iron = partial(magnetic, "sensor", MagnetometerModel, "distort")
weigher = partial(magnetic, "calibrator")
whitener = partial(weigher, equations, "_whitener")
recorded = partial(weigher, magnetometer, "Recording")
bound = partial(magnetic, "formula", magnetometer, "magnetometer_moments")
MAGNETOMETER = (
    iron("M of the magnetometer transposed", given(M=lambda m: m.M.T)),
    iron("hard iron dropped", given(b=lambda m: 0.0 * m.b)),
    weigher(Scaled, "physical", "sign of the dip's term", wrong_sign),
    weigher(
        equations.Magnetometer, "equations", "dip's term, not its derivative",
        one_sign, crash=True,
    ),
    whitener("accelerometer's noise left out of the weights", without_accelerometer),
    whitener("all equations weighed alike", unweighted),
    recorded("the twin of the other hemisphere", told_instead(hemisphere="south")),
    recorded(
        "poses of the two sensors a row apart",
        told(fields=lambda m: np.roll(m, 1, axis=-2)), crash=True,
    ),
    bound("recipe for the bound", result(covariance=lambda m: m.recipe)),
    bound("bound for the recipe", result(recipe=lambda m: m.covariance)),
    magnetic(
        "formula", magnetometer_theory, "inverse_of",
        "bound with the accelerometer known", accelerometer_known,
    ),
)  # fmt: skip

# The gyroscope's chain

QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def instant(_, run, every=1):
    return np.asarray(run.angular_velocity[::every])


def force_felt(original, tumble, parameters, *steps):
    # 1e-3 rad/s for each g, which nobody takes out
    original(tumble, parameters, *steps)
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


turning = partial(Fault, "gyroscope")
rates = partial(turning, "scene", gyroscope, "average_rates")
between = partial(turning, "calibrator", gyroscope, "inter_rest_rotations")
GYROSCOPE = (
    rates("rates of an instant for averages", instant),
    rates("axes of the gyroscope turned", then(lambda w: w @ QUARTER.T)),
    rates("sign of the rates", then(np.negative), crash=True),
    turning(
        "sensor", GyroscopeModel, "distort", "M of the gyroscope transposed",
        given(M=lambda m: m.M.T),
    ),
    turning(
        "sensor", gyroscope.Tumble, "__init__", "g-sensitivity dropped", force_felt
    ),
    between(
        "a clock that is 0.1 % slow",
        lambda o, time, *a, **more: o(1.001 * time, *a, **more),
    ),
    between("one row in twenty repeated", row_lost),
    turning(
        "calibrator", path_statistics, "_step", "coning term lost", then(no_coning)
    ),
    turning(
        "calibrator", equations, "_inverse_root", "covariance without the shared poses",
        poses_apart,
    ),
    turning(
        "calibrator", gyroscope, "Recording", "told 0.7 of its noise",
        told(angle_random_walk=lambda x: 0.7 * x),
    ),
    turning(
        "formula", gyroscope, "gyroscope_moments",
        "bound with poses of a third of their noise", told(pose_std=lambda x: 0.3 * x),
    ),
)  # fmt: skip


def louder(factor):
    """White noise that is so many times as loud."""
    return given(
        white_raw_per_sqrt_hz=lambda m: factor * np.asarray(m.white_raw_per_sqrt_hz)
    )


drawn = partial(Fault, "noise", "noise", Noise, "draw")
NOISE = (
    drawn("white noise 5 % louder", louder(1.05)),
    drawn("flicker noise dropped", given(flicker_raw=lambda m: 0.0)),
    Fault(
        "noise", "estimator", noise_model, "allan_variance",
        "Allan variances 5 % too small", times(0.95),
    ),
    Fault(
        "noise", "formula", noise_model, "allan_covariance",
        "(V4) of half the averages",  # of `simval.imu.noise.allan`
        times(2.0),
    ),
    Fault(
        "choices", "estimator", evidence, "_likely",
        "components that a signal does not tell apart left out",
        lambda original, sets, *more: [min(sets, key=sets.get)],
    ),
)  # fmt: skip

FAULTS = (*ACCELEROMETER, *MAGNETOMETER, *GYROSCOPE, *NOISE)
