"""The result of a calibration of three sensors in one fit."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array, frozen
from simval.calibrate.converged import require_all
from simval.calibrate.described import nine_axis_text
from simval.calibrate.factors import NoiseFactors
from simval.calibrate.gyroscope.result import NAMES, GyroscopeFit
from simval.calibrate.intervals import normal_intervals
from simval.calibrate.magnetometer.result import OWN_NAMES, MagnetometerFit
from simval.notebooks import ShownFit
from simval.sensor import forms
from simval.shapes import Float

ACCELEROMETER, GYROSCOPE, MAGNETOMETER = slice(0, 9), slice(9, 21), slice(21, 34)
"""Where the parameters of each sensor stand."""
_ARRAYS = ("parameters", "covariance", "chi2_per_dof", "step")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NineAxisFit(ShownFit):
    """Accelerometer, gyroscope and magnetometer in one fit, one recording or a batch.

    Leading axes ``...`` are empty for one recording and (trials,) for a batch; a trial
    that was refused is NaN in every number.

    Attributes
    ----------
    parameters : Array
        The 34 parameters in the order of `names`, (..., 34); the dip in rad.
    covariance : Array
        Their covariance with the stated noises, (..., 34, 34).
    dof : int
        Rows less parameters.
    status : Array of str
        ``converged``, ``max iterations`` or ``refused: ...``, (...).
    iterations : Array of int
        Linearisations, (...).
    chi2_per_dof : Array
        Weighted sum of squares of all rows by degree of freedom, (...).
    step : Array
        The last step, over its standard deviation, (...).
    noise : NoiseFactors
        By how much the noise of each sensor was taken to exceed what was stated, with
        which covariance and chi-square are; empty for a batch.
    gyroscope : GyroscopeFit
        The gyroscope with the numbers of this fit; its `dof` and `chi2_per_dof` are
        those of all rows.
    magnetometer : MagnetometerFit
        The magnetometer with the parameters and the covariance of this fit. What is
        said of single poses, `chi_square`, `dof`, `pose_chi_square`, `disturbed` and
        `findings`, is of the fit beside the accelerometer alone.
    """

    parameters: Float[Array, "... 34"]
    covariance: Float[Array, "... 34 34"]
    dof: int
    status: Any
    iterations: Any
    chi2_per_dof: Float[Array, "..."]
    step: Float[Array, "..."]
    noise: NoiseFactors
    gyroscope: GyroscopeFit
    magnetometer: MagnetometerFit

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def __str__(self) -> str:
        return nine_axis_text(self)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the 34: the accelerometer's, then with gyro and mag before them."""
        others = (
            (f"gyro_{name}" for name in NAMES),
            (f"mag_{name}" for name in OWN_NAMES),
        )
        return (*forms.names(self.gyroscope.model), *others[0], *others[1])

    @property
    def sd(self) -> Float[Array, "... 34"]:
        """Standard deviation of each parameter, (..., 34)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))

    @property
    def converged(self) -> Any:
        """Whether each trial converged, (...) of bool."""
        return self.status == "converged"

    def confidence_intervals(self, level: float = 0.95) -> Float[Array, "... 34 2"]:
        """Confidence interval of each parameter, with the stated noises.

        Parameters
        ----------
        level : float, default 0.95
            Probability that an interval covers the truth, between 0 and 1.

        Returns
        -------
        Array
            Lower and upper limit, (..., 34, 2).

        Raises
        ------
        InputError
            If `level` is not between 0 and 1.
        """
        return normal_intervals(self.parameters, self.sd, level)

    def require_converged(self) -> "NineAxisFit":
        """Return the fit if every trial converged.

        Returns
        -------
        NineAxisFit
            This fit.

        Raises
        ------
        ConvergenceError
            If a trial did not converge: says which, and why.
        """
        require_all(
            self.converged,
            self.status,
            "{count} fit(s) of three sensors did not converge, the first is trial "
            "{first} ({status}): the fits of two sensors disagree by more than their "
            "noise; look for rests that moved, a disturbed field and the noise that is "
            "stated",
        )
        return self

    def as_object(self) -> dict[str, Any]:
        """Return what the sensors' own objects do not hold, as JSON can hold it.

        Returns
        -------
        dict
            Names, covariance of all parameters, chi-square and status of one fit.
        """
        return {
            "names": list(self.names),
            "covariance": self.covariance.tolist(),
            "dof": self.dof,
            "chi2_per_dof": float(self.chi2_per_dof),
            "status": str(self.status),
            "iterations": int(self.iterations),
        }
