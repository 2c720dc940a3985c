r"""Accelerometer and gyroscope of one recording, calibrated together.

The model of the bias, what it owes to the temperature and whether forces act on the
gyroscope are chosen by evidence (`simval.imu.calibrate.gyroscope.at_rest`).
"""

from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy

from simval.arguments import choice, switch
from simval.arrays import Array, ReadOnly, noise_levels, physical_array
from simval.errors import InputError
from simval.geometry import normalize
from simval.imu.calibrate.accelerometer import calibrate
from simval.imu.calibrate.goodness_of_fit import FALSE_ALARM, Drop
from simval.imu.calibrate.gyroscope.at_rest import (
    MOVES,
    BiasTerms,
    Sensitivity,
    bias_terms,
    choose_bias,
    choose_sensitivity,
    rest_motion,
    walk_of,
)
from simval.imu.calibrate.gyroscope.calibration import (
    approach,
    calibrate_gyroscope,
    first_matrix,
)
from simval.imu.calibrate.gyroscope.noise import (
    Bias,
    Weighting,
    checked_pose_std,
)
from simval.imu.calibrate.gyroscope.path_statistics import (
    InterRestRotations,
    Scheme,
    inter_rest_rotations,
)
from simval.imu.calibrate.gyroscope.residuals import across
from simval.imu.calibrate.gyroscope.rest_effects import Rests
from simval.imu.calibrate.gyroscope.result import NAMES, GyroscopeFit
from simval.imu.calibrate.gyroscope.rotation import rotations
from simval.imu.calibrate.rest_temperatures import LEAST_LEFT
from simval.imu.calibrate.result import FitResult
from simval.imu.calibrate.thermal import TERMS, Thermal
from simval.imu.sensor import forms
from simval.shapes import Float
from simval.text import chance_words
from simval.vocabulary import Model


