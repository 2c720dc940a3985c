"""The result of a magnetometer's calibration."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array, frozen
from simval.calibrate.converged import require_all
from simval.calibrate.described import magnetometer_text
from simval.calibrate.factors import NoiseFactors
from simval.calibrate.intervals import normal_intervals
from simval.calibrate.magnetometer.equations import ACCELEROMETER, DIP, IRON, MATRIX
from simval.errors import InputError
from simval.notebooks import ShownFit
from simval.sensor import AccelerometerModel, MagnetometerModel, forms
from simval.shapes import Float

OWN_NAMES = (
    *(f"M_{row}{column}" for row in "xyz" for column in "xyz"),
    *(f"b_{axis}" for axis in "xyz"),
    "dip",
)
"""Names of the thirteen parameters that are not the accelerometer's."""

_ARRAYS = ("parameters", "covariance", "chi_square", "half_width", "pose_chi_square")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MagnetometerFit(ShownFit):
    """Calibration of a magnetometer on the axes of its accelerometer.

    Leading axes ``...`` are empty for one set and (trials,) for a batch; a trial that
    was refused is NaN in every number.

    Attributes
    ----------
    model : str
        Form of the accelerometer's parameters, which fixes the axes of both sensors.
    g : float
        Gravity that the fit took, m/s^2.
    field : float
        Strength of the field that the fit took; it sets the unit of M.
    parameters : Array
        The 22 parameters in the order of `names`, (..., 22); the dip in rad.
    covariance : Array
        Their covariance with the stated noise, (..., 22, 22).
    dof : int
        Degrees of freedom: equations, and the knowledge of the accelerometer, less 22.
    status : Array of str
        ``converged``, ``max iterations``, or ``refused: ...``, (...).
    iterations : Array of int
        Steps of the solver, (...).
    chi_square : Array
        Weighted sum of squares of all equations, (...); its mean is `dof`.
    half_width : Array
        Greatest half-width of a 95 % interval, relative to field or gravity, (...).
    pose_chi_square : Array
        Chi-square of each pose, three equations, (n,); empty for a batch.
    disturbed : tuple of int
        Poses that do not fit the others, the worst first; empty for a batch.
    findings : tuple of str
        What is to be known before the numbers are used, the gravest first.
    noise : NoiseFactors
        By how much the noise of each sensor was taken to exceed what was stated, with
        which the covariance is; empty for a batch, and beside a known accelerometer.
    steady_p_value : float
        Chance that a steady field varies as much with time, eq. (M6); NaN for a batch.
    assumption : str
        What picked the fit from its exact twin (-M, -dip).
    """

    model: str
    g: float
    field: float
    parameters: Float[Array, "... 22"]
    covariance: Float[Array, "... 22 22"]
    dof: int
    status: Any
    iterations: Any
    chi_square: Float[Array, "..."]
    half_width: Float[Array, "..."]
    pose_chi_square: Float[Array, " n"]
    disturbed: tuple[int, ...]
    findings: tuple[str, ...]
    noise: NoiseFactors
    steady_p_value: float
    assumption: str

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def __str__(self) -> str:
        return magnetometer_text(self)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the 22 parameters."""
        return (*forms.names(self.model), *OWN_NAMES)

    @property
    def M(self) -> Float[Array, "... 3 3"]:
        """Raw units to units of field, onto the accelerometer's axes, (..., 3, 3)."""
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
    def sd(self) -> Float[Array, "... 22"]:
        """Standard deviation of each parameter, (..., 22)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))

    @property
    def chi2_per_dof(self) -> Any:
        """Chi-square per degree of freedom, (...); NaN without any."""
        return self.chi_square / (self.dof if self.dof > 0 else np.nan)

    @property
    def converged(self) -> Any:
        """Whether each trial converged, (...) of bool."""
        return self.status == "converged"

    @property
    def right_handed(self) -> Any:
        """Whether the magnetometer's axes are right-handed, det M > 0, (...)."""
        return np.linalg.det(self.M) > 0.0

    def confidence_intervals(self, level: float = 0.95) -> Float[Array, "... 22 2"]:
        """Confidence interval of each parameter, with the stated noise.

        Parameters
        ----------
        level : float, default 0.95
            Probability that an interval covers the truth, between 0 and 1.

        Returns
        -------
        Array
            Lower and upper limit, (..., 22, 2).

        Raises
        ------
        InputError
            If `level` is not between 0 and 1.
        """
        return normal_intervals(self.parameters, self.sd, level)

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
        self._require_single("a sensor")
        return MagnetometerModel(M=self.M, b=self.b)

    def accelerometer(self) -> AccelerometerModel:
        """Return the accelerometer of a single fit, whose axes M refers to.

        Returns
        -------
        AccelerometerModel
            T, K and B, without noise.

        Raises
        ------
        InputError
            If this is a batch.
        """
        self._require_single("a sensor")
        values = self.parameters[ACCELEROMETER]
        return AccelerometerModel.from_parameters(values, model=self.model)

    def require_converged(self) -> "MagnetometerFit":
        """Return the fit if every trial converged.

        Returns
        -------
        MagnetometerFit
            This fit.

        Raises
        ------
        ConvergenceError
            If a trial did not converge: says which, and why.
        """
        require_all(
            self.converged,
            self.status,
            "{count} trial(s) did not converge, the first is trial {first} ({status}); "
            "turn and tilt the sensors to more sides, and look for poses that do not "
            "belong",
        )
        return self

    def as_document(self) -> dict[str, Any]:
        """Return a single fit as JSON can hold it.

        Returns
        -------
        dict
            Parameters with their error bars by name, covariance, chi-squares, findings.

        Raises
        ------
        InputError
            If this is a batch.
        """
        self._require_single("a document")
        entries = zip(self.names, self.parameters, self.sd, strict=True)
        chi_squares = [x if np.isfinite(x) else None for x in self.pose_chi_square]
        return {
            "model": self.model,
            "g": self.g,
            "field": self.field,
            "parameters": {
                name: {"value": float(value), "sd": float(sd)}
                for name, value, sd in entries
            },
            "M": self.M.tolist(),
            "b": self.b.tolist(),
            "dip_deg": float(np.degrees(self.dip)),
            "names": list(self.names),
            "covariance": self.covariance.tolist(),
            "dof": self.dof,
            "status": str(self.status),
            "iterations": int(self.iterations),
            "chi_square": float(self.chi_square),
            "pose_chi_square": [None if x is None else float(x) for x in chi_squares],
            "disturbed": list(self.disturbed),
            "half_width": float(self.half_width),
            "right_handed": bool(self.right_handed),
            "assumption": self.assumption,
            "findings": list(self.findings),
        }

    def _require_single(self, what: str) -> None:
        if self.parameters.ndim != 1:
            msg = (
                f"this is a batch of {self.parameters.shape[0]} trials; {what} is made "
                "from one of them: calibrate that one alone"
            )
            raise InputError(msg)
