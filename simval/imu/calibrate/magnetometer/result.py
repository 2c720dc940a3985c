"""The result of a magnetometer's calibration."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from simval.account import Remark
from simval.arrays import Array, json_values
from simval.imu.calibrate.equations import FIELD_NAMES
from simval.imu.calibrate.estimate import Estimate
from simval.imu.calibrate.factors import NoiseFactors
from simval.imu.calibrate.values import magnetometer_account
from simval.imu.sensor import AccelerometerModel, MagnetometerModel, forms
from simval.shapes import Float
from simval.vocabulary import Model

PARAMETERS = 22
ACCELEROMETER, MATRIX, IRON, DIP = slice(0, 9), slice(9, 18), slice(18, 21), 21
"""Where the parameters stand: the accelerometer's nine, M row by row, b, the dip."""
OWN_NAMES = FIELD_NAMES
"""Names of the thirteen parameters that are not the accelerometer's."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MagnetometerFit(Estimate):
    """Calibration of a magnetometer on the axes of its accelerometer.

    The 22 parameters, the dip in rad, have a covariance with the stated noise; `dof`
    are equations, and the knowledge of the accelerometer, less 22; see `Estimate`.

    Attributes
    ----------
    model : str
        Form of the accelerometer's parameters, which fixes the axes of both sensors.
    g : float
        Gravity that the fit took, m/s^2.
    field : float
        Strength of the field that the fit took; it sets the unit of M.
    chi_square : Array
        Weighted sum of squares of all equations, (...); its mean is `dof`.
    half_width : Array
        Greatest half-width of a 95 % interval, relative to field or gravity, (...).
    pose_chi_square : Array
        Chi-square of each pose, three equations, (n,); empty for a batch.
    disturbed : tuple of int
        Poses that do not fit the others, the worst first; empty for a batch.
    findings : tuple of Remark
        What is to be known before the numbers are used, the gravest first.
    noise : NoiseFactors
        By how much the noise of each sensor was taken to exceed what was stated, with
        which the covariance is; empty for a batch, and beside a known accelerometer.
    steady_p_value : float
        Chance that a steady field varies as much with time, eq. (W1) of `drift`; NaN
        for a batch, and where too few poses are left to tell.
    assumption : str
        What picked the fit from its exact twin (-M, -dip).
    """

    what: ClassVar[str] = "a magnetometer"
    states: ClassVar[Any] = staticmethod(magnetometer_account)
    advice: ClassVar[str] = (
        "turn and tilt the sensors to more sides, and look for poses that do not belong"
    )

    model: Model
    g: float
    field: float
    chi_square: Float[Array, "..."]
    half_width: Float[Array, "..."]
    pose_chi_square: Float[Array, " n"]
    disturbed: tuple[int, ...]
    findings: tuple[Remark, ...]
    noise: NoiseFactors
    steady_p_value: float
    assumption: str

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the 22 parameters; the accelerometer's bias is named acc_b."""
        first = forms.names(self.model)
        return (*(f"acc_{x}" if x in OWN_NAMES else x for x in first), *OWN_NAMES)

    @property
    def M(self) -> Float[Array, "... 3 3"]:
        """Matrix from raw units to field, accelerometer's axes, (..., 3, 3)."""
        values = self.parameters[..., MATRIX]
        return values.reshape(*values.shape[:-1], 3, 3)

    @property
    def b(self) -> Float[Array, "... 3"]:
        """Hard iron, raw units, (..., 3)."""
        return self.parameters[..., IRON]

    @property
    def dip(self) -> Any:
        """Angle of the field below the horizon, rad, (...)."""
        return self.parameters[..., DIP]

    @property
    def own_covariance(self) -> Float[Array, "... 13 13"]:
        """Covariance of the magnetometer's thirteen parameters, (..., 13, 13)."""
        return self.covariance[..., 9:, 9:]

    @property
    def chi2_per_dof(self) -> Any:
        """Chi-square per degree of freedom, (...); NaN without freedom."""
        return self.chi_square / (self.dof if self.dof > 0 else np.nan)

    @property
    def right_handed(self) -> Any:
        """True where the magnetometer's axes are right-handed, det M > 0, (...)."""
        return np.linalg.det(self.M) > 0.0

    def sensor(self) -> MagnetometerModel:
        """Return the calibrated magnetometer of a single fit.

        Returns
        -------
        MagnetometerModel
            M and b, without noise.

        Raises
        ------
        InputError
            If this is a batch.
        """
        self._require_single()
        return MagnetometerModel(M=self.M, b=self.b)

    def accelerometer(self) -> AccelerometerModel:
        """Return the accelerometer of a single fit, in whose axes M is.

        Returns
        -------
        AccelerometerModel
            T, K and B, without noise.

        Raises
        ------
        InputError
            If this is a batch.
        """
        self._require_single()
        values = self.parameters[ACCELEROMETER]
        return AccelerometerModel.from_parameters(values, model=self.model)

    def as_document(self) -> dict[str, Any]:
        """Return a single fit as plain JSON values.

        Returns
        -------
        dict
            Parameters with their error bars by name, covariance, chi-squares, findings.

        Raises
        ------
        InputError
            If this is a batch.
        """
        self._require_single()
        entries = zip(self.names, self.parameters, self.sd, strict=True)
        return {
            "model": self.model,
            "g": self.g,
            "field": self.field,
            "parameters": {
                name: {"value": value, "sd": sd} for name, value, sd in entries
            },
            "M": self.M.tolist(),
            "b": self.b.tolist(),
            "dip_deg": np.degrees(self.dip),
            "names": list(self.names),
            "covariance": self.covariance.tolist(),
            "dof": self.dof,
            "status": str(self.status),
            "iterations": int(self.iterations),
            "chi_square": self.chi_square,
            "pose_chi_square": json_values(self.pose_chi_square),
            "disturbed": list(self.disturbed),
            "half_width": self.half_width,
            "right_handed": bool(self.right_handed),
            "assumption": self.assumption,
            "findings": [str(each) for each in self.findings],
            "remarks": [each.as_object() for each in self.findings],
        }
