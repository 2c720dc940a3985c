"""Race of the calibration: a batch of trials beside a loop over SciPy."""

from functools import partial

import numpy as np
import scipy
from imu_tk import imu_tk_jacobian, imu_tk_residual

from benchmarks.race import Answers, Contender, race
from simval.arrays import Array
from simval.imu.calibrate import calibrate
from simval.imu.sensor import AccelerometerModel
from simval.poses import fibonacci_sphere
from simval.shapes import Float

G = 9.80665  # m/s^2, standard gravity
POSES = 40  # chosen; every contender takes longer with more
NOISE = 0.02  # m/s^2, of a pose; chosen
TOLERANCE = 1e-12
"""Relative step at which every solver stops. Chosen: near rounding, so that all end at
the same point."""
MANY, FEW = 10_000, 100
AGREEMENT = 1e-9
"""Relative difference allowed between contenders. Chosen: a thousand times
`TOLERANCE`; far below the standard error of a parameter, about 1e-3."""
SIZE = np.array([1.0] * 6 + [G] * 3)  # biases and small angles beside g and 1


def noisy_poses(count: int) -> Float[Array, "count 40 3"]:
    """Draw noisy pose sets of one sensor."""
    values = np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1])
    sensor = AccelerometerModel.from_parameters(values, noise_std=NOISE)
    forces = G * np.broadcast_to(fibonacci_sphere(POSES), (count, POSES, 3))
    return sensor.distort(forces, np.random.default_rng(1))


def ellipsoid_start(readings: Float[Array, "n 3"]) -> Float[Array, "9"]:
    """Closed-form start of one pose set, as a user of SciPy would write it."""
    x, y, z = readings.T
    columns = np.stack([x * x, y * y, z * z, x * y, x * z, y * z, x, y, z], axis=-1)
    p = np.linalg.lstsq(columns, np.ones(len(readings)), rcond=None)[0]
    A = np.array(
        [[2 * p[0], p[3], p[4]], [p[3], 2 * p[1], p[5]], [p[4], p[5], 2 * p[2]]]
    )
    bias = -np.linalg.solve(A, p[6:])
    A *= G**2 / (2.0 + bias @ A @ bias)
    lower = np.linalg.cholesky(A[::-1, ::-1])[::-1, ::-1].T
    scale = np.diagonal(lower)
    shape = lower / scale
    off = [shape[1, 0], -shape[2, 0], shape[2, 1]]
    return np.concatenate([off, scale, bias])


@race("calibration", "Calibrations of 40 poses, parameters, to 1e-12", "fits")
def batch() -> list[Contender]:
    """List the ways to fit many sets; the reference is SciPy's default, looped.

    Every contender starts from its own ellipsoid, stops at `TOLERANCE` and gets the
    same data.
    """
    readings = noisy_poses(MANY)
    few = readings[:FEW]

    def seen(found: Float[Array, "trials 9"]) -> Answers:
        # half of it for each of two
        within = 0.5 * AGREEMENT * np.maximum(np.abs(found), SIZE)
        return {"parameters": (found, within)}

    def scipy_loop(method: str) -> Float[Array, "trials 9"]:
        """Fit each set by `scipy.optimize.least_squares` with the exact Jacobian."""
        limits = dict.fromkeys(("xtol", "ftol", "gtol"), TOLERANCE)
        return np.array(
            [
                scipy.optimize.least_squares(
                    lambda p, y=y: imu_tk_residual(p, y, G),
                    ellipsoid_start(y),
                    jac=lambda p, y=y: imu_tk_jacobian(p, y),
                    method=method,
                    **limits,
                ).x
                for y in few
            ]
        )

    def fitted(readings: Array, covariance: bool = False) -> Array:
        fit = calibrate(readings, G, tolerance=TOLERANCE, covariance=covariance)
        return np.asarray(fit.parameters)

    peer = "scipy least_squares {}, loop, data unchecked".format
    ways = {
        peer("trf"): (FEW, partial(scipy_loop, "trf")),
        peer("lm"): (FEW, partial(scipy_loop, "lm")),
        "calibrate, one set at a time": (
            FEW, lambda: np.array([fitted(y) for y in few]),
        ),
        "calibrate, batch": (MANY, partial(fitted, readings)),
        "calibrate, batch with covariance": (MANY, partial(fitted, readings, True)),
    }  # fmt: skip
    return [Contender(name, count, run, seen) for name, (count, run) in ways.items()]
