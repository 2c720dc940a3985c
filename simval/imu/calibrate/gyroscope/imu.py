r"""Accelerometer and gyroscope of one recording, calibrated together.

**Which model of the bias, and whether forces act on the gyroscope: by evidence.**

**Bias.** With the rests' white noise :math:`N^2/T_i` and a walk K of the bias, a
constant leaves the angle of a rotation of T seconds the variance
:math:`T^2 (N^2/\sum T_i + K^2 v)`, v that between the bias in it and its mean over
the rests; a line between the neighbouring rests
:math:`T^2 N^2 / 2 T_r + K^2 T^3/12`. The lesser is chosen, and the line only where it
tells a rest that was left out better than the others' mean does.

**Sensitivity to force.** The rests' mean readings are regressed on 1 and on (1, f); the
drop in the sum of squares is judged by the F test. Rests tell it apart from M, which
they do not show at all.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import scipy

from simval.arguments import choice, switch
from simval.arrays import Array, ReadOnly, noise_levels, physical_array
from simval.errors import InputError
from simval.imu.calibrate.accelerometer import calibrate
from simval.imu.calibrate.gyroscope.calibration import calibrate_gyroscope
from simval.imu.calibrate.gyroscope.noise import (
    checked_pose_std,
    walk_covariance,
)
from simval.imu.calibrate.gyroscope.path_statistics import (
    InterRestRotations,
    inter_rest_rotations,
)
from simval.imu.calibrate.gyroscope.result import NAMES, GyroscopeFit
from simval.imu.calibrate.result import FitResult
from simval.imu.sensor import forms
from simval.shapes import Float

CHANCE: Final = 0.01
"""Of keeping a sensitivity where there is none. Chosen: nine entries are given out
then, each with its error bar."""
_SHARES: Final = 31  # of the walk in the scatter that are tried, a factor 1.6 apart
_COPLANAR: Final = 1e-3  # least singular value of (1, f/g) over the greatest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rests:
    """Bias and noise of a gyroscope from its rests."""

    rates: Float[Array, "n 3"]  # mean readings, raw units
    times: Float[Array, " n"]  # s
    seconds: Float[Array, " n"]
    rotation_seconds: Float[Array, " k"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivity(ReadOnly):
    """Sensitivity to force as the rests show it."""

    kept: bool
    G: Float[Array, "3 3"]  # raw units per m/s^2; zero where not kept
    sd: Float[Array, "3 3"]  # of its entries, as wide as the rests scatter
    # of B and of the rows of G of an axis, over the variance N^2 of that axis
    shape: Float[Array, "4 4"]
    reason: str


def choose_bias(
    rests: Rests, walk: Float[Array, "3"], drift: float | None
) -> tuple[str, float, str]:
    """Model of the bias, the walk K it was chosen with, and the reason."""
    N2 = float((walk**2).mean())
    K = walk_of(rests, np.ones((len(rests.times), 1)))[1] if drift is None else drift
    w = rests.seconds / rests.seconds.sum()
    middle = 0.5 * (rests.times[1:] + rests.times[:-1])
    away = np.diagonal(walk_covariance(middle, w, rests.times))
    T2 = rests.rotation_seconds**2
    constant = float(np.mean(T2 * (N2 / rests.seconds.sum() + K * K * away)))
    pairs = 0.25 * (1.0 / rests.seconds[1:] + 1.0 / rests.seconds[:-1])
    line = float(np.mean(T2 * N2 * pairs + K * K * rests.rotation_seconds**3 / 12.0))
    told_c, told_l = _left_out(rests)
    chosen = "line" if line < constant and told_l < told_c else "constant"
    said = (
        f"bias: {chosen}; N {np.sqrt(N2):.3g} and K {K:.3g} raw units "
        f"({'measured between rests' if drift is None else 'given'}) leave a "
        f"rotation {np.sqrt(constant):.2g} raw units s with a constant and "
        f"{np.sqrt(line):.2g} with lines between rests; a rest that is left out is "
        f"told within {told_c:.3g} raw units by the mean of the others and "
        f"{told_l:.3g} by lines"
    )
    return chosen, K, said


def walk_of(rests: Rests, X: Float[Array, "n p"]) -> tuple[float, float]:
    """White scatter and walk of the rests, raw units per root hertz and times it.

    Most likely for what is left of the rests' means without X (restricted likelihood):
    a scatter that does not grow with the time between rests is no walk.
    """
    n, p = X.shape
    if n - p < 2:
        return 0.0, 0.0
    Z = np.linalg.qr(X, mode="complete")[0][:, p:]
    y = Z.T @ rests.rates
    times = rests.times - rests.times[0]
    white = Z.T @ np.diag(1.0 / rests.seconds) @ Z
    walk = Z.T @ np.minimum(times[:, None], times) @ Z
    unit = float(np.trace(white) / np.trace(walk))
    best = (-np.inf, 0.0, 0.0)
    for share in (0.0, *np.geomspace(1e-3, 1e3, _SHARES)):
        L = np.linalg.cholesky(white + share * unit * walk)
        square = float((np.linalg.solve(L, y) ** 2).mean())
        if not square > 0.0:
            return 0.0, 0.0
        likely = -0.5 * y.size * np.log(square) - 3.0 * np.log(L.diagonal()).sum()
        best = max(best, (float(likely), square, share * unit * square))
    return float(np.sqrt(best[1])), float(np.sqrt(best[2]))


def _left_out(rests: Rests) -> tuple[float, float]:
    # root mean square of how wrong a rest is told: by the mean of the others, by a line
    y, t, w = rests.rates, rests.times, rests.seconds
    if len(y) < 3:
        return 0.0, float(np.inf)
    total, weight = (w[:, None] * y).sum(axis=0), w.sum()
    others = (total - w[:, None] * y) / (weight - w)[:, None]
    along = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None]
    lines = (1.0 - along) * y[:-2] + along * y[2:]
    off = (y - others)[1:-1], y[1:-1] - lines
    constant, line = (float(np.sqrt((each**2).mean())) for each in off)
    return constant, line


def choose_sensitivity(
    rests: Rests,
    force: Float[Array, "n 3"],
    walk: Float[Array, "3"],
    drift: float | None = None,
    *,
    asked: bool | None = None,
) -> Sensitivity:
    """Choose to fit a g-sensitivity by the F test, or as the caller asked.

    Poses in a regular order and a bias that walks both change slowly: the rests are
    whitened by N and K first, or three of four walks would pass for a sensitivity.
    """
    n = len(force)
    g = float(np.linalg.norm(force, axis=1).mean())
    X = np.column_stack([np.ones(n), force / g])
    values = np.linalg.svd(X, compute_uv=False)
    if asked is False:
        return _none("as asked")
    if n < 6 or values[-1] < _COPLANAR * values[0]:
        why = f"{n} rests" if n < 6 else "rests whose directions lie in a plane"
        return _none(f"{why} do not tell it")
    white, K2 = _whitening(rests, X, walk, drift)
    Xw, y = white @ X, white @ rests.rates
    found, *_ = np.linalg.lstsq(Xw, y, rcond=None)
    alone, *_ = np.linalg.lstsq(Xw[:, :1], y, rcond=None)
    without = float(((y - Xw[:, :1] @ alone) ** 2).sum())
    each = ((y - Xw @ found) ** 2).sum(axis=0)
    left = float(each.sum())
    dof = 3 * n - 12
    least = np.finfo(float).eps ** 2 * float((y * y).sum())
    F = (without - left) / 9.0 / (max(left, least) / dof) if without > least else 0.0
    chance = float(scipy.special.fdtrc(9, dof, F))
    kept = chance < CHANCE if asked is None else asked
    reason = (
        f"F = {F:.3g} with 9 and {dof} degrees of freedom, as great by chance in "
        f"{chance:.2g} of logs ({CHANCE:g} allowed); rests whitened for K of "
        f"{K2**0.5:.2g} raw units"
    )
    if not kept:
        return _none(reason)
    scale = np.diag([1.0, 1.0 / g, 1.0 / g, 1.0 / g])
    shape = scale @ np.linalg.inv(Xw.T @ Xw) @ scale
    seen = float(np.sum(each / np.maximum(walk**2, np.finfo(float).tiny))) / dof
    N = (
        walk * np.sqrt(max(1.0, seen))
        if np.all(walk > 0.0)
        else np.sqrt(each / (n - 4))
    )
    return Sensitivity(
        kept=True,
        G=found[1:].T / g,
        sd=np.multiply.outer(N, np.sqrt(np.diagonal(shape)[1:])),
        shape=shape,
        reason=f"sensitivity to force: kept; {reason}",
    )


def _whitening(
    rests: Rests, X: Float[Array, "n 4"], walk: Float[Array, "3"], drift: float | None
) -> tuple[Float[Array, "n n"], float]:
    # inverse root of the rests' covariance over N^2, and K^2; what forces would explain
    # is no drift
    N2 = max(float((walk**2).mean()), np.finfo(float).tiny)
    if drift is None:
        scatter, drift = walk_of(rests, X)
        N2 = max(N2, scatter**2)
    times = rests.times - rests.times[0]
    walked = np.minimum(times[:, None], times)
    S = np.diag(1.0 / rests.seconds) + drift**2 / N2 * walked
    return np.linalg.inv(np.linalg.cholesky(S)), drift**2


def _none(reason: str) -> Sensitivity:
    return Sensitivity(
        kept=False,
        G=np.zeros((3, 3)),
        sd=np.zeros((3, 3)),
        shape=np.zeros((4, 4)),
        reason=f"sensitivity to force: none; {reason}",
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuReadings:
    """Reduced readings of a recording, and the noise assumed for them."""

    inter_rest: InterRestRotations
    poses: Float[Array, "n 3"]  # mean accelerometer readings
    pose_std: Float[Array, "n 3"]
    angle_random_walk: Float[Array, "3"]
    bias_random_walk: float
    known_bias: Any  # raw units, (3,), where the model of the bias is a line; else None
    bias_std: float  # of the rests' mean, by how they scatter

    @property
    def moves(self) -> InterRestRotations:
        """Former name of `inter_rest`."""
        return self.inter_rest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuFit(ReadOnly):
    """Accelerometer and gyroscope of one recording.

    Attributes
    ----------
    accelerometer : FitResult
        Nine parameters with their covariance.
    gyroscope : GyroscopeFit
        Twelve parameters; its covariance holds all 21.
    reasons : tuple of str
        What was chosen (model of the bias, sensitivity to force), and why.
    G : Array
        Sensitivity to specific force that was taken out, raw units per m/s^2, (3, 3);
        zero where there is none.
    G_sd : Array
        Standard deviation of each entry of it, (3, 3).
    reduced : ImuReadings
        What was fitted: rotations between rests, poses and their noise.
    """

    accelerometer: FitResult
    gyroscope: GyroscopeFit
    reasons: tuple[str, ...]
    G: Float[Array, "3 3"]
    G_sd: Float[Array, "3 3"]
    reduced: ImuReadings

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the 21 parameters, the accelerometer's first."""
        return (*self.accelerometer.names, *NAMES)

    @property
    def covariance(self) -> Float[Array, "21 21"]:
        """Covariance of the 21 parameters."""
        return self.gyroscope.covariance

    def as_object(self) -> dict[str, Any]:
        """Both as plain JSON values.

        Returns
        -------
        dict
            The accelerometer's parameters and error bars, the gyroscope's object, what
            was taken out, and the reasons.
        """
        force = self.accelerometer
        return {
            "accelerometer": {
                "model": force.model,
                "names": list(force.names),
                "parameters": force.parameters.tolist(),
                "sd": force.sd.tolist(),
            },
            "gyroscope": self.gyroscope.as_object(),
            "G": self.G.tolist(),
            "G_sd": self.G_sd.tolist(),
            "reasons": list(self.reasons),
        }


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
        As in `calibrate_gyroscope`; from the rests if not given.
    bias_random_walk : float, optional
        K of the gyroscope, raw units times root hertz; from the differences between
        rests if not given.
    clock_jitter : float, default 0.0
        As in `calibrate_gyroscope`.
    bias : {"auto", "constant", "line"}
        Model of the bias; auto chooses by evidence.
    sensitivity : bool, optional
        Whether specific force acts on the gyroscope; by the F test if not given.
    estimator : {"joint", "generalised", "unweighted"}
        As in `calibrate_gyroscope`.
    scheme, margin, chunk, full_scale : optional
        As in `inter_rest_rotations`.
    start : optional
        As in `calibrate_gyroscope`.

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
        If the rests or the rotations do not tell the parameters, rows are missing, the
        range ends, or a sensor's residuals are far beyond its noise.
    """
    bias = choice("bias", bias, _CHOICES)
    asked = None if sensitivity is None else switch("sensitivity", sensitivity)
    rows = physical_array("accelerometer", accelerometer, (None, 3))
    how: dict[str, Any] = {
        "scheme": scheme, "margin": margin, "chunk": chunk, "full_scale": full_scale,
    }  # fmt: skip
    inter_rest = inter_rest_rotations(time, gyroscope, intervals, **how)
    if rows.ndim != 2 or len(rows) != len(np.asarray(time)):
        msg = (
            f"`accelerometer` has shape {rows.shape} for {len(np.asarray(time))} rows "
            "of time; give a reading of each, (n, 3)"
        )
        raise InputError(msg)
    at = np.asarray(intervals, dtype=np.intp)
    poses = np.array([rows[a:b].mean(axis=0) for a, b in at])
    # what white noise leaves in the mean of each rest
    white = np.sqrt(variance_within(rows, at) / np.diff(at))
    std = white if pose_std is None else checked_pose_std(pose_std, len(at))
    level = np.sqrt((std**2).mean(axis=1))
    stated = level if np.all(level > 0.0) else None
    acc = calibrate(poses, g, model, residual="weighted", noise_std=stated)
    acc.require_converged()
    walk = inter_rest.white[0] if angle_random_walk is None else angle_random_walk
    walk = noise_levels("angle_random_walk", walk, 3, "axes")
    rests = Rests(
        rates=inter_rest.rest_rates[0], times=inter_rest.rest_times,
        seconds=inter_rest.rest_seconds, rotation_seconds=inter_rest.seconds,
    )  # fmt: skip
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
        inter_rest = inter_rest_rotations(time, gyroscope, intervals, **how, **more)
    reduced = ImuReadings(
        inter_rest=inter_rest, poses=poses, pose_std=std, angle_random_walk=walk,
        bias_random_walk=drift, known_bias=known,
        bias_std=scatter / np.sqrt(inter_rest.rest_seconds.sum()),
    )  # fmt: skip
    fit = calibrate_gyroscope(
        inter_rest, poses, acc, pose_std=std, angle_random_walk=walk,
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
