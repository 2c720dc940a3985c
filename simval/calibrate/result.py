"""The result of a calibration."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from simval.arrays import Array, frozen
from simval.calibrate.described import accelerometer_text
from simval.calibrate.intervals import around, one_tail
from simval.errors import ConvergenceError, InputError
from simval.notebooks import ShownFit
from simval.sensor import AccelerometerModel, forms
from simval.shapes import Float

STANDARD_GRAVITY = 9.80665  # m/s^2
_AMPLE = 200  # steps, the default: sets that can be fitted take 5 to 20

_ARRAYS = (
    "parameters",
    "covariance",
    "cost",
    "condition",
    "rms",
    "chi2_per_dof",
    "gradient_norm",
    "raw_range",
)


def raw_unit(length: float) -> str:
    """Unit of a reading, by its size at rest."""
    for name, size in (("m/s^2", STANDARD_GRAVITY), ("g", 1.0)):
        # the halves and doubles of a unit are other ranges: within a factor root 2
        if 0.7 < length / size < 1.4:
            return name
    return "counts"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FitResult(ShownFit):
    """Calibration of one pose set, or of a batch of trials.

    Leading axes ``...`` are empty for one set and (trials,) for a batch; a trial
    that was refused is NaN in every number.

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
    parameters : Array
        The nine parameters in the order of `names`, (..., 9).
    covariance : Array
        Their covariance, (..., 9, 9); NaN where there is none.
    covariance_kind : str
        ``known sigma``, ``type A`` (from the residuals), or ``none`` (nine poses).
    dof : int
        Degrees of freedom, poses less nine.
    status : Array of str
        ``converged``, ``max iterations``, ``stalled``, or ``refused: ...``, (...).
    iterations : Array of int
        Steps of the solver, (...).
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
        cost for norm and sampson, of its share, eq. (H2) of `leverage`, for the others.
    raw_range : Array
        Least and greatest reading of each axis that it was made from, raw units,
        (..., 3, 2); NaN where that is not known.
    """

    model: str
    method: str
    residual: str
    loss: str
    g: float
    parameters: Float[Array, "... 9"]
    covariance: Float[Array, "... 9 9"]
    covariance_kind: str
    dof: int
    status: Any
    iterations: Any
    cost: Float[Array, "..."]
    condition: Float[Array, "..."]
    rms: Float[Array, "..."]
    chi2_per_dof: Float[Array, "..."]
    gradient_norm: Float[Array, "..."]
    raw_range: Float[Array, "... 3 2"]

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def __str__(self) -> str:
        return accelerometer_text(self)

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
        """Scale, m/s^2 per raw unit, (..., 3); symmetric form: matrix (..., 3, 3)."""
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
        """Scale of the sensor itself, raw units per m/s^2: the inverse of K."""
        if self.model == "symmetric":
            return np.linalg.inv(self.K)
        return 1.0 / self.K

    @property
    def raw_per_g(self) -> Float[Array, "... 3"]:
        """What each axis reads for the gravity of the fit, raw units, (..., 3)."""
        scale = self.sensor_scale
        if self.model == "symmetric":
            scale = np.diagonal(scale, axis1=-2, axis2=-1)
        return self.g * scale

    @property
    def raw_unit(self) -> str:
        """Unit of the raw readings of one fit, by their size at rest."""
        return raw_unit(float(np.mean(np.abs(self.raw_per_g))))

    @property
    def converged(self) -> Any:
        """Whether each trial converged, (...) of bool."""
        return self.status == "converged"

    @property
    def sd(self) -> Float[Array, "... 9"]:
        """Standard deviation of each parameter, (..., 9); NaN where there is none."""
        variance = np.diagonal(self.covariance, axis1=-2, axis2=-1)
        return np.sqrt(variance)

    @property
    def intervals(self) -> Float[Array, "... 9 2"]:
        """Confidence intervals at 95 percent, (..., 9, 2)."""
        return self.confidence_intervals(0.95)

    def confidence_intervals(self, level: float) -> Float[Array, "... 9 2"]:
        """Confidence interval of each parameter.

        Normal quantiles with a known sigma; Student's t with `dof` degrees of
        freedom where the scatter came from the residuals.

        Parameters
        ----------
        level : float
            Probability that an interval covers the truth, between 0 and 1.

        Returns
        -------
        Array
            Lower and upper limit, (..., 9, 2); NaN where there is no covariance.

        Raises
        ------
        InputError
            If `level` is not between 0 and 1.
        """
        tail = one_tail(level)
        if self.covariance_kind == "type A":
            quantile = -scipy.special.stdtrit(self.dof, tail)
        else:
            quantile = -scipy.special.ndtri(tail)
        return around(self.parameters, quantile * self.sd)

    def to_form(self, model: str) -> "FitResult":
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
        fields = {name: getattr(self, name) for name in self.__slots__}
        fields |= {"model": model, "parameters": parameters, "covariance": covariance}
        return FitResult(**fields)

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
        if self.parameters.ndim != 1:
            msg = (
                f"this is a batch of {self.parameters.shape[0]} trials; a sensor is "
                "made from one of them: use AccelerometerModel.from_parameters"
            )
            raise InputError(msg)
        return AccelerometerModel.from_parameters(self.parameters, model=self.model)

    def require_converged(self) -> "FitResult":
        """Return the fit if every trial converged.

        Returns
        -------
        FitResult
            This fit.

        Raises
        ------
        ConvergenceError
            If a trial did not converge: says which, and why.
        """
        bad = np.flatnonzero(~np.atleast_1d(self.converged))
        if bad.size:
            status = np.atleast_1d(self.status)[bad[0]]
            turns = int(np.atleast_1d(self.iterations)[bad[0]])
            few = status == "max iterations" and turns < _AMPLE
            more = " (or raise `max_iterations`)" if few else ""
            msg = (
                f"{bad.size} trial(s) did not converge, the first is trial {bad[0]} "
                f"({status}) after {turns} "
                "iterations: its poses hardly fix an ellipsoid, or some do not belong; "
                f"add poses over more of the sphere, and look for outliers{more}"
            )
            raise ConvergenceError(msg)
        return self
