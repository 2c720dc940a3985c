"""The result of a gyroscope's calibration, alone or with the accelerometer's."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from simval.arrays import Array
from simval.imu.calibrate.drift import Drift
from simval.imu.calibrate.equations import FIELD_NAMES
from simval.imu.calibrate.estimate import Estimate
from simval.imu.calibrate.factors import NoiseFactors
from simval.imu.calibrate.gyroscope.noise import Weighting
from simval.imu.calibrate.recording import Bias
from simval.imu.calibrate.values import gyroscope_account
from simval.imu.sensor import GyroscopeFactors, GyroscopeModel, forms, gyroscope_factors
from simval.imu.sensor.forms import Factors
from simval.shapes import Float
from simval.vocabulary import Model

NAMES = (*FIELD_NAMES[:9], "B_x", "B_y", "B_z")
START = ", and give a `start` near the truth"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GyroscopeFit(Estimate):
    """Calibration of a gyroscope with its accelerometer, of one trial or a batch.

    Leading axes ``...`` are empty for one recording and (trials,) for a batch; a trial
    that was refused is NaN in every number. The gyroscope's axes are those of the
    accelerometer's form (`model`): see the gauge in `simval.imu.sensor.models`.

    Attributes
    ----------
    model : str
        Form of the accelerometer: triangular, upper or symmetric.
    estimator : str
        joint, generalised or unweighted.
    bias : str
        constant (estimated), first rest, or line (taken out between neighbours).
    accelerometer : Array
        The accelerometer's nine, whose axes these are, (..., 9).
    chi2_per_dof : Array
        Weighted sum of squares by degree of freedom, (...).
    condition : Array
        Condition of the rotations, eq. (N7) of `simval.turns`, (...).
    residual_angles : Array
        Between gravity as rotated and as read at the end of each rotation, rad,
        (..., k).
    noise : NoiseFactors
        By how much the noise of each sensor was taken to exceed what was stated, with
        which covariance and chi-square are; empty for a batch and a fit of one sensor.
    drift : Drift or None
        Whether its residuals follow the time; None where `noise` is empty.
    """

    what: ClassVar[str] = "a gyroscope"
    states: ClassVar[Any] = staticmethod(gyroscope_account)
    advice: ClassVar[str] = (
        f"look for rests that do not belong, for another order of the axes{START}"
    )

    model: Model
    estimator: Weighting
    bias: Bias
    accelerometer: Float[Array, "... 9"]
    chi2_per_dof: Float[Array, "..."]
    condition: Float[Array, "..."]
    residual_angles: Float[Array, "... k"]
    noise: NoiseFactors
    drift: Drift | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the twelve parameters."""
        return NAMES

    @property
    def M(self) -> Float[Array, "... 3 3"]:
        """Matrix from raw units to rad/s in the accelerometer's axes, (..., 3, 3)."""
        return self.parameters[..., :9].reshape(*self.parameters.shape[:-1], 3, 3)

    @property
    def B(self) -> Float[Array, "... 3"]:
        """Bias, raw units, (..., 3); of a line in time, its mean over the rests."""
        return self.parameters[..., 9:]

    @property
    def own_covariance(self) -> Float[Array, "... 12 12"]:
        """Covariance of the gyroscope's twelve parameters, (..., 12, 12)."""
        return self.covariance[..., 9:, 9:]

    def factors(self, form: Factors = "misalignment-scale") -> GyroscopeFactors:
        """Write M of one fit in another convention, with its covariance.

        Parameters
        ----------
        form : {"misalignment-scale", "kalibr", "polar"}
            Form wanted.

        Returns
        -------
        GyroscopeFactors
            The factors.
        """
        self._require_single()
        return gyroscope_factors(self.M, self.own_covariance[:9, :9], form=form)

    def to_form(self, model: Model) -> "GyroscopeFit":
        """Return one fit on the axes of another form of the accelerometer.

        The accelerometer's axes turn by Q and M becomes Q M, the gauge of
        `simval.imu.sensor.models`; Q depends on the accelerometer's parameters, so the
        covariance of all 21 is carried together.

        Parameters
        ----------
        model : str
            Form wanted: triangular, upper or symmetric.

        Returns
        -------
        GyroscopeFit
            The same sensors.
        """
        self._require_single()
        old, source = self.accelerometer, self.model
        new, _ = forms.convert(old, None, source=source, target=model)
        inverse = np.linalg.inv(forms.matrix(source, old))
        Q = forms.matrix(model, new) @ inverse
        # new accelerometer parameters and Q M, by the old ones
        J = np.eye(21)
        J[:9, :9] = forms.conversion_jacobian(old, new, source=source, target=model)
        slopes = forms.matrix_derivatives(model, new)
        moved = np.einsum("pq,pij->qij", J[:6, :6], slopes)
        dQ = (moved - Q @ forms.matrix_derivatives(source, old)) @ inverse
        J[9:18, :6] = (dQ @ self.M).reshape(6, 9).T
        J[9:18, 9:18] = np.kron(Q, np.eye(3))
        return replace(
            self,
            model=model,
            accelerometer=new,
            parameters=np.concatenate([(Q @ self.M).ravel(), self.B]),
            covariance=J @ self.covariance @ J.T,
        )

    def sensor(self) -> GyroscopeModel:
        """Return the calibrated gyroscope of a single fit.

        Returns
        -------
        GyroscopeModel
            M and B, without noise.
        """
        self._require_single()
        return GyroscopeModel(M=self.M, B=self.B)

    def as_object(self) -> dict[str, Any]:
        """Return one fit as plain JSON values.

        Returns
        -------
        dict
            Names, parameters, error bars, factors and statistics.
        """
        scaled = self.factors()
        return {
            "axes": f"accelerometer, {self.model} form",
            "estimator": self.estimator,
            "bias_model": self.bias,
            "names": list(self.names),
            "parameters": self.parameters.tolist(),
            "sd": self.sd.tolist(),
            "covariance": self.own_covariance.tolist(),
            "M": self.M.tolist(),
            "B": self.B.tolist(),
            "T": scaled.shape.tolist(),
            "K": np.diagonal(scaled.rest).tolist(),
            "T_K_names": list(scaled.names),
            "T_K_sd": scaled.sd.tolist(),
            "chi2_per_dof": self.chi2_per_dof,
            "dof": self.dof,
            "condition": self.condition,
            "residual_angles_rad": self.residual_angles.tolist(),
            "status": str(self.status),
        }
