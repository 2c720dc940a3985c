r"""Second-order error of a magnetometer's calibration, joint or in two steps.

A pose of unknown attitude leaves of its six readings three equations,

.. math:: c = [\,|u|^2 - 1,\ |v|^2 - 1,\ u^T v + \sin(\mathrm{dip})\,] = 0, \quad
   u = M_a (y_a - b_a)/g,\ v = M_m (y_m - b_m)/F,  \tag{M1}

and nothing else of the 22 parameters: with :math:`J = \partial c/\partial\theta` and
:math:`D = \partial c/\partial(y_a, y_m)` the Cramer-Rao bound, attitudes unknown, is

.. math:: P = \Big(\sum_i J_i^T W_i J_i\Big)^{-1}, \quad
   W_i = (D_i \Sigma D_i^T)^{-1}.  \tag{M2}

The estimate that solves :math:`\sum_i J_i^T W_i c_i = 0` reaches it to first order; its
bias is that of second order of `simval.theory.estimating`, left out is
:math:`O(\sigma^4)`. The two-step calibration, an unweighted ellipsoid for each sensor
and then a turn, solves :math:`\sum_i \partial c_{i1}/\partial\theta_a\, c_{i1} = 0`,
the same of :math:`c_2` for the symmetric part of :math:`dM M^{-1}` and b, and of
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

The two steps see less: with w and k their own, a variance may be off by (M9), and by no
more than their second order, which is a part w of the first that the horizontal part of
the field enlarges, makes of it,

.. math:: 150\, w^2 / \cos^2(\mathrm{dip}), \tag{M11}

relative to itself, which is less for few poses.

The powers bound the growth; the factors are measured over random sensors and 10 to 100
random poses: `tests/theory/test_magnetometer_theory.py`.

All parameters together are as good as their best combination, which the noisier sensor
may bend by more than it scatters. Their normalised square may be off by 4 b, b of (E4);
up to b = `RANGE` it has the law of chi-square.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

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
from simval.imu.sensor import AccelerometerModel, MagnetometerModel, forms
from simval.moments import deviations
from simval.shapes import Float, Inexact
from simval.theory.calibration import in_form
from simval.theory.estimating import Block, Estimating, inverse_of, rank_of
from simval.vocabulary import Model

PARAMETERS = 22


class Problem(NamedTuple):
    """Sensors, readings and noise at the truth; readings y_a, then y_m."""

    form: Model
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
    """Check the arguments and set up the poses.

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
        msg = "a noise is 0, and then the bound is 0; give both sensors some noise"
        raise InputError(msg)
    up = turn[:, :, 2]
    along = turn @ np.array([np.cos(dip), 0.0, -np.sin(dip)])
    quiet = np.random.default_rng(0)  # draws nothing: the noise is left out
    clean = MagnetometerModel(M=iron.M, b=iron.b)
    own = AccelerometerModel(T=body.T, K=body.K, B=body.B)
    y = [own.distort(g * up, quiet), clean.distort(field * along, quiet)]
    matrix = body.matrix
    theta = np.empty(PARAMETERS)
    theta[:9] = in_form(form, body)
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
    """Check the dip of a field that determines a heading.

    Raises
    ------
    InputError
        If it is vertical, or no number.
    """
    dip = real_number("dip", value, "rad")
    if not abs(dip) < np.radians(89.9):
        msg = (
            f"`dip` is {dip:g} rad; a field shows a heading only between -1.569 "
            "and 1.569"
        )
        raise InputError(msg)
    return dip


def equations(
    p: Problem, theta: Inexact[Array, "... 22"], y: Inexact[Array, "... n 6"]
) -> Inexact[Array, "... n 3"]:
    """The three equations of each pose, eq. (M1)."""
    matrix_a = forms.matrix(p.form, theta[..., :9]) / p.g
    matrix_m = theta[..., 9:18].reshape(*theta.shape[:-1], 3, 3) / p.field
    u = (y[..., :3] - theta[..., None, 6:9]) @ matrix_a.mT
    v = (y[..., 3:] - theta[..., None, 18:21]) @ matrix_m.mT
    dot = np.sum(u * v, axis=-1) + theta[..., None, 21]
    return np.stack(
        [np.sum(u * u, axis=-1) - 1.0, np.sum(v * v, axis=-1) - 1.0, dot], axis=-1
    )


def equations_of(p: Problem) -> Estimating:
    """The equations of the weighted fit."""
    rows = partial(equations, p)
    return Estimating(blocks=(Block(rows=rows, y=p.y, sigma=p.sigma),), theta=p.theta)


