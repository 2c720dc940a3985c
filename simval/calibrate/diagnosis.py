r"""Whether a fit is as good as its noise, and whether every pose belongs.

The distance of a reading to the fitted ellipsoid is, to first order,
:math:`r_k = c_k / |\partial c/\partial y|`  (D1), in raw units. Standardised by its
own standard deviation, which is smaller where the pose has leverage :math:`h_k`,
it is a normal variable with a known sigma that the chi-square bears out, and else
Student's t with n - 10 degrees of freedom, the scatter taken from the other poses
(externally studentised).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from simval.arguments import instance, shown
from simval.arrays import Array, frozen, noise_levels, physical_array
from simval.calibrate.result import FitResult
from simval.errors import InputError
from simval.sensor import forms

_TAIL = 0.01  # of the chi-square, on either side, beyond which sigma is not believed
_NO_ROOM = 1e-9  # a pose that its own parameters follow leaves no residual
GAUSS_MAD = 1.4826  # standard deviation over median absolute value, Gaussian
FALSE_ALARM = 0.01  # chance that any pose of a clean set is called an outlier


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis:
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
        Poses whose standardised residual exceeds what chance allows.
    chi2_per_dof : float
        Chi-square per degree of freedom; NaN without sigma or freedom.
    p_value : float
        Chance of a chi-square at least as high if sigma is right.
    verdict : str
        What limits the calibration, in words.
    """

    distance: Array
    leverage: Array
    standardized: Array
    outliers: tuple[int, ...]
    chi2_per_dof: float
    p_value: float
    verdict: str

    def __post_init__(self) -> None:
        for name in ("distance", "leverage", "standardized"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Residuals:
    """Residuals of a fit, or of each fit of a batch.

    Attributes
    ----------
    distance : Array
        Signed distance of each reading to the ellipsoid, raw units, (..., n).
    leverage : Array
        Share of each pose in its own fit, (..., n).
    standardized : Array
        Standardised residuals, (..., n); NaN where there is no freedom.
    limit : Array
        What the greatest of n exceeds with a chance of `FALSE_ALARM`, (...).
    chi2_per_dof : Array
        Chi-square per degree of freedom, (...); NaN without sigma or freedom.
    p_value : Array
        Chance of a chi-square at least as high, (...).
    """

    distance: Array
    leverage: Array
    standardized: Array
    limit: Array
    chi2_per_dof: Array
    p_value: Array


def residuals(fit: FitResult, poses: Any, noise_std: Any = None) -> Residuals:
    """Standardise the residuals of a fit or of a batch of fits.

    Parameters
    ----------
    fit : FitResult
        One fit or a batch, converged.
    poses : array_like
        The readings it was made from, raw units, (..., n, 3).
    noise_std : float or array_like, optional
        Noise of each axis of a pose mean, raw units, one number or (n,).

    Returns
    -------
    Residuals
        Of each pose.

    Raises
    ------
    InputError
        If the poses are not those of the fit, or the noise is not above zero.
    """
    instance("fit", fit, FitResult)
    readings = physical_array("poses", poses, (None, 3))
    count = fit.dof + 9
    if readings.shape[:-1] != (*fit.parameters.shape[:-1], count):
        msg = (
            f"`poses` has shape {readings.shape} and the fit was made from {count} "
            f"poses, shape {(*fit.parameters.shape[:-1], count, 3)}; give the same"
        )
        raise InputError(msg)
    sigma = noise_levels("noise_std", 1.0 if noise_std is None else noise_std, count)
    if not np.all(sigma > 0.0):
        msg = f"`noise_std` is {shown(noise_std)}; it must be above 0 raw units"
        raise InputError(msg)
    distance, rows, steep = _distances(fit, readings)
    ratio = distance / sigma
    total = np.sum(ratio * ratio, axis=-1)
    p_value = np.full(total.shape, np.nan)
    if noise_std is not None and fit.dof > 0:
        p_value = np.asarray(special.gammaincc(fit.dof / 2, total / 2))
    leverage, room = _leverage(fit, rows, steep, sigma)
    # a sigma that does not explain the scatter would call half the poses outliers
    known = np.asarray(p_value >= _TAIL)
    tail = FALSE_ALARM / (2.0 * count)
    standardized = _scattered(ratio, room, fit)
    limit = float(-special.stdtrit(fit.dof - 1, tail)) if fit.dof > 1 else np.inf
    with np.errstate(divide="ignore", invalid="ignore"):
        plain = np.where(room > _NO_ROOM, ratio / np.sqrt(room), np.nan)
    return Residuals(
        distance=distance,
        leverage=leverage,
        standardized=np.where(known[..., None], plain, standardized),
        limit=np.where(known, float(-special.ndtri(tail)), limit),
        chi2_per_dof=np.where(np.isfinite(p_value), total / max(fit.dof, 1), np.nan),
        p_value=p_value,
    )


def diagnose(fit: FitResult, poses: Any, noise_std: Any = None) -> Diagnosis:
    """Judge the residuals of one fit.

    Parameters
    ----------
    fit : FitResult
        Fit of one set, converged.
    poses : array_like
        The readings it was made from, raw units, (n, 3).
    noise_std : float or array_like, optional
        Noise of each axis of a pose mean, raw units, one number or (n,).

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
    found = residuals(fit, poses, noise_std)
    outliers = np.flatnonzero(np.abs(found.standardized) > found.limit)
    chi2 = float(found.chi2_per_dof)
    return Diagnosis(
        distance=found.distance,
        leverage=found.leverage,
        standardized=found.standardized,
        outliers=tuple(int(k) for k in outliers),
        chi2_per_dof=chi2,
        p_value=float(found.p_value),
        verdict=verdict(chi2, fit.dof),
    )


def verdict(chi2_per_dof: float, dof: int) -> str:
    """Say what a chi-square per degree of freedom means.

    Parameters
    ----------
    chi2_per_dof : float
        Chi-square per degree of freedom, NaN where there is none.
    dof : int
        Degrees of freedom.

    Returns
    -------
    str
        Noise, poses, or not known; judged at 1 percent on either side.
    """
    if dof == 0:
        return "nine poses fit exactly: the residuals say nothing; add poses"
    if not np.isfinite(chi2_per_dof):
        return "not judged: the noise of a pose mean is not known"
    low, high = 2.0 * special.gammaincinv(dof / 2, [_TAIL, 1.0 - _TAIL]) / dof
    factor = np.sqrt(chi2_per_dof)
    if chi2_per_dof > high:
        return (
            f"the poses are the limit, not the noise: residuals are {factor:.1f} times "
            "what white noise explains (moved holds, drift, a sensor that is not "
            "linear); trust the Type A error bars, more averaging will not help"
        )
    if chi2_per_dof < low:
        return (
            f"residuals are {factor:.2f} times what the noise explains: the noise is "
            "overstated, or the poses are not independent"
        )
    return "noise is the limit: the residuals are what the noise explains"


def _distances(fit: FitResult, readings: Array) -> tuple[Array, Array, Array]:
    # signed distances (D1), (..., n), their derivatives by the parameters,
    # (..., n, 9), and the slope of c along them, (..., n)
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
    fit: FitResult, rows: Array, steep: Array, sigma: Array
) -> tuple[Array, Array]:
    # leverage, and variance of each fitted residual over that of its noise,
    # (..., n): the estimate weighs c by `a`, so with H the hat matrix of sqrt(a) J
    # and D the variance of sqrt(a) c, residuals have covariance (I - H) D (I - H)
    own = fit.residual in ("weighted", "sampson")
    root = np.ones_like(steep) if own else steep
    weighted = rows * root[..., None]
    q, _ = np.linalg.qr(weighted / np.linalg.norm(weighted, axis=-2, keepdims=True))
    leverage = np.minimum(np.sum(q * q, axis=-1), 1.0)
    variance = (root * sigma) ** 2
    inner = np.swapaxes(q * variance[..., None], -1, -2) @ q
    spread = np.sum((q @ inner) * q, axis=-1)
    return leverage, np.maximum(1.0 - 2.0 * leverage + spread / variance, 0.0)


def _scattered(ratio: Array, room: Array, fit: FitResult) -> Array:
    # residuals standardised by the scatter of the other poses; of a robust fit by
    # the median, which outliers do not move
    if fit.dof < 2:
        return np.full_like(ratio, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        square = ratio * ratio / room
        if fit.loss == "linear":
            total = np.sum(ratio * ratio, axis=-1, keepdims=True)
            floor = np.finfo(float).eps * total + np.finfo(float).tiny
            variance = np.maximum(total - square, floor) / (fit.dof - 1)
        else:
            middle = np.median(np.sqrt(square), axis=-1, keepdims=True)
            variance = (GAUSS_MAD * middle) ** 2
        result = np.sign(ratio) * np.sqrt(square / variance)
    return np.where(room > _NO_ROOM, result, np.nan)
