"""The result of a calibration of three sensors in one fit."""

from dataclasses import dataclass
from typing import Any, ClassVar

from simval.arrays import Array
from simval.calibrate.described import nine_axis_text
from simval.calibrate.estimate import Estimate
from simval.calibrate.factors import NoiseFactors
from simval.calibrate.gyroscope.result import NAMES, GyroscopeFit
from simval.calibrate.magnetometer.result import OWN_NAMES, MagnetometerFit
from simval.sensor import forms
from simval.shapes import Float

ACCELEROMETER, GYROSCOPE, MAGNETOMETER = slice(0, 9), slice(9, 21), slice(21, 34)
"""Where the parameters of each sensor stand."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NineAxisFit(Estimate):
    """Accelerometer, gyroscope and magnetometer in one fit, one recording or a batch.

    The 34 parameters, the dip in rad, have a covariance with the stated noises; see
    `Estimate`.

    Attributes
    ----------
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

    advice: ClassVar[str] = (
        "the fits of two sensors disagree by more than their noise; look for rests "
        "that moved, a disturbed field and the noise that is stated"
    )

    chi2_per_dof: Float[Array, "..."]
    step: Float[Array, "..."]
    noise: NoiseFactors
    gyroscope: GyroscopeFit
    magnetometer: MagnetometerFit

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
