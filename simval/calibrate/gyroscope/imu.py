"""Accelerometer and gyroscope of one recording, calibrated together."""

from dataclasses import replace
from typing import Any

import numpy as np

from simval.arguments import choice, switch
from simval.arrays import Array, physical_array
from simval.calibrate.fit import calibrate
from simval.calibrate.gyroscope.calibration import calibrate_gyroscope
from simval.calibrate.gyroscope.choice import (
    Rests,
    Sensitivity,
    choose_bias,
    choose_sensitivity,
    walk_of,
)
from simval.calibrate.gyroscope.moves import Moves, moves_between
from simval.calibrate.gyroscope.noise import checked_pose_std, checked_walk
from simval.calibrate.gyroscope.pair import ImuFit, ImuReadings
from simval.calibrate.result import FitResult
from simval.errors import InputError
from simval.sensor import forms
from simval.shapes import Float

_CHOICES = ("auto", "constant", "line")


def calibrate_imu(
    time: Any,
    accelerometer: Any,
    gyroscope: Any,
    intervals: Any,
    *,
    g: float = 9.80665,
    model: str = "triangular",
    pose_std: Any = None,
    angle_random_walk: Any = None,
    bias_random_walk: float | None = None,
    clock_jitter: float = 0.0,
    bias: str = "auto",
    sensitivity: bool | None = None,
    estimator: str = "joint",
    scheme: str = "averages",
    margin: int = 10,
    chunk: int = 1,
    full_scale: float | None = None,
    start: Any = None,
) -> ImuFit:
    """Calibrate both sensors from their rows and the rests among them.

    Parameters
    ----------
    time : array_like
        Time of each row, s, (n,).
    accelerometer : array_like
        Raw readings, (n, 3).
    gyroscope : array_like
        Raw readings, (n, 3).
    intervals : array_like
        Rows of each rest, start <= row < stop, in order, (m, 2).
    g : float, default 9.80665
        Local gravity, m/s^2.
    model : {"triangular", "upper", "symmetric"}
        Form of the accelerometer, which fixes the axes of both.
    pose_std : float or array_like, optional
        Noise of each axis of a pose mean, raw units, one number, (m,) or (m, 3); white
        noise from the scatter within rests if not given.
    angle_random_walk : float or array_like, optional
        White noise N of the gyroscope, raw units per root hertz, one number or (3,);
        from the scatter within rests if not given.
    bias_random_walk : float, optional
        K of the gyroscope, raw units times root hertz; from the differences between
        rests if not given.
    clock_jitter : float, default 0.0
        Standard deviation of each time stamp, s, where the rows are even and their
        stamps are not.
    bias : {"auto", "constant", "line"}
        Model of the bias; auto chooses by evidence.
    sensitivity : bool, optional
        Whether specific force acts on the gyroscope; by the F test if not given.
    estimator : {"joint", "generalised", "unweighted"}
        As in `calibrate_gyroscope`.
    scheme : {"averages", "cubic", "linear"}
        What a row is, and how it is integrated.
    margin : int, default 10
        Rows by which a move reaches into the rests beside it.
    chunk : {1, 2, 4, 8}
        Steps that are merged into one.
    full_scale : float, optional
        Greatest reading of the gyroscope, raw units from the middle of its range; a
        move that reaches it is refused.
    start : array_like, optional
        M to start from, (3, 3).

    Returns
    -------
    ImuFit
        Both calibrations with the covariance of all 21 parameters, and the reasons of
        what was chosen.

    Raises
    ------
    InputError
        If an argument is not usable.
    RefusedError
        If the rests or the moves do not tell the parameters, rows are missing, the
        range ends, or a sensor's residuals are far beyond its noise.
    """
    bias = choice("bias", bias, _CHOICES)
    asked = None if sensitivity is None else switch("sensitivity", sensitivity)
    rows = physical_array("accelerometer", accelerometer, (None, 3))
    how: dict[str, Any] = {
        "scheme": scheme, "margin": margin, "chunk": chunk, "full_scale": full_scale,
    }  # fmt: skip
    moves = moves_between(time, gyroscope, intervals, **how)
    if rows.ndim != 2 or len(rows) != len(np.asarray(time)):
        msg = (
            f"`accelerometer` has shape {rows.shape} for {len(np.asarray(time))} rows "
            "of time; give a reading of each, (n, 3)"
        )
        raise InputError(msg)
    at = np.asarray(intervals, dtype=np.intp)
    poses = np.array([rows[a:b].mean(axis=0) for a, b in at])
    std = _white(rows, at) if pose_std is None else checked_pose_std(pose_std, len(at))
    acc = _accelerometer(poses, std, g, model)
    walk = checked_walk(
        moves.white[0] if angle_random_walk is None else angle_random_walk
    )
    rests = _rests(moves)
    found = choose_sensitivity(
        rests, acc.sensor().correct(poses), walk, bias_random_walk, asked=asked
    )
    rests = replace(rests, rates=rests.rates - acc.sensor().correct(poses) @ found.G.T)
    chosen, drift, said = choose_bias(rests, walk, bias_random_walk)
    if bias != "auto" and bias != chosen:
        chosen, said = bias, f"bias: {bias}, as asked; by evidence {said}"
    scatter, _ = walk_of(rests, np.ones((len(at), 1)))
    more, known = _taken_out(time, acc, rows, found, rests, chosen)
    if more:
        moves = moves_between(time, gyroscope, intervals, **how, **more)
    reduced = ImuReadings(
        moves=moves, poses=poses, pose_std=std, angle_random_walk=walk,
        bias_random_walk=drift, known_bias=known,
        bias_std=scatter / np.sqrt(moves.rest_seconds.sum()),
    )  # fmt: skip
    fit = calibrate_gyroscope(
        moves, poses, acc, pose_std=std, angle_random_walk=walk,
        bias_random_walk=drift, clock_jitter=clock_jitter, estimator=estimator,
        bias=chosen, known_bias=known, start=start, bias_std=reduced.bias_std,
    )  # fmt: skip
    if fit.estimator == "joint":
        acc = joined(acc, fit.accelerometer, fit.covariance[:9, :9], poses)
    return ImuFit(
        accelerometer=acc,
        gyroscope=fit,
        reasons=(said, found.reason),
        G=found.G,
        G_sd=found.sd,
        reduced=reduced,
    )


