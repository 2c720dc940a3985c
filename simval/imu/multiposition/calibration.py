"""The calibration of a log, from top to bottom."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array, frozen
from simval.errors import RefusedError
from simval.imu.calibrate import FitResult, calibrate
from simval.imu.calibrate.diagnosis import Diagnosis, diagnose
from simval.imu.calibrate.evidence import FEW
from simval.imu.logs import Log
from simval.imu.multiposition.description import log_lines
from simval.imu.multiposition.faults import require_unsaturated
from simval.imu.multiposition.health import explained, require_sound
from simval.imu.multiposition.noise import PoseNoise, pose_noise
from simval.imu.multiposition.rests import find_rests
from simval.imu.noise import NoiseFile
from simval.imu.statics import Intervals, Rest, interval_counts, interval_means
from simval.poses import PARAMETERS, observability
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LogCalibration:
    """Calibration of a log, with what it was made from.

    Attributes
    ----------
    fit : FitResult
        The calibration, with Type A error bars.
    diagnosis : Diagnosis
        Residuals, outliers, chi-square and verdict, by `pose_noise`.
    white_chi2_per_dof : float
        Chi-square per degree of freedom if white noise were all there is; NaN where the
        readings show no noise.
    pose_noise : PoseNoise
        Noise of the mean of each rest, and where it comes from.
    rest : Rest
        The initial rest.
    rest_seconds : float
        Its length, s.
    multiplier : float
        Threshold of the detector over the variance of the rest.
    intervals : Intervals
        Static intervals, samples start <= k < stop, (m, 2).
    cuts : tuple of str
        Rests of the accelerometer in which the gyroscope turns: cut, left out or, of
        too few, kept.
    turns : bool
        Whether it does in all but too few: `intervals` are the accelerometer's then,
        and the gyroscope cannot be calibrated.
    predicted : CalibrationMoments or None
        Bias, covariance and Cramer-Rao bound by `pose_noise`; None where nobody was
        asked, or the readings show no noise.
    next_direction : Array
        Direction of a further pose that would help most, sensor axes, (3,).
    """

    fit: FitResult
    diagnosis: Diagnosis
    white_chi2_per_dof: float
    pose_noise: PoseNoise
    rest: Rest
    rest_seconds: float
    multiplier: float
    intervals: Intervals
    cuts: tuple[str, ...]
    turns: bool
    predicted: Any
    next_direction: Float[Array, "3"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "next_direction", frozen(self.next_direction))

    def __str__(self) -> str:
        return "\n".join(log_lines(self))


def calibrate_log(
    log: Log,
    *,
    g: float = 9.80665,
    model: str = "triangular",
    method: str = "lm",
    residual: str = "squared",
    loss: str = "linear",
    rest: float | None = None,
    full_scale: float | None = None,
    noise: NoiseFile | None = None,
    predict: Callable[..., Any] | None = None,
) -> LogCalibration:
    """Calibrate the accelerometer of a log.

    Parameters
    ----------
    log : Log
        The log, see `simval.imu.logs.read_log`.
    g : float
        Local gravity, m/s^2.
    model, method, residual, loss : str
        As in `simval.imu.calibrate.calibrate`.
    rest : float or None
        Length of the initial rest, s; None finds it.
    full_scale : float or None
        Greatest reading of the sensor, units of the log.
    noise : NoiseFile or None
        The sensor's noise, see `simval.imu.noise.load_noise`; None takes it from the
        log's longest rest, and white noise alone where that is too short.
    predict : callable or None
        What says how well the sensor can be known from these rests, such as
        `simval.theory.calibration_moments`.

    Returns
    -------
    LogCalibration
        The calibration and what it was made from.

    Raises
    ------
    RefusedError
        If there is no rest, no threshold gives nine static intervals, none of the
        fits is a calibration, or the log shows a fault of the sensor or the logger.
    """

    def detect(part: Log, least: int) -> Intervals:
        known = rest if part.time[0] == log.time[0] else None
        return find_rests(part, known, least).best.intervals

    form = {"model": model, "method": method, "loss": loss}
    try:
        result, white = _calibrated(
            log, rest, full_scale, g, residual, form, noise, predict
        )
    except RefusedError as refusal:
        raise explained(log, refusal, g, detect) from refusal
    require_sound(log, result.fit, result.intervals, white, detect)
    return result


def _calibrated(
    log: Log,
    rest: float | None,
    full_scale: float | None,
    g: float,
    residual: str,
    form: dict[str, Any],
    known: NoiseFile | None,
    predict: Callable[..., Any] | None,
) -> tuple[LogCalibration, Diagnosis]:
    # and the diagnosis by white noise alone, which faults are told by
    rests = find_rests(log, rest)
    refusal: RefusedError | None = None
    for level in rests.plateau:
        intervals = level.intervals
        require_unsaturated(log, intervals, full_scale)
        poses = interval_means(log.accelerometer, intervals)
        white = white_noise(log.accelerometer, intervals, rests.block)
        noise = pose_noise(log, intervals, white, known)
        # so few residuals say too little of the noise; what was measured says it
        few = len(poses) - PARAMETERS <= FEW and noise.source == "file"
        try:
            fit = calibrate(
                poses, g, full_scale=full_scale, residual=residual, **form,
                noise_std=noise.std if few or residual == "adjusted" else None,
            ).require_converged()  # fmt: skip
        except RefusedError as error:
            refusal = error
            continue
        noisy = not np.any(noise.std == 0.0)
        alone = diagnose(fit, poses, None if np.any(white == 0.0) else white)
        initial, std = rests.initial, noise.std if noisy else None
        middle = log.time[intervals.sum(axis=1) // 2]
        forces = fit.sensor().correct(poses)
        result = LogCalibration(
            fit=fit,
            diagnosis=diagnose(fit, poses, std, time=middle),
            white_chi2_per_dof=alone.chi2_per_dof,
            pose_noise=noise,
            rest=initial,
            rest_seconds=float(log.time[initial.stop - 1] - log.time[initial.start]),
            multiplier=level.multiplier,
            intervals=intervals,
            cuts=level.cuts,
            turns=not level.enough,
            predicted=None
            if std is None or predict is None
            else predict(
                fit.sensor(), forces, fit.g, std, fit.residual, form=fit.model
            ),
            next_direction=observability(forces).next_direction,
        )
        return result, alone
    assert refusal is not None  # there is a best one
    raise refusal


def white_noise(
    samples: Float[Array, "n 3"], intervals: Intervals, block: int = 1
) -> Float[Array, " m"]:
    """Standard deviation that white noise leaves in each interval's mean.

    The variance within intervals is pooled over them and over the axes. Rows that come
    faster than the sensor's band are not independent; their means over blocks are.
    """
    counts = interval_counts(intervals) // block
    parts = [
        samples[a : a + n * block].reshape(n, block, 3).mean(axis=1)
        for (a, _), n in zip(intervals, counts, strict=True)
    ]
    squares = [part.var(axis=0).mean() * len(part) for part in parts]
    variance = np.sum(squares) / (np.sum(counts) - len(counts))
    return np.sqrt(variance / counts)
