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

Derivatives of (M1) are complex steps, exact to rounding. The powers bound the growth;
the factors are measured over random sensors and 10 to 100
random poses: `tests/theory/test_magnetometer_theory.py`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arguments import choice, instance
from simval.arrays import (
    Array,
    ReadOnly,
    finite_array,
    noise_levels,
    positive_number,
    real_number,
)
from simval.errors import GeometryError, InputError
from simval.geometry import attitude_matrix
from simval.sensor import AccelerometerModel, MagnetometerModel, forms
from simval.shapes import Float, Inexact

PARAMETERS = 22
_TINY = 1e-30  # complex step: exact to rounding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """Sensors and readings at the truth, and the noise; readings y_a, then y_m."""

    form: str
    g: float
    field: float
    theta: Float[Array, "22"]
    y: Float[Array, "n 6"]
    sigma: Float[Array, "n 6"]
    size: Float[Array, "6"]  # of a reading of gravity or of the field, raw units


def problem_of(
    accelerometer: Any,
    magnetometer: Any,
    attitudes: Any,
    dip: Any,
    accelerometer_std: Any,
    magnetometer_std: Any,
    *,
    g: Any,
    field: Any,
    form: Any,
) -> Problem:
    """Check the arguments and lay out the poses.

    Raises
    ------
    InputError
        If an argument is not usable.
    """
    body = instance("accelerometer", accelerometer, AccelerometerModel)
    iron = instance("magnetometer", magnetometer, MagnetometerModel)
    g, field = positive_number("g", g, "m/s^2"), positive_number("field", field, "")
    form = choice("form", form, forms.MODELS)
    dip = dip_angle(dip)
    q = finite_array("attitudes", attitudes, (None, 4))
    if q.ndim != 2 or len(q) == 0:
        msg = f"`attitudes` has shape {q.shape}; give those of one set, (n, 4)"
        raise InputError(msg)
    count, turn = len(q), attitude_matrix(q)
    noise = [
        noise_levels(name, value, count)
        for name, value in (
            ("accelerometer_std", accelerometer_std),
            ("magnetometer_std", magnetometer_std),
        )
    ]
    if not all(np.all(each > 0.0) for each in noise):
        msg = "a noise is 0, and the bound is then 0; give both sensors some noise"
        raise InputError(msg)
    up = turn[:, :, 2]
    along = turn @ np.array([np.cos(dip), 0.0, -np.sin(dip)])
    quiet = np.random.default_rng(0)  # draws nothing: the noise is left out
    clean = MagnetometerModel(M=iron.M, b=iron.b)
    own = AccelerometerModel(T=body.T, K=body.K, B=body.B)
    y = [own.distort(g * up, quiet), clean.distort(field * along, quiet)]
    matrix = body.matrix
    theta = np.empty(PARAMETERS)
    theta[:9] = forms.from_gram(form, matrix.T @ matrix, body.B)
    # M_m refers to the axes of the accelerometer's form
    turned = forms.matrix(form, theta[:9]) @ np.linalg.inv(matrix)
    theta[9:18] = (turned @ iron.M).ravel()
    theta[18:21], theta[21] = iron.b, np.sin(dip)
    return Problem(
        form=form, g=g, field=field, theta=theta, y=np.concatenate(y, axis=1),
        sigma=np.repeat(np.stack(noise, axis=1), 3, axis=1),
        size=np.repeat(
            [g / np.linalg.norm(matrix, 2), field / np.linalg.norm(iron.M, 2)], 3
        ),
    )  # fmt: skip


def dip_angle(value: Any) -> float:
    """Require the angle of a field that tells a heading.

    Raises
    ------
    InputError
        If it is vertical, or no number.
    """
    dip = real_number("dip", value, "rad")
    if not abs(dip) < np.radians(89.9):
        msg = f"`dip` is {dip:g} rad; between -1.569 and 1.569 a field tells a heading"
        raise InputError(msg)
    return dip


def equations(
    p: Problem, theta: Inexact[Array, "... 22"], y: Inexact[Array, "... n 6"]
) -> Inexact[Array, "... n 3"]:
    """The three equations of each pose, eq. (M1)."""
    matrix_a = forms.matrix(p.form, theta[..., :9]) / p.g
    matrix_m = theta[..., 9:18].reshape(*theta.shape[:-1], 3, 3) / p.field
    u = (y[..., :3] - theta[..., None, 6:9]) @ np.swapaxes(matrix_a, -1, -2)
    v = (y[..., 3:] - theta[..., None, 18:21]) @ np.swapaxes(matrix_m, -1, -2)
    dot = np.sum(u * v, axis=-1) + theta[..., None, 21]
    return np.stack(
        [np.sum(u * u, axis=-1) - 1.0, np.sum(v * v, axis=-1) - 1.0, dot], axis=-1
    )


def slopes_of(p: Problem, theta: Array, y: Array) -> Array:
    """Derivatives dc/dtheta, (..., n, 3, 22)."""
    columns = [
        equations(p, theta + 1j * _TINY * e, y).imag / _TINY for e in np.eye(PARAMETERS)
    ]
    return np.stack(columns, axis=-1)


def reach_of(p: Problem, theta: Any, y: Array) -> Array:
    """Derivatives dc/dy by a pose's own readings, (..., n, 3, 6)."""
    columns = [equations(p, theta, y + 1j * _TINY * e).imag / _TINY for e in np.eye(6)]
    return np.stack(columns, axis=-1)


def along_of(p: Problem, at: tuple[Array, Array], way: tuple[Array, Array]) -> Array:
    """Derivative of c along a way of the parameters and readings, (..., n, 3)."""
    theta, y = (here + 1j * _TINY * step for here, step in zip(at, way, strict=True))
    return equations(p, theta, y).imag / _TINY


def jacobian(p: Problem) -> Float[Array, "n 3 22"]:
    """Derivatives dc/dtheta at the truth."""
    return slopes_of(p, p.theta, p.y)


def noise_of(p: Problem) -> Float[Array, "n 3 3"]:
    """Covariance of the three equations of each pose at the truth."""
    reach = reach_of(p, p.theta, p.y) * p.sigma[:, None, :]
    return reach @ np.swapaxes(reach, -1, -2)


def weights_of(p: Problem) -> Float[Array, "n 3 3"]:
    """Inverse of that covariance."""
    return np.linalg.inv(noise_of(p))


VARIANCE_NEXT = 10.0  # of eq. (M9), measured
BIAS_NEXT = 10.0  # of eq. (M10), measured
EVEN = 2.4  # w sqrt(n) / sigma of many poses, for any dip from 0 to 89 degrees
_STEP = 1e-3  # of a reading's size: leaves 1e-10 of the bias at a dip of 85 degrees
_FIRST = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}  # difference of fourth order
_RANK = 1e-10  # of the greatest singular value, columns of equal length


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MagnetometerMoments(ReadOnly):
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
        names=(
            *(f"acc_{x}" if x in NAMES else x for x in forms.names(problem.form)),
            *NAMES,
        ),
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