class ReducedReadings(NamedTuple):
    """Reduced readings of a recording, and the noise assumed for them."""

    inter_rest: InterRestRotations
    poses: Float[Array, "n 3"]  # mean accelerometer readings
    pose_std: Float[Array, "n 3"]
    angle_random_walk: Float[Array, "3"]
    bias_random_walk: float
    known_bias: Any  # raw units, (3,), where the model of the bias is a line; else None
    bias_std: float  # of the rests' mean, by how they scatter


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
    reduced : ReducedReadings
        What was fitted: rotations between rests, poses and their noise.
    thermal : Thermal or None
        What the gyroscope's bias owes to its temperature, which was taken out.
    """

    accelerometer: FitResult
    gyroscope: GyroscopeFit
    reasons: tuple[str, ...]
    G: Float[Array, "3 3"]
    G_sd: Float[Array, "3 3"]
    reduced: ReducedReadings
    thermal: Thermal | None = None

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
    model: Model = "triangular",
    pose_std: Any = None,
    angle_random_walk: Any = None,
    bias_random_walk: float | None = None,
    clock_jitter: float = 0.0,
    bias: Bias | Literal["auto"] = "auto",
    sensitivity: bool | None = None,
    estimator: Weighting = "joint",
    scheme: Scheme = "averages",
    margin: int = 10,
    chunk: int = 1,
    full_scale: float | None = None,
    means: bool | None = None,
    start: Any = None,
    temperature: Any = None,
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
        Whether specific force acts on the gyroscope; by its odds if not
        given.
    estimator : {"joint", "generalised", "unweighted"}
        As in `calibrate_gyroscope`.
    scheme, margin, chunk, full_scale : optional
        As in `inter_rest_rotations`.
    means : bool, optional
        Whether rotations go between the mean attitudes of the rests, as in
        `inter_rest_rotations`; by the angles within the rests if not given.
    start : optional
        As in `calibrate_gyroscope`.
    temperature : array_like, optional
        Of the sensor at each row, degrees Celsius, (n,): the gyroscope's bias and
        scale may depend on it, by odds and an F test.

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
        before=inter_rest.before, after=inter_rest.before + 1,
    )  # fmt: skip
    forces = acc.sensor().correct(poses)
    warm = bias_terms(temperature, time, at, rests, forces, walk, bias_random_walk)
    found = choose_sensitivity(
        rests, forces, walk, bias_random_walk, asked=asked, powers=warm.at_rest
    )
    rates = rests.rates - forces @ found.G.T - warm.at_rest @ warm.coefficients
    rests = rests._replace(rates=rates)
    chosen, drift, said = choose_bias(rests, walk, bias_random_walk)
    chance, within = rest_motion(time, gyroscope, at, rests, walk, drift)
    moves = chance < MOVES if means is None else switch("means", means)
    if bias != "auto" and bias != chosen:
        chosen, said = bias, f"bias: {bias}, as asked; by evidence {said}"
    elif bias != chosen == "line" and moves and within < MOVES:
        # what a hand turns is no bias
        chosen, said = (
            "constant",
            f"bias: constant, rests move; were they still, {said}",
        )
    scatter, _ = walk_of(rests, np.ones((len(at), 1)))
    how["means"] = moves
    moved = moves and (
        "rotations go from the mean attitude of a rest to that of the next: in rests "
        f"that are still the gyroscope reads as here in {chance_words(chance, 2)} of "
        f"logs ({MOVES:g} allowed)"
    )
    force = acc.sensor().correct(rows) if found.kept else None
    more, known = _taken_out(time, warm, force, found, rests, chosen)
    gain = scale_terms(
        time, gyroscope, at, forces, warm, how, more.get("offset", 0.0), walk
    )
    if more or moves or gain.thermal is not None:
        rates_of = gyroscope if gain.thermal is None else gain.rows
        inter_rest = inter_rest_rotations(time, rates_of, intervals, **how, **more)
    reduced = ReducedReadings(
        inter_rest=inter_rest, poses=poses, pose_std=std, angle_random_walk=walk,
        bias_random_walk=drift, known_bias=known,
        bias_std=scatter / np.sqrt(inter_rest.rest_seconds.sum()),
    )  # fmt: skip
    fit = calibrate_gyroscope(
        inter_rest, poses, acc, pose_std=std, angle_random_walk=walk,
        bias_random_walk=drift, clock_jitter=clock_jitter, estimator=estimator,
        bias=chosen, known_bias=known, start=start, bias_std=reduced.bias_std,
    )  # fmt: skip
    if gain.thermal is not None:
        P = np.array(fit.covariance)
        P[9:18, 9:18] += gain.covariance
        fit = replace(fit, covariance=P)
    if fit.estimator == "joint":
        acc = joined(acc, fit.accelerometer, fit.covariance[:9, :9], poses)
    return ImuFit(
        accelerometer=acc,
        gyroscope=fit,
        reasons=(
            said,
            found.reason,
            *(x for x in (inter_rest.left_out, moved, warm.reason, gain.reason) if x),
        ),
        thermal=gain.thermal or warm.thermal,
        G=found.G,
        G_sd=found.sd,
        reduced=reduced,
    )


def variance_within(rows: Float[Array, "n 3"], rests: Any) -> Float[Array, "3"]:
    """Variance of single readings about the mean of their rest, by axis."""
    counts = np.diff(rests)[:, 0]
    squares = sum(rows[a:b].var(axis=0) * (b - a) for a, b in rests)
    return np.asarray(squares / (counts.sum() - len(counts)))


class Gain(NamedTuple):
    """What the scale of a gyroscope owes to temperature."""

    thermal: Thermal | None = None  # terms of its bias among them
    reason: str = ""
    rows: Any = None  # with the scale at the reference
    covariance: Any = None  # of M by that of the terms, (9, 9)


_QUIET = 1e-2  # least noise of an axis over that of the noisiest
_STEP = 1e-3  # of a scale, 1/K: what it does is nearly linear in it


def scale_terms(
    time: Any, gyroscope: Any, rests: Any, forces: Float[Array, "n 3"],
    warm: BiasTerms, how: dict[str, Any], offset: Any, walk: Float[Array, "3"],
) -> Gain:  # fmt: skip
    """Choose a scale linear in temperature by the rotations, where they tell it.

    By their residuals, weighed by the white noise of each axis, with M fitted anew for
    a small scale of each axis by turns, and the F test of `goodness_of_fit.Drop`.
    """
    left, seen = 2 * (len(forces) - 1) - 12, warm.seen
    if seen is None or seen.span < seen.least_span or left < LEAST_LEFT:
        return Gain()
    tau = np.asarray(warm.temperature)[:, None] - seen.reference
    away = physical_array("gyroscope", gyroscope, (None, 3)) - offset
    centre = np.mean([away[a:b].mean(axis=0) for a, b in rests], axis=0)
    away = away - centre
    u = np.broadcast_to(normalize(forces), (4, *forces.shape))
    tried, kappa = np.pad(_STEP * np.eye(3), ((1, 0), (0, 0))), np.zeros(3)
    M, square = np.full((4, 3, 3), np.nan), list[float]()
    for _ in range(2):  # the second time about the first answer
        rates = centre + (1.0 + (kappa + tried)[:, None] * tau) * away
        turned = inter_rest_rotations(time, rates, rests, **how)
        if not square:
            left = 2 * len(turned.before) - 12
            M[:] = first_matrix(turned.statistics[0], u[0], turned.before)
        if not (np.isfinite(M).all() and left >= LEAST_LEFT):
            return Gain()
        M, J, e = approach(turned, np.zeros((4, 3)), u, M)
        white = _whitening(turned, M[:1], u[:1], walk)
        J, e = white @ J, np.matvec(white, e)
        q = np.linalg.qr(J[..., :9])[0]
        r = e - np.matvec(q, np.vecmat(e, q))
        square.append(float(r[0] @ r[0]))
        D = (r[1:] - r[0]).T / _STEP
        inverse = np.linalg.pinv(D)
        rest = r[0] - D @ (inverse @ r[0])
        kappa = kappa - inverse @ r[0]
    scatter = float(rest @ rest)
    chance = Drop(rest=scatter, dof=left, known=None).chance(square[0], 3)
    if not (chance < FALSE_ALARM and np.linalg.matrix_rank(D) == 3):
        return Gain()
    covariance = scatter / left * inverse @ inverse.T
    by = (M[1:] - M[0]).reshape(3, 9) / _STEP
    said = (
        "scale of the gyroscope in temperature: line; without an effect its chance is "
        f"{chance_words(chance, 2)} ({FALSE_ALARM:g} allowed)"
    )
    return Gain(
        _with_scale(warm, kappa, covariance, centre, left), said,
        centre + (1.0 + kappa * tau) * away + offset, by.T @ covariance @ by,
    )  # fmt: skip


def _whitening(
    turned: InterRestRotations, M: Float[Array, "1 3 3"], u: Float[Array, "1 n 3"],
    walk: Float[Array, "3"],
) -> Float[Array, "r r"]:  # fmt: skip
    # inverse root of the covariance (N6) of residuals by the noise of each axis, up to
    # a factor
    moved = rotations(turned.statistics[:1], M, np.zeros((1, 3)))
    EC = across(u[:, turned.before + 1]) @ np.swapaxes(moved.C, -1, -2)
    N = np.maximum(walk / max(walk.max(), np.finfo(float).tiny), _QUIET)
    by = np.cross(EC, u[:, turned.before, None, :])[0, :, None] @ np.moveaxis(
        moved.by_rate(N)[0], 2, 1
    )
    root = by * np.sqrt(turned.statistics[0, :, 9])[..., None, None]
    V = np.einsum("kjab,kjcb->kac", root, root)
    return scipy.linalg.block_diag(*np.linalg.inv(np.linalg.cholesky(V)))


def _with_scale(
    warm: BiasTerms, kappa: Float[Array, "3"], own: Float[Array, "3 3"],
    centre: Float[Array, "3"], dof: int,
) -> Thermal:  # fmt: skip
    # the terms of bias and scale, whose errors are independent: of rests and rotations
    bias, seen = warm.thermal, warm.seen
    assert seen is not None
    some = (("scale", 1), *(() if bias is None else bias.terms))
    terms = tuple(term for term in TERMS if term in some)
    scale = np.repeat([what == "scale" for what, _ in terms], 3)
    values, covariance = np.zeros(scale.size), np.zeros((scale.size, scale.size))
    values[scale], covariance[np.ix_(scale, scale)] = kappa, own
    if bias is not None:
        values[~scale] = bias.coefficients.ravel()
        covariance[np.ix_(~scale, ~scale)] = bias.covariance
    return Thermal(
        reference=seen.reference, low=seen.low, high=seen.high, terms=terms,
        coefficients=values.reshape(-1, 3), covariance=covariance, centre=centre,
        dof=dof if bias is None else min(dof, bias.dof),
    )  # fmt: skip


def _taken_out(
    time: Any,
    warm: BiasTerms,
    force: Float[Array, "n 3"] | None,
    found: Sensitivity,
    rests: Rests,
    bias: str,
) -> tuple[dict[str, Any], Any]:
    # what the rows lose before they are integrated, and the bias that is then left
    more: dict[str, Any] = {}
    known = None
    if force is not None:
        offset = force @ found.G.T
        if warm.thermal is not None:
            offset = offset + warm.rows @ warm.coefficients
            force = np.concatenate([warm.rows, force], axis=1)
        more = {"force": force, "force_noise": found.shape, "offset": offset}
    elif warm.thermal is not None:
        offset = warm.rows @ warm.coefficients
        more = {"force": warm.rows, "force_noise": warm.shape, "offset": offset}
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
