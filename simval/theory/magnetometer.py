r"""Error of a magnetometer's calibration to second order, and of the usual recipe.

A pose of unknown attitude leaves of its six readings three equations,

.. math:: c = [\,|u|^2 - 1,\ |v|^2 - 1,\ u^T v + \sin(\mathrm{dip})\,] = 0, \quad
   u = M_a (y_a - b_a)/g,\ v = M_m (y_m - b_m)/F,  \tag{M1}

and nothing else of the 22 parameters: with :math:`J = \partial c/\partial\theta` and
:math:`D = \partial c/\partial(y_a, y_m)` the Cramer-Rao bound, attitudes unknown, is

.. math:: P = \Big(\sum_i J_i^T W_i J_i\Big)^{-1}, \quad
   W_i = (D_i \Sigma D_i^T)^{-1}.  \tag{M2}

The estimate that solves :math:`\psi = \sum_i J_i^T W_i c_i = 0` reaches it to first
order. Along a reading k it moves by :math:`\theta_k = -P\, \partial\psi/\partial y_k`,
and its mean is off by

.. math:: -\tfrac12 P \sum_k \sigma_k^2 \frac{d^2}{d\varepsilon^2}
   \psi(\theta + \varepsilon \theta_k,\ y + \varepsilon e_k),  \tag{M7}

left out is :math:`O(\sigma^4)`. The usual recipe, an unweighted ellipsoid for each
sensor and then a turn, solves :math:`\sum_i \partial c_{i1}/\partial\theta_a\, c_{i1} =
0`, the same of :math:`c_2` for the symmetric part of :math:`dM M^{-1}` and b, and of
:math:`c_3` for its turn and the dip; :math:`H^{-1} B H^{-T}`, with H the derivative of
these equations and B their covariance, is its covariance  (M8).

With :math:`u = \sigma^2 / \cos^2(\mathrm{dip})`, :math:`\sigma` the relative noise of
the noisier sensor's corrected reading, since only the horizontal part of the field
tells a heading, and w the greatest standard deviation of the
natural parameters (:math:`dM M^{-1}`, M db over the field, the sine), poses see their
worst combination :math:`k = \max(1, w \sqrt n / 2.4 \sigma)` times worse than many
even ones do with one noisy sensor. As for the accelerometer (`calibration`) a variance
may be off by, relative to itself, and a bias by, in standard deviations,

.. math:: 10\, k^4 u \tag{M9}, \qquad 10\, k^6 u^{3/2} \sqrt n. \tag{M10}

The powers bound the growth; the factors are measured over random sensors and 10 to 100
random poses: `tests/test_magnetometer_theory.py`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array, frozen
from simval.errors import GeometryError
from simval.sensor import AccelerometerModel, MagnetometerModel, forms
from simval.shapes import Float
from simval.theory.magnetometer_poses import (
    PARAMETERS,
    Problem,
    along_of,
    jacobian,
    noise_of,
    problem_of,
    reach_of,
    slopes_of,
    weights_of,
)

VARIANCE_NEXT = 10.0  # of eq. (M9), measured
BIAS_NEXT = 10.0  # of eq. (M10), measured
EVEN = 2.4  # w sqrt(n) / sigma of many poses, for any dip from 0 to 89 degrees
_STEP = 1e-3  # of a reading's size: leaves 1e-10 of the bias at a dip of 85 degrees
_FIRST = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}  # difference of fourth order
_RANK = 1e-10  # of the greatest singular value, columns of equal length


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MagnetometerMoments:
    """Predicted error of a magnetometer's calibration, estimate minus truth.

    Attributes
    ----------
    names : tuple of str
        Names of the 22 parameters: the accelerometer's, M by rows, b, and the dip.
    bias : Array
        Second-order bias of the weighted fit, (22,); the dip in rad.
    covariance : Array
        Its first-order covariance, which is the Cramer-Rao bound (M2), (22, 22).
    recipe : Array
        First-order covariance of the usual recipe, eq. (M8), (22, 22).
    bias_remainder : Array
        What the bias may be off by, eq. (M10), (22,).
    variance_remainder : float
        What a variance may be off by relative to itself, eq. (M9).
    """

    names: tuple[str, ...]
    bias: Float[Array, "22"]
    covariance: Float[Array, "22 22"]
    recipe: Float[Array, "22 22"]
    bias_remainder: Float[Array, "22"]
    variance_remainder: float

    def __post_init__(self) -> None:
        for name in ("bias", "covariance", "recipe", "bias_remainder"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def sd(self) -> Float[Array, "22"]:
        """Standard deviation of each parameter, (22,)."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def recipe_ratio(self) -> Float[Array, "22"]:
        """Variance of the usual recipe over the bound, (22,)."""
        return np.diagonal(self.recipe) / np.diagonal(self.covariance)


