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

from simval.arrays import Array, finite_array, frozen
from simval.calibrate.result import FitResult
from simval.errors import InputError
from simval.sensor import forms

_TAIL = 0.01  # of the chi-square, on either side, beyond which sigma is not believed
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


def diagnose(fit: FitResult, poses: Any, noise_std: Any = None) -> Diagnosis:
    """Look at the residuals of one fit.

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
    readings = finite_array("poses", poses, (None, 3))
    if fit.parameters.ndim != 1 or len(readings) != fit.dof + 9:
        msg = (
            f"`poses` has shape {readings.shape} and the fit was made from "
            f"{fit.dof + 9} poses of one set; give the same readings"
        )
        raise InputError(msg)
    distance, rows, steep = _distances(fit, readings)
    if noise_std is None:
        sigma = np.ones(len(readings))
    else:
        sigma = np.broadcast_to(np.asarray(noise_std, dtype=float), (len(readings),))
        if not np.all(sigma > 0.0):
            msg = f"`noise_std` is {noise_std!r}; it must be above 0 raw units"
            raise InputError(msg)
    chi2, p_value = np.nan, np.nan
    if noise_std is not None and fit.dof > 0:
        total = float(np.sum((distance / sigma) ** 2))
        chi2, p_value = (
            total / fit.dof,
            float(special.gammaincc(fit.dof / 2, total / 2)),
        )
    # a sigma that does not explain the scatter would call half the poses outliers
    trusted = p_value >= _TAIL
    leverage, room = _leverage(fit, rows, steep, sigma)
    standardized, limit = _standardized(distance / sigma, room, fit.dof, known=trusted)
    outliers = np.flatnonzero(np.abs(standardized) > limit)
    return Diagnosis(
        distance=distance,
        leverage=leverage,
        standardized=standardized,
        outliers=tuple(int(k) for k in outliers),
        chi2_per_dof=chi2,
        p_value=p_value,
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
    # signed distances (D1), (n,), their derivatives by the parameters, (n, 9), and
    # the slope of c along them, (n,)
    x = readings - fit.B
    m = fit.matrix
    h = x @ m.T
    steep = 2.0 * np.linalg.norm(h @ m, axis=-1)
    c = np.sum(h * h, axis=-1) - fit.g**2
    slopes = forms.matrix_derivatives(fit.model, fit.parameters)
    by_matrix = 2.0 * np.einsum("nr,jrk,nk->nj", h, slopes, x)
    rows = np.concatenate([by_matrix, -2.0 * h @ m], axis=-1)
    return c / steep, rows / steep[:, None], steep


def _leverage(
    fit: FitResult, rows: Array, distance_slope: Array, sigma: Array
) -> tuple[Array, Array]:
    # leverage, and variance of each fitted residual over that of its noise, (n,):
    # the estimate weighs c by `a`, so with H the hat matrix of sqrt(a) J and D the
    # variance of sqrt(a) c, the residuals have covariance (I - H) D (I - H)
    own = fit.residual in ("weighted", "sampson")
    root = np.ones_like(distance_slope) if own else distance_slope
    weighted = rows * root[:, None]
    q, _ = np.linalg.qr(weighted / np.linalg.norm(weighted, axis=0))
    leverage = np.minimum(np.sum(q * q, axis=-1), 1.0)
    variance = (root * sigma) ** 2
    spread = np.sum((q @ ((q * variance[:, None]).T @ q)) * q, axis=-1)
    return leverage, np.maximum(1.0 - 2.0 * leverage + spread / variance, 0.0)


def _standardized(
    ratio: Array, room: Array, dof: int, *, known: bool
) -> tuple[Array, float]:
    # standardised residuals, and the limit that chance allows to n of them
    tail = FALSE_ALARM / (2.0 * len(ratio))
    result = np.full(len(ratio), np.nan)
    usable = room > 1e-9
    if known:
        result[usable] = ratio[usable] / np.sqrt(room[usable])
        return result, float(-special.ndtri(tail))
    if dof < 2:
        return result, np.inf
    square = ratio[usable] ** 2 / room[usable]
    others = np.maximum(np.sum(ratio**2) - square, np.finfo(float).tiny) / (dof - 1)
    result[usable] = np.sign(ratio[usable]) * np.sqrt(square / others)
    return result, float(-special.stdtrit(dof - 1, tail))
