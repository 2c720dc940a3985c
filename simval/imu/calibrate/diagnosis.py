r"""Diagnosis of an accelerometer's fit: whether it is as good as its noise allows.

The distance of a reading to the fitted ellipsoid is, to first order,
:math:`r_k = c_k / |\partial c/\partial y|`  (D1), in raw units. Whether a pose belongs
is asked of the readings (`outliers`), not of the fit, which outliers bend and which
a robust loss bends otherwise: the standardised residual of a pose is its distance to
the ellipsoid of the poses that belong, the pose itself left out, by its standard
deviation. That is normal with a known sigma that the chi-square bears out, and else
Student's t with n - 10 degrees of freedom, the scatter taken from the other poses.

The scatter is judged by its chi-square against a known noise, the geometry by the
factor (P3) of `simval.poses` against as many poses spread evenly over the sphere.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arguments import instance
from simval.arrays import Array, ReadOnly, noise_levels, physical_array
from simval.errors import InputError
from simval.geometry import normalize
from simval.imu.calibrate.accelerometer import checked_time, require_noise
from simval.imu.calibrate.drift import (
    Drift,
    find_drift,
    of_a_triad,
)
from simval.imu.calibrate.goodness_of_fit import (
    Combination,
    chi_square_chance,
    least_determined_of,
)
from simval.imu.calibrate.outliers import judge_poses, standardized
from simval.imu.calibrate.result import FitResult
from simval.imu.explain import Judgement
from simval.imu.sensor import forms
from simval.poses import PARAMETERS, geometry_loss
from simval.shapes import Float
from simval.spelling import series

LEAST_FREEDOM = 10  # dof from which a doubled scatter is seen with 80 %, at `BELIEVED`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis(ReadOnly):
    """Residuals of one fit, pose by pose, and what limits its accuracy.

    Attributes
    ----------
    standardized : Array
        Standardised residuals, (n,); NaN where geometry or freedom leaves none.
    judgement : Judgement or None
        What is wrong with the poses, `simval.imu.explain.judge`; None where no noise is
        known to judge them by.
    outliers : tuple of int
        Poses that the likeliest cause leaves out, if it is a remark or a refusal;
        without a noise those that are not on the ellipsoid of the others, which any of
        a clean set is with a chance of 1 %, eq. (O1) of `goodness_of_fit`.
    chi2_per_dof : float
        Chi-square per degree of freedom; NaN without sigma or freedom.
    p_value : float
        Chance of a chi-square at least as high if sigma is right.
    cause, do : str
        What is wrong with the poses, and what to do; empty where nothing is.
    geometry : float
        Factor that the worst error bar loses to the choice of poses, (P3) of `poses`.
    widest : float
        Half-width of the widest 95 % interval of a scale, over the scale.
    freedom : int
        Degrees of freedom that the scatter is judged with.
    hidden : float
        Factor by which the order of the poses hides an even drift, (W2) of
        `simval.imu.calibrate.drift`.
    hides : str
        What drifts unseen by that factor.
    least_determined : Combination
        The combination of parameters that the poses determine least.
    """

    standardized: Float[Array, " n"]
    judgement: Judgement | None
    outliers: tuple[int, ...]
    chi2_per_dof: float
    p_value: float
    cause: str
    do: str
    geometry: float
    widest: float
    freedom: int
    hidden: float
    hides: str
    least_determined: Combination

    @property
    def wrong(self) -> str:
        """Say what is wrong with the poses and what to do; empty if nothing is."""
        return f"{self.cause}: {self.do}" if self.do else self.cause


def diagnose(
    fit: FitResult,
    poses: Any,
    noise_std: Any = None,
    *,
    time: Any = None,
    further: Any = None,
    judgement: Judgement | None = None,
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
    further : array_like, optional
        Derivatives of the distances by further parameters that were fitted, (n, k).
    judgement : Judgement, optional
        What is wrong with the poses, where it has been judged by more than `noise_std`.

    Returns
    -------
    Diagnosis
        Residuals, outliers, chi-square, and what is wrong.

    Raises
    ------
    InputError
        If the fit is a batch, or the poses are not those of the fit.
    """
    if instance("fit", fit, FitResult).parameters.ndim != 1:
        msg = f"this is a batch of {len(fit.parameters)} fits; pick one of them"
        raise InputError(msg)
    more = (
        np.zeros((0, 0))
        if further is None
        else physical_array("further", further, (None, None))
    )
    count = fit.dof + PARAMETERS + more.shape[1]
    readings, sigma = _checked(fit, poses, noise_std, count)
    clock = checked_time(time, len(readings))
    distance, nine = distances(fit, readings)
    rows = nine if further is None else np.concatenate([nine, more], axis=1)
    unit = np.ones(len(readings)) if sigma is None else sigma
    total, chi2, p_value = float(np.sum((distance / unit) ** 2)), np.nan, np.nan
    if sigma is not None and fit.dof > 0:
        chi2, p_value = total / fit.dof, chi_square_chance(total, fit.dof)
    if judgement is None:
        judgement, off = judge_poses(readings, sigma, clock)
    else:
        off = list(judgement.off)
    drift = _drift(fit, readings, distance, rows, sigma, clock)
    kept = np.delete(readings, off, axis=0)
    cause = do = ""
    if judgement is not None:
        times = None if time is None else np.sort(clock)
        cause, do = judgement.cause(times), judgement.advice
    elif off:
        many, named = len(off) > 1, series(map(str, off))
        cause = f"gravity in pose{'s' * many} {named} is not that of the others"
        them = "them" if many else "it"
        do = f"look at the hold, leave {them} out and calibrate again"
    geometry = geometry_loss(normalize(fit.sensor().correct(kept)))
    scales = [0, 3, 5] if fit.model == "symmetric" else [3, 4, 5]
    low, high = fit.intervals[scales].T
    widest = float(np.max((high - low) / 2.0 / np.abs(fit.parameters[scales])))
    return Diagnosis(
        standardized=standardized(readings, sigma, off),
        judgement=judgement,
        outliers=tuple(off),
        chi2_per_dof=chi2,
        p_value=p_value,
        cause=cause,
        do=do,
        geometry=geometry,
        widest=widest,
        freedom=max(len(kept) - PARAMETERS - more.shape[1], 0),
        hidden=drift.hidden,
        hides=drift.hides,
        least_determined=least_determined_of(nine / unit[:, None], fit.names),
    )