def magnetometer_moments(
    accelerometer: AccelerometerModel,
    magnetometer: MagnetometerModel,
    attitudes: Any,
    dip: float,
    *,
    accelerometer_std: Any,
    magnetometer_std: Any,
    g: float = 9.80665,
    field: float = 1.0,
    form: str = "triangular",
) -> MagnetometerMoments:
    """Predict the error of a magnetometer's calibration from its poses.

    Parameters
    ----------
    accelerometer, magnetometer : AccelerometerModel, MagnetometerModel
        The true sensors.
    attitudes : array_like
        True attitudes, world to body, world axes north, west and up, (n, 4).
    dip : float
        Angle of the field below the horizon, rad.
    accelerometer_std, magnetometer_std : float or array_like
        Noise of each axis of a pose mean, raw units, one number or (n,).
    g, field : float
        Gravity, m/s^2, and strength of the field in the unit of M.
    form : {"triangular", "upper", "symmetric"}
        Form of the accelerometer's parameters.

    Returns
    -------
    MagnetometerMoments
        Bias, covariance (the bound), and the covariance of the usual recipe.

    Raises
    ------
    InputError
        If an argument is not usable.
    GeometryError
        If the poses leave a parameter unobservable.
    """
    problem = problem_of(
        accelerometer, magnetometer, attitudes, dip, accelerometer_std,
        magnetometer_std, g=g, field=field, form=form,
    )  # fmt: skip
    slopes, weights = jacobian(problem), weights_of(problem)
    information = information_of(problem).sum(axis=0)
    rank = rank_of(information)
    if rank < PARAMETERS:
        msg = (
            f"the {len(problem.y)} poses have rank {rank} of {PARAMETERS}, so some "
            "parameters cannot be told apart; turn and tilt to more sides"
        )
        raise GeometryError(msg)
    covariance = inverse_of(information)
    carry = _natural(problem)
    worst = float(np.sqrt(np.max(np.diagonal(carry @ covariance @ carry.T))))
    to_dip = np.ones(PARAMETERS)
    to_dip[-1] = 1.0 / np.cos(np.arcsin(problem.theta[-1]))
    bias = _second_order(problem, covariance, slopes, weights)
    # arcsin is curved: half its second derivative times the variance
    bias[-1] += 0.5 * np.tan(dip) * to_dip[-1] * covariance[-1, -1]
    sd, count = np.sqrt(np.diagonal(covariance)), len(problem.y)
    noise = float(np.max(problem.sigma / problem.size))
    u, k = (noise / np.cos(dip)) ** 2, max(1.0, worst * count**0.5 / noise / EVEN)
    both = np.outer(to_dip, to_dip)
    return MagnetometerMoments(
        names=(*forms.names(problem.form), *NAMES),
        bias=bias * to_dip,
        covariance=covariance * both,
        recipe=_recipe(problem, slopes) * both,
        bias_remainder=BIAS_NEXT * k**6 * u**1.5 * np.sqrt(count) * sd * to_dip,
        variance_remainder=VARIANCE_NEXT * k**4 * u,
    )


NAMES = (
    *(f"M_{row}{column}" for row in "xyz" for column in "xyz"),
    *(f"b_{axis}" for axis in "xyz"),
    "dip",
)


def information_of(p: Problem) -> Float[Array, "n 22 22"]:
    """Fisher information of each pose, the terms of eq. (M2)."""
    slopes = jacobian(p)
    return np.swapaxes(slopes, -1, -2) @ weights_of(p) @ slopes


def rank_of(information: Float[Array, "22 22"]) -> int:
    """How many combinations of the parameters the poses see."""
    scale = np.sqrt(np.diagonal(information))
    scale = np.where(scale > 0.0, scale, 1.0)
    values = np.linalg.eigvalsh(information / np.outer(scale, scale))
    return int(np.count_nonzero(values > _RANK * values[-1]))


def inverse_of(information: Float[Array, "22 22"]) -> Float[Array, "22 22"]:
    """The bound: the inverse, by way of columns of equal length."""
    scale = np.sqrt(np.diagonal(information))
    whole = np.linalg.inv(information / np.outer(scale, scale))
    return (whole + whole.T) / 2.0 / np.outer(scale, scale)