def variance_within(rows: Float[Array, "n 3"], rests: Any) -> Float[Array, "3"]:
    """Variance of single readings about the mean of their rest, by axis."""
    counts = np.diff(rests)[:, 0]
    squares = sum(rows[a:b].var(axis=0) * (b - a) for a, b in rests)
    return np.asarray(squares / (counts.sum() - len(counts)))


def _white(rows: Float[Array, "n 3"], rests: Any) -> Float[Array, "m 3"]:
    # what white noise leaves in the mean of each rest, by axis
    return np.sqrt(variance_within(rows, rests) / np.diff(rests))


def _accelerometer(
    poses: Array, std: Float[Array, "m 3"], g: float, model: str
) -> FitResult:
    level = np.sqrt((std**2).mean(axis=1))
    known = None if not np.all(level > 0.0) else level
    fit = calibrate(poses, g, model, residual="weighted", noise_std=known)
    return fit.require_converged()


def _rests(moves: Moves) -> Rests:
    return Rests(
        rates=moves.rest_rates[0],
        times=moves.rest_times,
        seconds=moves.rest_seconds,
        moves=moves.seconds,
    )


def _taken_out(
    time: Any,
    acc: FitResult,
    rows: Float[Array, "n 3"],
    found: Sensitivity,
    rests: Rests,
    bias: str,
) -> tuple[dict[str, Any], Any]:
    # what the rows lose before they are integrated, and the bias that is then left
    more: dict[str, Any] = {}
    known = None
    if found.kept:
        force = acc.sensor().correct(rows)
        more = {"force": force, "force_noise": found.shape, "offset": force @ found.G.T}
    if bias == "line":
        known = np.average(rests.rates, axis=0, weights=rests.seconds)
        clock = np.asarray(time, dtype=float)
        line = [np.interp(clock, rests.times, y) for y in (rests.rates - known).T]
        more["offset"] = more.get("offset", 0.0) + np.stack(line, axis=1)
    return more, known


def joined(
    acc: FitResult,
    parameters: Float[Array, "9"],
    covariance: Float[Array, "9 9"],
    poses: Float[Array, "n 3"],
) -> FitResult:
    """The accelerometer as a fit with other sensors leaves it."""
    M = forms.matrix(acc.model, parameters)
    length = np.linalg.norm((poses - parameters[6:]) @ M.T, axis=1)
    return replace(
        acc,
        parameters=parameters,
        covariance=covariance,
        covariance_kind="known sigma",
        rms=np.sqrt(((length - acc.g) ** 2).mean()),
    )
