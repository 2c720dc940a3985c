r"""Residuals of one fit pose by pose, and a verdict in words.

**What limits a calibration, in words: outliers, geometry, scatter or noise.**

The scatter is judged by its chi-square against a known noise. The geometry is judged
against as many poses spread evenly over the sphere: with the rows j of (P1) and
:math:`N_0 = n E[jj^T]`, u uniform on the sphere,

.. math:: \ell = \max_i \sqrt{(N^{-1})_{ii} / (N_0^{-1})_{ii}},  \tag{V1}

the factor that the worst parameter's error bar loses to the choice of poses.

**Whether a fit is as good as its noise, and whether every pose belongs.**

The distance of a reading to the fitted ellipsoid is, to first order,
:math:`r_k = c_k / |\partial c/\partial y|`  (D1), in raw units. Whether a pose belongs
is asked of the readings (`outliers`), not of the fit, which outliers bend and which
a robust loss bends otherwise: the standardised residual of a pose is its distance to
the ellipsoid of the poses that belong, the pose itself left out, by its standard
deviation. That is normal with a known sigma that the chi-square bears out, and else
Student's t with n - 10 degrees of freedom, the scatter taken from the other poses.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from simval.arguments import instance
from simval.arrays import Array, ReadOnly, noise_levels, physical_array
from simval.errors import InputError
from simval.geometry import normalize
from simval.imu.calibrate.accelerometer import checked_time
from simval.imu.calibrate.drift import DRIFT_FALSE_ALARM, HIDDEN, Drift, find_drift
from simval.imu.calibrate.outliers import (
    BELIEVED,
    FALSE_ALARM,
    Outliers,
    chi_square_chance,
    find_outliers,
)
from simval.imu.calibrate.residuals import WEIGHTED, noise_shares
from simval.imu.calibrate.result import FitResult
from simval.imu.sensor import forms
from simval.poses import PARAMETERS, direction_jacobian
from simval.shapes import Float
from simval.text import chance_words, shown

# Of 1000 sets of 20 random directions all over the sphere 99 % lose at most 4.1, of
# 24 3.1; of poses in one half of the sphere the best of 200 sets lost 7.3.
GEOMETRY_LIMIT = 5.0
_WIDE = 0.05  # half-width of a scale's 95 % interval beyond which it is said
_BLIND_BELOW = 10  # dof from which a doubled scatter is seen with 80 %, at `BELIEVED`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """What a verdict is made from.

    Attributes
    ----------
    chi2_per_dof : float
        Of the poses that belong; NaN without sigma or freedom.
    dof : int
        Degrees of freedom of the poses that belong.
    outliers : sequence of (int, float)
        Pose, and how many standard deviations it is off.
    geometry : float
        Factor (V1) of the poses that belong; infinite below rank nine.
    widest : float
        Greatest half-width of a scale's 95 % interval over the scale; NaN if none.
    drift : Drift
        Whether the poses that belong follow their time.
    """

    chi2_per_dof: float
    dof: int
    outliers: Sequence[tuple[int, float]]
    geometry: float
    widest: float
    drift: Drift


def geometry_loss(directions: Float[Array, "n 3"]) -> float:
    """Factor that the worst error bar loses to the choice of poses, eq. (V1)."""
    # moments of a uniform direction: 1/3 of u_i^2, 1/15 of u_i^2 u_j^2, 1/5 of u_i^4
    even = np.zeros((PARAMETERS, PARAMETERS))
    even[:3, :3] = np.eye(3) / 15.0
    even[3:6, 3:6] = (1.0 + 2.0 * np.eye(3)) / 15.0
    even[6:, 6:] = np.eye(3) / 3.0
    best = np.diagonal(np.linalg.inv(4.0 * even)) / len(directions)
    rows = direction_jacobian(directions)
    if np.linalg.matrix_rank(rows) < PARAMETERS:
        return float(np.inf)
    root = np.linalg.pinv(rows)
    return float(np.sqrt(np.max(np.sum(root * root, axis=1) / best)))


def verdict(
    chi2_per_dof: float, dof: int, drift: Drift | None = None, *, first: bool = True
) -> str:
    """Say what a chi-square per degree of freedom means, and a drift if one is seen."""
    if dof == 0:
        return "nine poses fit exactly: the residuals say nothing; add poses"
    if not np.isfinite(chi2_per_dof):
        return "not judged: the noise of a pose mean is not known"
    low, high = (
        2.0 * scipy.special.gammaincinv(dof / 2, [BELIEVED, 1.0 - BELIEVED]) / dof
    )
    factor = np.sqrt(chi2_per_dof)
    drifts = drift is not None and drift.seen
    told = drift is None or drift.excluded
    if chi2_per_dof > high:
        return (
            f"the poses are the limit, not the noise: residuals are {factor:.1f} times "
            "what the noise explains (moved holds, drift, a sensor that is not "
            "linear); more averaging will not help"
            + (", trust the Type A error bars" if told else "")
        )
    if chi2_per_dof < low:
        return (
            f"residuals are {factor:.2f} times what the noise explains: the noise is "
            "overstated, or the poses are not independent"
        )
    said = "noise is the limit: " if first and not drifts else ""
    said += "the residuals are what the noise explains"
    if dof < _BLIND_BELOW:
        said += (
            f", as far as {dof} degree(s) of freedom can tell (scatter of up to "
            f"{np.sqrt(high):.1f} times the noise would pass); more poses would tell"
        )
    return said


def full_verdict(found: Evidence) -> str:
    """Say what limits a calibration, the gravest first."""
    parts = []
    if found.outliers:
        parts.append(_outliers_named(found))
    if found.drift.seen:
        parts.append(drift_words(found.drift))
    wide = not found.geometry <= GEOMETRY_LIMIT
    first = not (parts or wide)
    said = verdict(found.chi2_per_dof, found.dof, found.drift, first=first)
    scatter = f"without that, {said}" if found.outliers else said
    if not wide:
        parts.append(scatter)
    elif "poses are the limit" in said:
        parts += [scatter, f"the geometry costs as well: {_geometry_named(found)}"]
    else:
        parts += [f"the geometry is the limit: {_geometry_named(found)}", scatter]
    if found.widest > _WIDE:
        parts.append(
            f"a scale is known to {100.0 * found.widest:.2g} % only, at 95 %: not yet "
            "a calibration"
        )
    return "; ".join(parts)


def drift_words(found: Drift) -> str:
    """Say that the residuals follow the time, or whether they would show it."""
    if found.seen:
        return (
            f"the sensor drifts: its residuals follow the time as if {found.what} "
            f"changed by {found.span:.2g} over the poses (chance "
            f"{chance_words(found.p_value, 1)}; one is called below "
            f"{DRIFT_FALSE_ALARM:g}), and no error bar holds that; let it warm up and "
            "record again, repeating the first poses at the end"
        )
    if not np.isfinite(found.p_value):
        return "too few poses to tell a drift: record more"
    said = (
        f"none seen (chance {found.p_value:.2g}; one is called below "
        f"{DRIFT_FALSE_ALARM:g})"
    )
    if found.hidden <= HIDDEN:
        return said
    factor = f"{found.hidden:.0f} times" if found.hidden < 1e6 else "far"
    return (
        f"{said}; but the order of the poses hides one: if {found.hides} drifts "
        f"evenly, it must be {factor} greater to be seen than with the same poses in "
        "an order of chance; repeat the first poses at the end"
    )


def _geometry_named(found: Evidence) -> str:
    factor = f"{found.geometry:.0f} times" if found.geometry < 1e6 else "far beyond"
    return (
        f"the worst error bar is {factor} that of as many poses all over the sphere; "
        "add poses in directions not yet covered"
    )


def _outliers_named(found: Evidence) -> str:
    which = " and ".join(
        f"pose {pose} ({off:.3g} standard deviations off)"
        for pose, off in found.outliers
    )
    what = "are outliers" if len(found.outliers) > 1 else "is an outlier"
    return (
        f"the poses are the limit: {which} {what}, not on the ellipsoid of the other "
        "poses; look at the hold, leave it out and calibrate again"
    )


__all__ = ["FALSE_ALARM", "Diagnosis", "Residuals", "diagnose", "residuals", "verdict"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis(ReadOnly):
    """Residuals of one fit, pose by pose, and a verdict in words.

    Attributes
    ----------
    distance : Array
        Signed distance of each reading to the ellipsoid, raw units, (n,).
    leverage : Array
        Share of each pose in its own fit, 0 to 1, (n,); they add up to nine.
    standardized : Array
        Standardised residuals, (n,); NaN where leverage or freedom leaves none.
    outliers : tuple of int
        Poses that are not on the ellipsoid of the others; any of a clean set with a
        chance of 1 %, eq. (O1) of `outliers`.
    chi2_per_dof : float
        Chi-square per degree of freedom; NaN without sigma or freedom.
    p_value : float
        Chance of a chi-square at least as high if sigma is right.
    verdict : str
        What limits the calibration, in words.
    drift : Drift
        Whether the poses that belong follow their time.
    """

    distance: Float[Array, " n"]
    leverage: Float[Array, " n"]
    standardized: Float[Array, " n"]
    outliers: tuple[int, ...]
    chi2_per_dof: float
    p_value: float
    verdict: str
    drift: Drift


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Residuals:
    """Residuals of a fit, or of each fit of a batch."""

    # signed distance of each reading to the ellipsoid, raw units
    distance: Float[Array, "... n"]
    leverage: Float[Array, "... n"]  # share of each pose in its own fit
    # standardised residuals; NaN where there is no freedom
    standardized: Float[Array, "... n"]
    outlier: Any  # bool: poses that are not on the ellipsoid of the others, (..., n)
    # what the greatest of a clean set exceeds with a chance of `FALSE_ALARM`
    limit: Float[Array, "..."]
    # chi-square per degree of freedom; NaN without sigma or freedom
    chi2_per_dof: Float[Array, "..."]
    p_value: Float[Array, "..."]  # chance of a chi-square at least as high


def residuals(fit: FitResult, poses: Any, noise_std: Any = None) -> Residuals:
    """Standardise the residuals of a fit or of a batch of fits.

    Raises
    ------
    InputError
        If the poses are not those of the fit, or the noise is not above zero.
    """
    return _judged(fit, *_checked(fit, poses, noise_std))[0]


def diagnose(
    fit: FitResult, poses: Any, noise_std: Any = None, *, time: Any = None
) -> Diagnosis:
    """Judge the residuals of one fit.

    Parameters
    ----------
    fit : FitResult
        Fit of one set, converged.
    poses : array_like
        The readings it was made from, raw units, (n, 3).
    noise_std : float or array_like, optional
        Noise of each axis of a pose mean, raw units, one number or (n,).
    time : array_like, optional
        When each pose was taken, s, (n,); their order if not given.

    Returns
    -------
    Diagnosis
        Residuals, outliers, chi-square and verdict.

    Raises
    ------
    InputError
        If the fit is a batch, or the poses are not those of the fit.
    """
    if instance("fit", fit, FitResult).parameters.ndim != 1:
        msg = f"a batch of {len(fit.parameters)} fits is not one set; pick one"
        raise InputError(msg)
    readings, sigma = _checked(fit, poses, noise_std)
    clock = checked_time(time, len(readings))
    fitted, (rest,) = _judged(fit, readings, sigma)
    drift = _drift(fit, readings, sigma, clock, ~rest.flagged)
    evidence = _evidence(fit, readings, rest, float(fitted.chi2_per_dof), drift)
    return Diagnosis(
        distance=fitted.distance,
        leverage=fitted.leverage,
        standardized=fitted.standardized,
        outliers=tuple(int(k) for k in np.flatnonzero(rest.flagged)),
        chi2_per_dof=float(fitted.chi2_per_dof),
        p_value=float(fitted.p_value),
        verdict=full_verdict(evidence),
        drift=drift,
    )


def _judged(
    fit: FitResult, readings: Float[Array, "... n 3"], sigma: Float[Array, " n"] | None
) -> tuple[Residuals, list[Outliers]]:
    count = readings.shape[-2]
    distance, rows, steep = _distances(fit, readings)
    ratio = distance / (1.0 if sigma is None else sigma)
    total = np.sum(ratio * ratio, axis=-1)
    p_value = np.full(total.shape, np.nan)
    if sigma is not None and fit.dof > 0:
        p_value = np.asarray(scipy.special.gammaincc(fit.dof / 2, total / 2))
    rests = [find_outliers(one, sigma) for one in readings.reshape(-1, count, 3)]
    shape = distance.shape
    fitted = Residuals(
        distance=distance,
        leverage=_leverage(fit, rows, steep, sigma),
        standardized=np.array([one.standardized for one in rests]).reshape(shape),
        outlier=np.array([one.flagged for one in rests]).reshape(shape),
        limit=np.array([_limit(one, count) for one in rests]).reshape(total.shape),
        chi2_per_dof=np.where(np.isfinite(p_value), total / max(fit.dof, 1), np.nan),
        p_value=p_value,
    )
    return fitted, rests


def _evidence(
    fit: FitResult,
    readings: Float[Array, "n 3"],
    rest: Outliers,
    chi2: float,
    drift: Drift,
) -> Evidence:
    # outliers and a robust loss leave a chi-square of another law than that of the
    # least squares over the poses that belong
    if rest.flagged.any() or fit.loss != "linear":
        chi2 = rest.chi2 / rest.dof if rest.dof > 0 else np.nan
    directions = normalize(fit.sensor().correct(readings[~rest.flagged]))
    scales = [0, 3, 5] if fit.model == "symmetric" else [3, 4, 5]
    low, high = fit.intervals[scales].T
    named = np.flatnonzero(rest.flagged)
    return Evidence(
        chi2_per_dof=float(chi2),
        dof=rest.dof,
        outliers=[(int(k), float(abs(rest.standardized[k]))) for k in named],
        geometry=geometry_loss(directions),
        widest=float(np.max((high - low) / 2.0 / np.abs(fit.parameters[scales]))),
        drift=drift,
    )


def _drift(
    fit: FitResult,
    readings: Float[Array, "n 3"],
    sigma: Float[Array, " n"] | None,
    time: Float[Array, " n"],
    kept: Any,
) -> Drift:
    # of the poses that belong: a bias moves a reading off the ellipsoid along its
    # normal, a gain by the reading over that of the bias
    distance, rows, _ = _distances(fit, readings)
    x = readings - fit.B
    normal = normalize(x @ fit.matrix.T @ fit.matrix)
    unit = np.ones(len(x)) if sigma is None else sigma
    columns = np.concatenate([normal, normal * x], axis=1).T
    names = [f"the {what} of {axis}" for what in ("bias", "gain") for axis in "xyz"]
    return find_drift(
        distance[kept],
        rows[kept],
        {name: column[kept] for name, column in zip(names, columns, strict=True)},
        time[kept],
        known=sigma is not None,
        white=np.diag(1.0 / unit[kept]),
    )


def _checked(
    fit: FitResult, poses: Any, noise_std: Any
) -> tuple[Float[Array, "... n 3"], Float[Array, " n"] | None]:
    # the readings of the fit, and the noise of each
    readings = physical_array("poses", poses, (None, 3))
    count = instance("fit", fit, FitResult).dof + 9
    if readings.shape[:-1] != (*fit.parameters.shape[:-1], count):
        msg = (
            f"`poses` has shape {readings.shape} and the fit was made from {count} "
            f"poses, shape {(*fit.parameters.shape[:-1], count, 3)}; give the same"
        )
        raise InputError(msg)
    if noise_std is None:
        return readings, None
    sigma = noise_levels("noise_std", noise_std, count)
    if not np.all(sigma > 0.0):
        msg = f"`noise_std` is {shown(noise_std)}; it must be above 0 raw units"
        raise InputError(msg)
    return readings, sigma


def _limit(outliers: Outliers, count: int) -> float:
    # quantile of the greatest standardised residual of a clean set of as many poses
    tail = FALSE_ALARM / (2.0 * count)
    # a sigma that does not explain the scatter would call half the poses outliers
    if chi_square_chance(outliers.chi2, outliers.dof) >= BELIEVED:
        return float(-scipy.special.ndtri(tail))
    return (
        float(-scipy.special.stdtrit(outliers.dof - 1, tail))
        if outliers.dof > 1
        else np.inf
    )


def _distances(
    fit: FitResult, readings: Float[Array, "... n 3"]
) -> tuple[Float[Array, "... n"], Float[Array, "... n 9"], Float[Array, "... n"]]:
    # signed distances (D1), their derivatives by the parameters, and the slope of c
    # along them
    x = readings - fit.B[..., None, :]
    m = fit.matrix
    h = x @ np.swapaxes(m, -1, -2)
    back = h @ m
    steep = 2.0 * np.linalg.norm(back, axis=-1)
    c = np.sum(h * h, axis=-1) - fit.g**2
    slopes = forms.matrix_derivatives(fit.model, fit.parameters)
    by_matrix = 2.0 * np.einsum(
        "...nr,...jrk,...nk->...nj", h, slopes, x, optimize=True
    )
    rows = np.concatenate([by_matrix, -2.0 * back], axis=-1)
    return c / steep, rows / steep[..., None], steep


def _leverage(
    fit: FitResult,
    rows: Float[Array, "... n 9"],
    steep: Float[Array, "... n"],
    sigma: Float[Array, " n"] | None,
) -> Float[Array, "... n"]:
    # diagonal of the hat matrix of sqrt(a) J, the estimate weighing c by `a`
    shares = noise_shares(fit.residual, sigma)
    weighted = rows if fit.residual in WEIGHTED else rows * steep[..., None]
    if fit.covariance_kind == "known sigma" and shares is not None:
        weighted = weighted * np.sqrt(shares)[:, None]
    q, _ = np.linalg.qr(weighted / np.linalg.norm(weighted, axis=-2, keepdims=True))
    return np.minimum(np.sum(q * q, axis=-1), 1.0)
