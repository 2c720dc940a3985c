"""Races of the calibration: a batch of trials beside a loop over SciPy."""

from functools import partial

import numpy as np
import scipy

from simval.arrays import Array
from simval.bench.imu_tk import imu_tk_jacobian, imu_tk_residual
from simval.bench.race import Contender
from simval.calibrate import calibrate
from simval.poses import fibonacci_sphere
from simval.sensor import AccelerometerModel
from simval.shapes import Float

G = 9.80665  # m/s^2, standard gravity
POSES = 40  # chosen; every contender takes longer with more
NOISE = 0.02  # m/s^2, of a pose; chosen
TOLERANCE = 1e-12
"""Relative step at which every solver stops. Chosen: near rounding, so that all end at
the same point."""
MANY, FEW = 10_000, 200
AGREEMENT = 1e-9
"""Relative difference allowed between contenders. Chosen: a thousand times
`TOLERANCE`; far below the standard error of a parameter, about 1e-3."""


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
    same data; a difference of more than `AGREEMENT` is an error.
    """
    readings = noisy_poses(MANY)
    expected = calibrate(readings, G, tolerance=TOLERANCE, covariance=False).parameters

    def looped(method: str) -> int:
        _require_equal(scipy_loop(readings[:FEW], method), expected[:FEW], method)
        return FEW

    def batched(covariance: bool) -> int:
        fit = calibrate(readings, G, tolerance=TOLERANCE, covariance=covariance)
        return len(fit.parameters)

    def one_by_one() -> int:
        for one in readings[:FEW]:
            calibrate(one, G, tolerance=TOLERANCE, covariance=False)
        return FEW

    return [
        Contender(name="scipy least_squares trf, loop", run=partial(looped, "trf")),
        Contender(name="scipy least_squares lm, loop", run=partial(looped, "lm")),
        Contender(name="calibrate, one set at a time", run=one_by_one),
        Contender(name="calibrate, batch", run=partial(batched, False)),
        Contender(name="calibrate, batch with covariance", run=partial(batched, True)),
    ]


def residuals() -> list[Contender]:
    """List the residuals, a batch each; the reference is the squared one."""
    readings = noisy_poses(MANY // 4)

    def fit(residual: str) -> int:
        calibrate(readings, G, residual=residual, noise_std=NOISE)
        return len(readings)

    names = ("squared", "norm", "weighted", "sampson", "adjusted")
    return [Contender(name=name, run=partial(fit, name)) for name in names]


def samples() -> list[Contender]:
    """List sizes of one set; the reference has the fewest samples."""
    flat = noisy_poses(25_000).reshape(-1, 3)

    def fit(count: int) -> int:
        calibrate(flat[:count], G, repeats=True, covariance=False)
        return count

    sizes = (10_000, 100_000, 1_000_000)
    return [Contender(name=f"{n:,} samples", run=partial(fit, n)) for n in sizes]


def _require_equal(
    fitted: Float[Array, "... 9"], expected: Float[Array, "... 9"], name: str
) -> None:
    # biases and misalignments near zero are compared with g and 1
    size = np.maximum(np.abs(expected), np.array([1.0] * 6 + [G] * 3))
    worst = float(np.max(np.abs(fitted - expected) / size))
    if not worst <= AGREEMENT:
        msg = f"{name} differs by {worst:.1e} relative; {AGREEMENT:g} is allowed"
        raise AssertionError(msg)
