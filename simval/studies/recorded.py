"""A recorded log: log -> static intervals -> a threshold -> calibration.

The detector's threshold is a multiple of the variance of the initial rest. Each
multiple gives its own intervals. Of those that agree on the number of intervals, the
middle one is taken, so that the choice never sees the residuals: the multiple whose
fit leaves the least of them, as IMU-TK takes it, is the luckiest one, and its error
bars are too small (`docs/decisions/0055-threshold-without-residuals.md`).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from simval.arrays import Array, frozen
from simval.calibrate import FitResult, calibrate
from simval.calibrate.diagnosis import Diagnosis, diagnose
from simval.errors import RefusedError, SaturatedError
from simval.logs import Log
from simval.poses import observability
from simval.statics import (
    Intervals,
    Rest,
    first_samples,
    interval_counts,
    interval_means,
)
from simval.studies.log_health import explained, require_sound
from simval.studies.rests import find_rests, too_few
from simval.theory.calibration import CalibrationMoments, calibration_moments

_RAIL_SHARE = 0.3
MULTIPLIERS = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedCalibration:
    """Calibration of a recorded log, with what it was made from.

    Attributes
    ----------
    fit : FitResult
        The calibration, with Type A error bars.
    diagnosis : Diagnosis
        Residuals, outliers, chi-square and verdict.
    rest : Rest
        The initial rest.
    rest_seconds : float
        Its length, s.
    multiplier : float
        Threshold of the detector over the variance of the rest.
    intervals : Intervals
        Static intervals, samples start <= k < stop, (m, 2).
    poses : Array
        Mean reading of each interval, raw units.
    noise_std : Array
        What white noise leaves in each mean, raw units.
    predicted : CalibrationMoments or None
        Bias, covariance and Cramer-Rao bound if white noise were all there is; None
        where the readings show no noise.
    next_direction : Array
        Direction of a further pose that would help most, sensor axes.
    """

    fit: FitResult
    diagnosis: Diagnosis
    rest: Rest
    rest_seconds: float
    multiplier: float
    intervals: Intervals
    poses: Float[Array, "m 3"]
    noise_std: Float[Array, " m"]
    predicted: CalibrationMoments | None
    next_direction: Float[Array, "3"]

    def __post_init__(self) -> None:
        for name in ("poses", "noise_std", "next_direction"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


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
    multipliers: tuple[float, ...] = MULTIPLIERS,
) -> RecordedCalibration:
    """Calibrate the accelerometer of a recorded log.

    Raises
    ------
    RefusedError
        If there is no rest, no threshold gives nine static intervals, none of the
        fits is a calibration, or the log shows a fault of the sensor or the logger.
    """

    def detect(part: Log, least: int) -> Intervals:
        known = rest if part.time[0] == log.time[0] else None
        found = find_rests(part, known, multipliers, least)[2]
        return _plateau(found)[0][1]

    try:
        result = _calibrated(
            log,
            rest=rest,
            multipliers=multipliers,
            g=g,
            model=model,
            method=method,
            residual=residual,
            loss=loss,
            full_scale=full_scale,
        )
    except RefusedError as refusal:
        raise explained(log, refusal, g, detect) from refusal
    require_sound(log, result.fit, result.intervals, result.diagnosis, detect)
    return result


def _calibrated(
    log: Log,
    *,
    rest: float | None,
    multipliers: tuple[float, ...],
    g: float,
    residual: str,
    full_scale: float | None,
    **choices: Any,
) -> RecordedCalibration:
    samples = log.accelerometer
    even, start, found = find_rests(log, rest, multipliers)
    usable = _plateau(found)
    chosen: tuple[float, FitResult, Intervals] | None = None
    refusal: RefusedError | None = None
    for multiplier, intervals in usable:
        _require_unsaturated(log, intervals, full_scale)
        sigma = white_noise(samples, intervals, even.block)
        try:
            fit = calibrate(
                interval_means(samples, intervals),
                g,
                noise_std=sigma if residual == "adjusted" else None,
                residual=residual,
                full_scale=full_scale,
                **choices,
            ).require_converged()
        except RefusedError as error:
            refusal = error
            continue
        chosen = (multiplier, fit, intervals)
        break
    if chosen is None:
        raise refusal or too_few(0)
    multiplier, fit, intervals = chosen
    means = interval_means(samples, intervals)
    sigma = white_noise(samples, intervals, even.block)
    quiet = bool(np.any(sigma == 0.0))
    return RecordedCalibration(
        fit=fit,
        diagnosis=diagnose(fit, means, None if quiet else sigma),
        rest=start,
        rest_seconds=float(log.time[start.stop - 1] - log.time[start.start]),
        multiplier=multiplier,
        intervals=intervals,
        poses=means,
        noise_std=sigma,
        predicted=None if quiet else _predicted(fit, means, sigma),
        next_direction=observability(fit.sensor().correct(means)).next_direction,
    )


def calibrate_samples(
    log: Log, intervals: Intervals, count: int, g: float
) -> FitResult:
    """Fit single samples instead of means, as the IMU-TK program does.

    Its error bars take the samples of an interval as independent, which they are
    not where the poses are the limit; for comparison only.
    """
    samples = first_samples(log.accelerometer, intervals, count).reshape(-1, 3)
    return calibrate(samples, g, residual="norm", repeats=True)


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


def _predicted(
    fit: FitResult, means: Float[Array, "m 3"], sigma: Float[Array, " m"]
) -> CalibrationMoments:
    sensor = fit.sensor()
    return calibration_moments(
        sensor,
        sensor.correct(means),
        g=fit.g,
        noise_std=sigma,
        residual=fit.residual,
        form=fit.model,
    )


def _require_unsaturated(log: Log, intervals: Intervals, limit: float | None) -> None:
    # a rest with many samples at exactly the log's extreme is at a rail, if readings
    # elsewhere are noisy enough not to repeat by themselves
    samples = log.accelerometer
    for sign in (1.0, -1.0):
        top = (sign * samples).max(axis=0)
        parts = [sign * samples[start:stop] for start, stop in intervals]
        own = np.array([(part == part.max(axis=0)).mean(axis=0) for part in parts])
        at_rail = np.array([(part == top).mean(axis=0) for part in parts])
        stuck = (at_rail >= _RAIL_SHARE) & (np.median(own, axis=0) < _RAIL_SHARE / 3)
        if limit is not None:
            stuck |= np.array([(part >= limit).any(axis=0) for part in parts])
        if stuck.any():
            pose, axis = (int(k) for k in np.argwhere(stuck)[0])
            start, stop = intervals[pose]
            msg = (
                f"{log.path}: axis {'xyz'[axis]} is saturated at {sign * top[axis]:g} "
                f"in the rest from {log.time[start]:.2f} s to "
                f"{log.time[stop - 1]:.2f} s; a reading at the rail says nothing about "
                "the force: cut that rest out, or record with a wider range"
            )
            raise SaturatedError(msg)


def _plateau(found: list[tuple[float, Intervals]]) -> list[tuple[float, Intervals]]:
    # thresholds that agree on the number of rests: one seen at a single threshold
    # only is a rest cut in two, or a slow motion; the middle one first
    counts = [len(intervals) for _, intervals in found]
    agreed = max(counts, key=lambda count: (counts.count(count), count))
    level = [entry for entry in found if len(entry[1]) == agreed]
    middle = (len(level) - 1) / 2
    order = sorted(range(len(level)), key=lambda k: abs(k - middle))
    return [level[k] for k in order]