VARIANCE_NEXT = 10.0  # of eq. (M9), measured
BIAS_NEXT = 10.0  # of eq. (M10), measured
RECIPE_NEXT = 150.0  # of eq. (M11), measured: 118 with 12 poses, below 32 with more
SQUARE_NEXT = 4.0  # of eq. (E4), measured
RANGE = 0.25  # of eq. (E4): the ellipsoid then holds 2 % less of the trials
EVEN = 2.4  # w sqrt(n) / sigma of many poses, for any dip from 0 to 89 degrees


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
        First-order covariance of the two-step calibration, eq. (M8), (22, 22).
    bias_remainder : Array
        What the bias may be off by, eq. (M10), (22,).
    variance_remainder : float
        What a variance may be off by relative to itself, eq. (M9).
    recipe_remainder : float
        The same of the two-step calibration, eqs. (M9), (M11).
    bent : float
        What the second order adds to the normalised square of all errors, eq. (E4).
    """

    names: tuple[str, ...]
    bias: Float[Array, "22"]
    covariance: Float[Array, "22 22"]
    recipe: Float[Array, "22 22"]
    bias_remainder: Float[Array, "22"]
    variance_remainder: float
    recipe_remainder: float
    bent: float

    @property
    def sd(self) -> Float[Array, "22"]:
        """Standard deviation of each parameter, (22,)."""
        return deviations(self.covariance)


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
    form: Model = "triangular",
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
        Bias, covariance (the bound), and the two-step covariance.

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
    estimate = equations_of(problem)
    information = estimate.information.sum(axis=0)
    rank = rank_of(information)
    if rank < PARAMETERS:
        msg = (
            f"the {len(problem.y)} poses have rank {rank} of {PARAMETERS}, so "
            "they do not determine all parameters; turn and tilt to more sides"
        )
        raise GeometryError(msg)
    covariance = inverse_of(information)
    to_dip = np.ones(PARAMETERS)
    to_dip[-1] = 1.0 / np.cos(np.arcsin(problem.theta[-1]))
    bias = estimate.bias.copy()
    # arcsin is curved: half its second derivative times the variance
    bias[-1] += 0.5 * np.tan(dip) * to_dip[-1] * covariance[-1, -1]
    sd, count = deviations(covariance), len(problem.y)
    noise = float(np.max(problem.sigma / problem.size))
    u, carry = (noise / np.cos(dip)) ** 2, _natural(problem)
    recipe = _recipe(problem, estimate)
    worst, of_recipe = (
        float(np.max(np.diagonal(carry @ C @ carry.T))) for C in (covariance, recipe)
    )
    k, of_steps = (
        max(1.0, (w2 * count) ** 0.5 / noise / EVEN) for w2 in (worst, of_recipe)
    )
    both = np.outer(to_dip, to_dip)
    return MagnetometerMoments(
        names=(
            *(f"acc_{x}" if x in NAMES else x for x in forms.names(problem.form)),
            *NAMES,
        ),
        bias=bias * to_dip,
        covariance=covariance * both,
        recipe=recipe * both,
        bias_remainder=BIAS_NEXT * k**6 * u**1.5 * np.sqrt(count) * sd * to_dip,
        variance_remainder=VARIANCE_NEXT * k**4 * u,
        recipe_remainder=min(
            RECIPE_NEXT * of_recipe / np.cos(dip) ** 2, VARIANCE_NEXT * of_steps**4 * u
        ),
        bent=estimate.bent,
    )


NAMES = (
    *(f"M_{row}{column}" for row in "xyz" for column in "xyz"),
    *(f"b_{axis}" for axis in "xyz"),
    "dip",
)


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


def _recipe(p: Problem, estimate: Estimating) -> Float[Array, "22 22"]:
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
    parted = estimate.jacobians[0] @ carry
    own = np.zeros_like(parted)  # what each equation is made least in
    stages = (slice(0, 9), slice(9, 18), slice(18, 22))
    for equation, part in enumerate(stages):
        own[:, equation, part] = parted[:, equation, part]
    slope = np.einsum("nai,naj->ij", own, parted)
    scatter = np.einsum("nai,nab,nbj->ij", own, estimate.noises[0], own)
    scale = np.sqrt(np.diagonal(slope))
    influence = np.linalg.inv(slope / np.outer(scale, scale)) / np.outer(scale, scale)
    whole = carry @ influence
    return whole @ scatter @ whole.T
