"""Races of the calibration: a batch of trials beside a loop over SciPy."""

from functools import partial

import numpy as np
import scipy
from imu_tk import imu_tk_jacobian, imu_tk_residual

from benchmarks.race import Answer, Contender, Done
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


def scipy_loop(
    readings: Float[Array, "trials n 3"], method: str
) -> Float[Array, "trials 9"]:
    """Fit each set by `scipy.optimize.least_squares` with the analytic Jacobian."""
    options = {"method": method, "xtol": TOLERANCE, "ftol": TOLERANCE}
    return np.array(
        [
            scipy.optimize.least_squares(
                lambda p, y=y: imu_tk_residual(p, y, G),
                ellipsoid_start(y),
                jac=lambda p, y=y: imu_tk_jacobian(p, y),
                gtol=TOLERANCE,
                **options,
            ).x
            for y in readings
        ]
    )


def batch() -> list[Contender]:
    """List the ways to fit many sets; the reference is SciPy's default, looped.

    Every contender starts from its own ellipsoid, stops at `TOLERANCE` and gets the
    same data.
    """
    readings = noisy_poses(MANY)
    few = readings[:FEW]

    def batched(covariance: bool) -> Array:
        fit = calibrate(readings, G, tolerance=TOLERANCE, covariance=covariance)
        return np.asarray(fit.parameters)

    def one_by_one() -> Array:
        fits = [calibrate(y, G, tolerance=TOLERANCE, covariance=False) for y in few]
        return np.array([fit.parameters for fit in fits])

    peers = {
        f"scipy least_squares {method}, loop, data unchecked": partial(
            scipy_loop, few, method
        )
        for method in ("trf", "lm")
    }
    ours = {
        "calibrate, one set at a time": one_by_one,
        "calibrate, batch": partial(batched, False),
        "calibrate, batch with covariance": partial(batched, True),
    }
    return [
        Contender(name=name, run=run, seen=_parameters)
        for name, run in {**peers, **ours}.items()
    ]


def _parameters(found: Float[Array, "trials 9"]) -> Done:
    return Done(items=len(found), answers={"parameters": _near(found, AGREEMENT)})


def _near(found: Float[Array, "trials 9"], relative: float) -> Answer:
    # half of it for each of two
    return Answer(values=found, within=0.5 * relative * np.maximum(np.abs(found), SIZE))
