r"""First- and second-order moments of a calibration's error, and its bound.

A reading is :math:`y = x + B + n`, :math:`M x = a` the true force, :math:`|a| = g`,
:math:`n \sim N(0, \sigma^2 I)`; the direction of each :math:`a` is unknown, so that a
pose says no more than :math:`c = |M(y-B)|^2/g^2 - 1 = 0`. The estimates solve the
equations of `simval.theory.estimating`, with :math:`q = |\partial c/\partial y|^2/4`:

========= ======================== ==========================================
residual  row of a pose            its weight
========= ======================== ==========================================
squared   c                        1
norm      :math:`\sqrt{1+c} - 1`   1
weighted  c                        one over its variance at the estimate
sampson   :math:`c/\sqrt{4q}`      one over the variance of the readings
adjusted  c                        1, and the mean of the noise taken out
========= ======================== ==========================================

What is left out of covariance and bias is :math:`O(\sigma^4)`. Of the unknown
directions nothing is left in c, so the Cramer-Rao bound is

.. math:: \sigma^2 (J^T W J)^{-1}, \quad J_i = \partial c_i/\partial\theta,
   \quad W_{ii} = 1/4q_i. \tag{K2}

What is left out grows with :math:`u = (\sigma K_{max}/g)^2`, the squared relative noise
of the corrected reading on its worst axis and in its noisiest pose. A combination of
parameters that the poses see k times worse has a slope of 1/k in c and a curvature of
order one, so the noise comes to it as a series in :math:`k^2 n` over k: the next order
of a variance, relative to itself, grows as :math:`k^4 u`, that of a bias as
:math:`k^7 u^2`. With :math:`k = \max(1, \kappa/1.3)`, :math:`\kappa` the condition (P2)
of the poses (1.3 of even ones), an entry of natural size s (1 for a misalignment, K for
a scale, g/K for a bias) may be off in its bias by, and in its variance relative to
itself by,

.. math:: 40\, k^7 u^2 s \tag{K3}, \qquad 60\, k^4 u. \tag{K4}

The powers bound the growth; the two factors are measured, over random sensors and 12 to
200 even or random poses: `tests/theory/test_calibration_theory.py`.

A weight is itself a function of a reading. With :math:`G = M^T M`, its q is
:math:`|Gy|^2` up to a constant, and noise changes it, relative to itself, by a square
of the order

.. math:: v_i = \sigma_i^2 \|G\|_F^2 / 3 |G (y_i - B)|^2, \tag{K5}

u for equal scales, and far more where a pose lies along the axis of a small one.
`sampson` and `weighted` have the greatest of u and :math:`v_i` in place of u.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simval.arguments import choice, instance
from simval.arrays import Array, ReadOnly, noise_levels, positive_number
from simval.errors import GeometryError, InputError
from simval.geometry import normalize
from simval.imu.sensor import AccelerometerModel, forms
from simval.moments import deviations
from simval.poses import PARAMETERS, observability, one_set
from simval.shapes import Float, Inexact
from simval.theory.estimating import Block, Estimating, Weights
from simval.vocabulary import RESIDUALS, Model, Residual

_WEIGHTS: Final[dict[str, Weights]] = {"weighted": "estimate", "sampson": "truth"}
BIAS_NEXT = 40.0  # of eq. (K3), measured
VARIANCE_NEXT = 60.0  # of eq. (K4), measured
EVEN = 1.3  # condition of even poses: 1.27 to 1.29 from 12 poses on


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibrationMoments(ReadOnly):
    """Predicted error of a calibration, estimate minus truth.

    Attributes
    ----------
    names : tuple of str
        Names of the nine parameters.
    bias : Array
        Second-order bias, (9,).
    covariance : Array
        First-order covariance, (9, 9).
    cramer_rao : Array
        Cramer-Rao bound with the directions as nuisance parameters, (9, 9).
    bias_remainder : Array
        What the bias may be off by, eq. (K3), (9,).
    variance_remainder : float
        What a variance may be off by relative to itself, eq. (K4).
    """

    names: tuple[str, ...]
    bias: Float[Array, "9"]
    covariance: Float[Array, "9 9"]
    cramer_rao: Float[Array, "9 9"]
    bias_remainder: Float[Array, "9"]
    variance_remainder: float

    @property
    def sd(self) -> Float[Array, "9"]:
        """Standard deviation of each parameter, (9,)."""
        return deviations(self.covariance)

    @property
    def sd_remainder(self) -> Float[Array, "9"]:
        """Remainder of each standard deviation, half of eq. (K4), (9,)."""
        return self.sd * (self.variance_remainder / 2.0)

    @property
    def efficiency(self) -> Float[Array, "9"]:
        """Bound over variance of each parameter, (9,); at most 1, NaN without noise."""
        with np.errstate(invalid="ignore"):
            return np.diagonal(self.cramer_rao) / np.diagonal(self.covariance)


def calibration_moments(
    model: AccelerometerModel,
    directions: Any,
    g: float = 9.80665,
    noise_std: Any = None,
    residual: Residual = "squared",
    *,
    form: Model = "triangular",
) -> CalibrationMoments:
    """Predict the error of a calibration from the sensor and its poses.

    Parameters
    ----------
    model : AccelerometerModel
        The true sensor.
    directions : array_like
        True directions of the specific force, sensor axes, (n, 3), any length but 0.
    g : float, default 9.80665
        Gravity, m/s^2.
    noise_std : float or array_like, optional
        Noise of each axis of a pose mean, raw units, one number or (n,); the
        sensor's own if not given.
    residual : {"squared", "norm", "weighted", "sampson", "adjusted"}
        Which estimate.
    form : {"triangular", "upper", "symmetric"}
        Form of the parameters.

    Returns
    -------
    CalibrationMoments
        Bias, covariance and bound.

    Raises
    ------
    InputError
        If an argument is not usable.
    GeometryError
        If the poses have rank below nine.
    """
    instance("model", model, AccelerometerModel)
    residual = choice("residual", residual, RESIDUALS)
    form = choice("form", form, forms.MODELS)
    g = positive_number("g", g, "m/s^2")
    u = normalize(one_set("directions", directions))
    level = model.noise_std if noise_std is None else noise_std
    sigma = noise_levels("noise_std", level, len(u))
    if sigma.min() == 0.0 < sigma.max():
        msg = "`noise_std` is 0 in some poses and not in others; give each some noise"
        raise InputError(msg)
    found = observability(u)
    if found.rank < PARAMETERS:
        helps = ", ".join(f"{x:.2f}" for x in found.next_direction)
        msg = (
            f"the {len(u)} directions have rank {found.rank} of {PARAMETERS}, "
            "so some parameters cannot be observed and nothing can be "
            f"predicted: add ({helps})"
        )
        raise GeometryError(msg)
    equations = _equations(model, u, g, sigma, residual, form)
    scale = np.linalg.norm(model.matrix, axis=1)
    noise = float((sigma.max() * scale.max() / g) ** 2)
    if residual in _WEIGHTS:  # eq. (K5)
        square = np.sum((model.matrix.T @ model.matrix) ** 2) / 3.0
        own = square * (sigma / g) ** 2 / np.sum((u @ model.matrix) ** 2, axis=1)
        noise = max(noise, float(own.max()))
    worse = max(1.0, found.condition / EVEN)
    return CalibrationMoments(
        names=forms.names(form),
        bias=equations.bias,
        covariance=equations.covariance,
        cramer_rao=equations.bound,
        bias_remainder=BIAS_NEXT * worse**7 * noise**2 * _natural_sizes(form, scale, g),
        variance_remainder=VARIANCE_NEXT * worse**4 * noise,
    )


def in_form(form: str, model: AccelerometerModel) -> Float[Array, "9"]:
    """Parameters of a sensor in one of the forms."""
    return forms.from_gram(form, model.matrix.T @ model.matrix, model.B)


def _natural_sizes(form: str, scale: Array, g: float) -> Array:
    # size s of the nine parameters, eq. (K3)
    first = np.full(6, scale.max())
    if form != "symmetric":
        first = np.concatenate([np.ones(3), scale])
    return np.concatenate([first, g / scale])


def _equations(
    model: AccelerometerModel,
    u: Float[Array, "n 3"],
    g: float,
    sigma: Float[Array, " n"],
    residual: str,
    form: str,
) -> Estimating:
    theta = in_form(form, model)

    def rows(
        theta: Inexact[Array, "t 9"], y: Inexact[Array, "t n 3"]
    ) -> Inexact[Array, "t n 1"]:
        M = forms.matrix(form, theta) / g
        f = (y - theta[:, None, 6:]) @ M.mT
        square = np.sum(f * f, axis=-1, keepdims=True)
        if residual == "norm":
            return np.sqrt(square) - 1.0
        if residual == "sampson":
            q = np.sum((f @ M) ** 2, axis=-1, keepdims=True)
            return (square - 1.0) / np.sqrt(4.0 * q)
        return square - 1.0

    readings = g * np.linalg.solve(model.matrix, u.T).T + model.B
    noise = np.repeat(sigma[:, None], 3, axis=1)
    return Estimating(
        blocks=(Block(rows=rows, y=readings, sigma=noise),),
        theta=theta,
        weights=_WEIGHTS.get(residual, "none"),
        centred=residual == "adjusted",
    )


def calibration_expansion(
    model: AccelerometerModel,
    directions: Float[Array, "n 3"],
    g: float,
    residual: str = "squared",
) -> Estimating:
    """Expansion of a calibration's error, for noise of deviation 1.

    What `adjusted` takes out of its equations is a constant, which is not in it.
    """
    g = positive_number("g", g, "m/s^2")
    u = normalize(one_set("directions", directions))
    plain = "squared" if residual == "adjusted" else residual
    return _equations(model, u, g, np.ones(len(u)), plain, "triangular")
