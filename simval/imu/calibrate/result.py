"""The result of an accelerometer's calibration."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import scipy

from simval.arrays import Array, nonnegative_number, outer
from simval.imu.calibrate.estimate import Estimate
from simval.imu.calibrate.gravity import gravity_error
from simval.imu.calibrate.values import accelerometer_account
from simval.imu.sensor import AccelerometerModel, forms
from simval.shapes import Float
from simval.vocabulary import Loss, Method, Model, Residual

STANDARD_GRAVITY = 9.80665  # m/s^2


def raw_unit(length: float) -> str:
    """Unit of a reading, judged by its size at rest."""
    for name, size in (("m/s^2", STANDARD_GRAVITY), ("g", 1.0)):
        # the halves and doubles of a unit are other ranges: within a factor root 2
        if 0.7 < length / size < 1.4:
            return name
    return "counts"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FitResult(Estimate):
    """Calibration of an accelerometer, from one pose set or a batch of trials.

    Nine parameters with their covariance, `dof` poses less nine, as in `Estimate`.

    Attributes
    ----------
    model : str
        Form of the parameters: triangular, upper or symmetric.
    method : str
        Solver: lm, gauss-newton or newton.
    residual : str
        Residual: squared, norm, weighted, sampson or adjusted.
    loss : str
        Loss: linear, or one that bounds the pull of outliers.
    g : float
        Gravity that the fit took, m/s^2.
    covariance_kind : str
        ``known sigma``, ``type A`` (from the residuals), or ``none`` (nine poses).
    cost : Array
        Sum of squared residuals, (...): (m/s^2)^4 for squared and adjusted,
        (m/s^2)^2 for norm, raw units squared for weighted and sampson.
    condition : Array
        Condition of the poses, eq. (P2) of `poses`, (...).
    rms : Array
        Root mean square of |T K (y - B)| - g, m/s^2, (...).
    chi2_per_dof : Array
        Sum of squared distances to the ellipsoid over sigma, by degree of freedom,
        (...); NaN without sigma or without a degree of freedom.
    gradient_norm : Array
        Norm of the last gradient in the scaled units of the fit, (...): of half the
        cost for norm and sampson, of its share for the others: eq. (H2) of
        `minimization`.
    raw_range : Array
        Least and greatest reading of each axis that it was made from, raw units,
        (..., 3, 2); NaN where that is not known.
    g_std : float
        Standard deviation of `g`, m/s^2, with which the covariance is, eq. (GR3) of
        `simval.imu.calibrate.gravity`; 0 where gravity was taken as exact.
    """

    ample: ClassVar[int] = 200  # the default: sets that can be fitted take 5 to 20
    what: ClassVar[str] = "an accelerometer"
    states: ClassVar[Any] = staticmethod(accelerometer_account)
    advice: ClassVar[str] = (
        "its poses hardly fix an ellipsoid, or some do not belong; add poses over more "
        "of the sphere, and look for outliers"
    )

    model: Model
    method: Method
    residual: Residual
    loss: Loss
    g: float
    covariance_kind: str
    cost: Float[Array, "..."]
    condition: Float[Array, "..."]
    rms: Float[Array, "..."]
    chi2_per_dof: Float[Array, "..."]
    gradient_norm: Float[Array, "..."]
    raw_range: Float[Array, "... 3 2"]
    g_std: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the nine parameters."""
        return forms.names(self.model)

    @property
    def T(self) -> Float[Array, "... 3 3"]:
        """Misalignment, (..., 3, 3); the identity for the symmetric form."""
        return forms.factors(self.model, self.parameters)[0]

    @property
    def K(self) -> Float[Array, "... 3"]:
        """Scale, m/s^2 per raw unit, (..., 3); in symmetric form (..., 3, 3)."""
        return forms.factors(self.model, self.parameters)[1]

    @property
    def B(self) -> Float[Array, "... 3"]:
        """Bias, raw units, (..., 3)."""
        return self.parameters[..., 6:]

    @property
    def matrix(self) -> Float[Array, "... 3 3"]:
        """M = T K, raw units to m/s^2, (..., 3, 3)."""
        return forms.matrix(self.model, self.parameters)

    @property
    def sensor_scale(self) -> Array:
        """Scale the other way round, raw units per m/s^2: the inverse of K."""
        if self.model == "symmetric":
            return np.linalg.inv(self.K)
        return 1.0 / self.K

    @property
    def raw_per_g(self) -> Float[Array, "... 3"]:
        """Reading of each axis for the fit's gravity, raw units, (..., 3)."""
        scale = self.sensor_scale
        if self.model == "symmetric":
            scale = np.linalg.diagonal(scale)
        return self.g * scale

    @property
    def raw_unit(self) -> str:
        """Unit of the raw readings of one fit, judged by their size at rest."""
        return raw_unit(float(np.mean(np.abs(self.raw_per_g))))

    @property
    def of_gravity(self) -> Float[Array, "... 9"]:
        """Change of the parameters by one standard deviation of gravity, (..., 9)."""
        return gravity_error(self.model, self.parameters, self.g_std / self.g)

    def with_gravity(self, g_std: float) -> "FitResult":
        """Return the same fit, its covariance with another uncertainty of gravity.

        Parameters
        ----------
        g_std : float
            Standard deviation of `g`, m/s^2; 0 takes gravity as exact.

        Returns
        -------
        FitResult
            The fit, eq. (GR3) of `simval.imu.calibrate.gravity`.
        """
        if g_std == self.g_std:
            return self
        other = replace(self, g_std=nonnegative_number("g_std", g_std, "m/s^2"))
        new, old = other.of_gravity, self.of_gravity
        more = outer(new, new) - outer(old, old)
        return replace(other, covariance=self.covariance + more)

    @property
    def freedom(self) -> Any:
        """Degrees of freedom of each parameter's variance, (..., 9).

        By Welch and Satterthwaite (JCGM 100:2008, eq. (G.2b)), as that of gravity is
        known; those of the residuals where gravity was taken as exact.
        """
        if self.covariance_kind != "type A":
            return np.inf
        if not self.g_std:
            return float(self.dof)
        variance = self.sd**2
        share = np.maximum(1.0 - self.of_gravity**2 / variance, 0.0)
        with np.errstate(divide="ignore"):
            return self.dof / share**2

    def _quantile(self, tail: float) -> Any:
        if self.covariance_kind == "type A":
            return scipy.special.stdtrit(self.freedom, tail)
        return scipy.special.ndtri(tail)

    def to_form(self, model: Model) -> "FitResult":
        """Return the same calibration in another form, covariance carried along.

        Parameters
        ----------
        model : str
            Form wanted: triangular, upper or symmetric.

        Returns
        -------
        FitResult
            The same ellipsoid and bias.
        """
        parameters, covariance = forms.convert(
            self.parameters, self.covariance, source=self.model, target=model
        )
        changed: dict[str, Any] = {"parameters": parameters, "covariance": covariance}
        return replace(self, model=model, **changed)

    def sensor(self) -> AccelerometerModel:
        """Return the calibrated sensor of a single fit.

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
        return AccelerometerModel.from_parameters(self.parameters, model=self.model)