def _natural(p: Problem) -> Float[Array, "22 22"]:
    # the parameters' natural sizes: dM M^-1, M db over field or gravity, the sine
    carry = np.eye(PARAMETERS)
    matrix_a = forms.matrix(p.form, p.theta[:9])
    for row in range(6):
        slope = forms.matrix_derivatives(p.form, p.theta[None, :9])[0, row]
        carry[row, row] = np.linalg.norm(slope @ np.linalg.inv(matrix_a))
    carry[6:9, 6:9] = matrix_a / p.g
    matrix_m = p.theta[9:18].reshape(3, 3)
    carry[9:18, 9:18] = np.kron(np.eye(3), np.linalg.inv(matrix_m).T)
    carry[18:21, 18:21] = matrix_m / p.field
    return carry


def _second_order(
    p: Problem, covariance: Array, slopes: Array, weights: Array
) -> Float[Array, "22"]:
    # eq. (M7). Along reading k all poses see theta_k, whose squares add up to P; only
    # its own pose sees the reading move as well
    unit = float(np.max(p.sigma / p.size))
    sd = np.sqrt(np.diagonal(covariance))
    values, axes = np.linalg.eigh(covariance / np.outer(sd, sd))
    root = sd[:, None] * axes * np.sqrt(np.abs(values)) / unit
    bent = _bent(p, p.y, p.sigma, (root.T, np.zeros((1, *p.y.shape))))
    total = unit**2 * np.sign(values) @ bent
    reach = reach_of(p, p.theta, p.y)
    pushed = np.einsum("nai,nab,nbk->nki", slopes, weights, reach)  # dpsi/dy
    theta = -(pushed @ covariance) * p.size[:, None]  # theta_k
    y, sigma = p.y[:, None, None], p.sigma[:, None, None]
    moved = (p.size * np.eye(6))[:, None]
    own = _bent(p, y, sigma, (theta, moved)) - _bent(p, y, sigma, (theta, 0.0 * moved))
    total += np.einsum("nk,nki->i", (p.sigma / p.size) ** 2, own)
    return -0.5 * covariance @ total


def _bent(p: Problem, y: Array, sigma: Array, way: tuple[Array, Array]) -> Array:
    # Second derivative of psi at the truth along each way, (..., 22). There c = 0, so
    # it is A c'' + 2 A' c' with A = J'W; c' is exact, and only first differences of A
    # and c' are taken
    turned: Any = 0.0
    curved: Any = 0.0
    for k, weight in _FIRST.items():
        there = p.theta + k * _STEP * way[0], y + k * _STEP * way[1]
        turned = turned + weight / _STEP * _pull(p, *there, sigma)
        curved = curved + weight / _STEP * along_of(p, there, way)
    pulled, moved = _pull(p, p.theta, y, sigma), along_of(p, (p.theta, y), way)
    both = np.matvec(pulled, curved) + 2.0 * np.matvec(turned, moved)
    return np.asarray(both.sum(axis=-2))


def _pull(
    p: Problem, theta: Float[Array, "... 22"], y: Float[Array, "... n 6"], sigma: Array
) -> Float[Array, "... n 22 3"]:
    # A of each pose
    reach = reach_of(p, theta, y) * sigma[..., None, :]
    noise = reach @ np.swapaxes(reach, -1, -2)
    slopes = slopes_of(p, theta, y)
    return np.swapaxes(np.linalg.solve(noise, slopes), -1, -2)


def _recipe(p: Problem, slopes: Float[Array, "n 3 22"]) -> Float[Array, "22 22"]:
    # eq. (M8), in parameters that part M into shape and turn: dM = (S + [f x]) M
    carry = np.zeros((PARAMETERS, PARAMETERS))
    carry[:9, :9], carry[18:21, 15:18], carry[21, 21] = np.eye(9), np.eye(3), 1.0
    matrix = p.theta[9:18].reshape(3, 3)
    for column, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        unit = np.zeros((3, 3))
        unit[i, j] = unit[j, i] = 1.0
        carry[9:18, 9 + column] = (unit @ matrix).ravel()
    for column, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        unit = np.zeros((3, 3))
        unit[j, i], unit[i, j] = 1.0, -1.0
        carry[9:18, 18 + column] = (unit @ matrix).ravel()
    parted = slopes @ carry
    own = np.zeros_like(parted)  # what each equation is made least in
    stages = (slice(0, 9), slice(9, 18), slice(18, 22))
    for equation, part in enumerate(stages):
        own[:, equation, part] = parted[:, equation, part]
    slope = np.einsum("nai,naj->ij", own, parted)
    scatter = np.einsum("nai,nab,nbj->ij", own, noise_of(p), own)
    scale = np.sqrt(np.diagonal(slope))
    influence = np.linalg.inv(slope / np.outer(scale, scale)) / np.outer(scale, scale)
    whole = carry @ influence
    return np.asarray(whole @ scatter @ whole.T)