def _checked(
    fit: FitResult, poses: Any, noise_std: Any, count: int
) -> tuple[Float[Array, "n 3"], Float[Array, " n"] | None]:
    # the readings of the fit, and the noise of each
    readings = physical_array("poses", poses, (None, 3))
    if readings.shape != (count, 3):
        msg = (
            f"`poses` has shape {readings.shape}, but the fit was made from "
            f"{count} poses, shape {(count, 3)}; give those poses"
        )
        raise InputError(msg)
    if noise_std is None:
        return readings, None
    sigma = noise_levels("noise_std", noise_std, count)
    require_noise("noise_std", sigma)
    return readings, sigma


def reduced_chi2(
    fit: FitResult, readings: Float[Array, "n 3"], sigma: Float[Array, " n"] | None
) -> float:
    """Chi-square per degree of freedom; NaN without known noise or freedom."""
    if sigma is None or fit.dof == 0:
        return np.nan
    distance = distances(fit, readings)[0]
    return float(np.sum((distance / sigma) ** 2)) / fit.dof


def distances(
    fit: FitResult, readings: Float[Array, "n 3"]
) -> tuple[Float[Array, " n"], Float[Array, "n 9"]]:
    """Signed distances (D1) of the poses, and their derivatives by the parameters."""
    x = readings - fit.B
    h = x @ fit.matrix.T
    back = h @ fit.matrix
    steep = 2.0 * np.linalg.norm(back, axis=-1)
    c = np.sum(h * h, axis=-1) - fit.g**2
    slopes = forms.matrix_derivatives(fit.model, fit.parameters)
    by_matrix = 2.0 * np.einsum("nr,jrk,nk->nj", h, slopes, x, optimize=True)
    rows = np.concatenate([by_matrix, -2.0 * back], axis=-1)
    return c / steep, rows / steep[:, None]


def _drift(
    fit: FitResult, readings: Array, distance: Array, rows: Array, sigma: Any,
    time: Array,
) -> Drift:  # fmt: skip
    # a bias moves a reading off the ellipsoid along its normal, a gain by the reading
    # over that of the bias
    x, unit = readings - fit.B, np.ones(len(readings)) if sigma is None else sigma
    normal = normalize(x @ fit.matrix.T @ fit.matrix)
    return find_drift(
        distance, rows, of_a_triad(normal, x), time, known=sigma is not None,
        white=np.diag(1.0 / unit),
    )  # fmt: skip
