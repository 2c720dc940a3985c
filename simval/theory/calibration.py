r"""First- and second-order moments of a calibration error, and the bound on it.

A reading is :math:`y = x + B + n`, :math:`M x = a` the true force, :math:`|a| = g`,
:math:`n \sim N(0, \sigma^2 I)`; the direction of each :math:`a` is unknown. With
:math:`c = |M(y-B)|^2/g^2 - 1` and :math:`d = \partial c/\partial\theta`, every
residual's estimate solves :math:`\sum_i \psi_i = 0`,

.. math:: \psi = a\, c\, d + c^2\, b,  \tag{K1}

up to terms that vanish faster than :math:`c^2`:

========= ================ ======================================
residual  a                b
========= ================ ======================================
squared   1                0
norm      1                :math:`-\tfrac34 d`
weighted  :math:`1/4q`     0
sampson   :math:`1/4q`     :math:`-\partial q/\partial\theta / 8q^2`
adjusted  1                0, and the mean of the noise taken out
========= ================ ======================================

weighted and sampson both multiplied by :math:`(\sigma_{\min}/\sigma_i)^2`, the weight
of a pose whose noise is known, and
:math:`q = |\partial c/\partial y|^2/4`. Expanding (K1) to second order in the noise
gives the covariance, left out is :math:`O(\sigma^4)`, and the bias, also to
:math:`O(\sigma^4)`. Eliminating the unknown directions from the Fisher information
leaves one equation for each pose, and the Cramer-Rao bound

.. math:: \sigma^2 (J^T W J)^{-1}, \quad J_i = d_i, \quad W_{ii} = 1/4q_i. \tag{K2}

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

**The error of one draw of noise, to second order.** The estimating equation (K1),
solved in powers of the noise :math:`n_i` of each pose and not of its mean. With
:math:`H = \sum_i a_i d_i d_i^T` and subscripts for derivatives at the truth,

.. math::
   \delta_1 = -H^{-1} \sum_i a_i d_i\, c_{y,i} n_i, \qquad
   c_1 = c_y n + d^T \delta_1  \tag{K5}

.. math::
   \delta_2 = -H^{-1} \sum_i \big[a\,d\,c_2 + a\,c_1 d_1 + a_1 c_1 d + c_1^2 b\big],
   \tag{K6}

:math:`c_2 = \tfrac12 n^T c_{yy} n + n^T d_y^T \delta_1 + \tfrac12 \delta_1^T d_\theta
\delta_1`, :math:`d_1 = d_y n + d_\theta \delta_1`,
:math:`a_1 = a_y n + a_\theta \delta_1`. The first is linear in the noise, the second a
quadratic form, and left out is the third order. What `adjusted` takes out of its
moments is a constant, which is not in (K6).

A use that must not depend on theory being right, such as a control variate, takes the
means from the forms themselves: `Expansion.slope` and `Expansion.mean_second`.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from simval.arguments import choice, instance
from simval.arrays import Array, ReadOnly, noise_levels, positive_number
from simval.errors import GeometryError
from simval.geometry import normalize
from simval.poses import PARAMETERS, observability, one_set
from simval.sensor import AccelerometerModel, forms
from simval.shapes import Float

RESIDUALS = ("squared", "norm", "weighted", "sampson", "adjusted")
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
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def sd_remainder(self) -> Float[Array, "9"]:
        """What a standard deviation may be off by, half of eq. (K4), (9,)."""
        return self.sd * (self.variance_remainder / 2.0)

    @property
    def efficiency(self) -> Float[Array, "9"]:
        """Bound over variance of each parameter, (9,); at most 1."""
        return np.diagonal(self.cramer_rao) / np.diagonal(self.covariance)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Geometry:
    # c and q of each pose at the truth, and their derivatives (c itself is 0)
    d: Array  # dc/dtheta, (n, 9)
    q: Array  # (n,)
    turn: Array  # sum over k of c_k d2c/dtheta dy_k, (n, 9): twice dq/dtheta
    q_along: Array  # sum over k of c_k q_k, (n,)
    bend: Array  # d2c/dtheta2, (n, 9, 9)
    laplacian: float  # sum over k of c_kk


def calibration_moments(
    model: AccelerometerModel,
    directions: Any,
    g: float = 9.80665,
    noise_std: Any = None,
    residual: str = "squared",
    *,
    form: str = "triangular",
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
    found = observability(u)
    if found.rank < PARAMETERS:
        helps = ", ".join(f"{x:.2f}" for x in found.next_direction)
        msg = (
            f"the {len(u)} directions have rank {found.rank} of {PARAMETERS}; nothing "
            f"can be predicted for what they cannot observe: add ({helps})"
        )
        raise GeometryError(msg)
    x = np.linalg.solve(model.matrix, g * u.T).T
    theta = forms.from_gram(form, model.matrix.T @ model.matrix, model.B)
    # parameters in units in which the columns of J have unit length: raw counts and
    # m/s^2 then look the same to the linear algebra
    geometry = _geometry(form, theta, x, g)
    unit = 1.0 / np.linalg.norm(geometry.d, axis=0)
    scaled = _scaled(geometry, unit)
    covariance, bias = _moments(scaled, sigma, residual)
    weight = 1.0 / (4.0 * scaled.q * np.maximum(sigma, np.finfo(float).tiny) ** 2)
    information = (scaled.d * (weight / weight.max())[:, None]).T @ scaled.d
    bound = np.linalg.inv(information) / weight.max()
    size = np.outer(unit, unit)
    scale = np.linalg.norm(model.matrix, axis=1)
    noise = float((sigma.max() * scale.max() / g) ** 2)
    worse = max(1.0, found.condition / EVEN)
    return CalibrationMoments(
        names=forms.names(form),
        bias=bias * unit,
        covariance=covariance * size,
        cramer_rao=bound * size,
        bias_remainder=BIAS_NEXT * worse**7 * noise**2 * _natural_sizes(form, scale, g),
        variance_remainder=VARIANCE_NEXT * worse**4 * noise,
    )


def _natural_sizes(form: str, scale: Array, g: float) -> Array:
    # size s of the nine parameters, eq. (K3)
    first = np.full(6, scale.max())
    if form != "symmetric":
        first = np.concatenate([np.ones(3), scale])
    return np.concatenate([first, g / scale])


def _geometry(form: str, theta: Array, x: Array, g: float) -> _Geometry:
    # exact derivatives of c = x'Ax - 1 with x = y - B and A = M'M / g^2
    m = forms.matrix(form, theta)
    first = forms.matrix_derivatives(form, theta)
    second = forms.matrix_second_derivatives(form)
    a = m.T @ m / g**2
    half = np.einsum("jrk,rl->jkl", first, m) / g**2
    da = half + np.swapaxes(half, -1, -2)
    half = np.einsum("jirk,rl->jikl", second, m)
    half = (half + np.einsum("jrk,irl->jikl", first, first)) / g**2
    dda = half + np.swapaxes(half, -1, -2)
    ax = x @ a
    dax = np.einsum("jkl,nl->njk", da, x)
    count = len(x)
    bend = np.zeros((count, 9, 9))
    bend[:, :6, :6] = np.einsum("jikl,nk,nl->nji", dda, x, x)
    bend[:, :6, 6:] = -2.0 * dax
    bend[:, 6:, :6] = -2.0 * np.swapaxes(dax, -1, -2)
    bend[:, 6:, 6:] = 2.0 * a
    aax = ax @ a
    # c_k = 2 (Ax)_k, d2c/dtheta dy_k = 2 (dA x)_k or -2 A_k, q_k = 2 (AAx)_k
    turn = np.concatenate([4.0 * np.einsum("njk,nk->nj", dax, ax), -4.0 * aax], axis=-1)
    return _Geometry(
        d=np.concatenate([np.einsum("njk,nk->nj", dax, x), -2.0 * ax], axis=-1),
        q=np.sum(ax * ax, axis=-1),
        turn=turn,
        q_along=4.0 * np.sum(ax * aax, axis=-1),
        bend=bend,
        laplacian=2.0 * float(np.trace(a)),
    )


def _scaled(p: _Geometry, unit: Array) -> _Geometry:
    bend = p.bend * np.outer(unit, unit)
    return replace(p, d=p.d * unit, turn=p.turn * unit, bend=bend)


def _shares(sigma: Float[Array, " n"]) -> Float[Array, " n"]:
    # weight of each pose by its noise, over that of the best one
    alike = sigma == sigma.min()
    return np.where(alike, 1.0, sigma.min() / np.where(alike, 1.0, sigma)) ** 2


def _weights(
    p: _Geometry, residual: str, shares: Float[Array, " n"]
) -> tuple[Array, Array, Array, Array]:
    """A of eq. (K1), its derivatives by q and by the parameters, and b."""
    weighted = residual in ("weighted", "sampson")
    a = 0.25 / p.q * shares if weighted else np.ones_like(p.q)
    by_q = -a / p.q if weighted else np.zeros_like(p.q)
    by_theta = by_q[:, None] * (0.5 * p.turn)
    factor = {"norm": -0.75 * p.d, "sampson": 0.5 * by_theta}
    return a, by_q, by_theta, factor.get(residual, np.zeros_like(p.d))


def _moments(
    p: _Geometry, sigma: Float[Array, " n"], residual: str
) -> tuple[Float[Array, "9 9"], Float[Array, "9"]]:
    # first-order covariance and second-order bias of the solution of eq. (K1)
    a, slope, a_theta, b = _weights(p, residual, _shares(sigma))
    a_along = slope * p.q_along
    s2, steep = sigma**2, 4.0 * p.q  # steep: sum over k of c_k^2
    inverse = np.linalg.inv((p.d * a[:, None]).T @ p.d)
    back = p.d @ inverse  # rows p_i = H^-1 d_i
    covariance = (back * (s2 * a * a * steep)[:, None]).T @ back
    reach = np.sum(back * p.d, axis=-1)
    bent = np.einsum("nij,nj->ni", p.bend, back)
    own = (
        a[:, None] * p.turn
        + (0.5 * p.laplacian * a + a_along)[:, None] * p.d
        + steep[:, None] * b
    )
    if residual == "adjusted":  # its moments have this mean taken out
        own = np.zeros_like(own)
    cross = -a[:, None] * (
        a[:, None]
        * (
            np.sum(back * p.turn, axis=-1)[:, None] * p.d
            + reach[:, None] * p.turn
            + steep[:, None] * bent
        )
        + (a_along * reach + steep * np.sum(back * a_theta, axis=-1))[:, None] * p.d
        + 2.0 * (steep * reach)[:, None] * b
    )
    spread = p.d @ covariance
    curved = (
        a[:, None]
        * (
            0.5 * np.einsum("nij,ij->n", p.bend, covariance)[:, None] * p.d
            + np.einsum("nij,nj->ni", p.bend, spread)
        )
        + np.sum(spread * a_theta, axis=-1)[:, None] * p.d
        + np.sum(spread * p.d, axis=-1)[:, None] * b
    )
    total = (s2[:, None] * (own + cross) + curved).sum(axis=0)
    return covariance, -inverse @ total


@dataclass(frozen=True, kw_only=True, eq=False)
class Expansion:
    """Equations (K5) and (K6) of one sensor, its poses and a residual."""

    inverse: Float[Array, "9 9"]  # of H
    d: Float[Array, "n 9"]
    along: Float[Array, "n 3"]  # dc/dy
    cross: Float[Array, "n 9 3"]  # d2c/dtheta dy
    bend: Float[Array, "n 9 9"]  # d2c/dtheta2
    quadric: Float[Array, "3 3"]  # half of d2c/dy2, the same in every pose
    a: Float[Array, " n"]
    a_along: Float[Array, "n 3"]
    a_turn: Float[Array, "n 9"]  # da/dtheta
    b: Float[Array, "n 9"]

    @cached_property
    def slope(self) -> Float[Array, "9 d"]:
        """Of the first order, by the noise of each axis of each pose in turn."""
        each = (self.a[:, None] * self.d)[:, :, None] * self.along[:, None, :]
        return -self.inverse @ each.transpose(1, 0, 2).reshape(9, -1)

    @cached_property
    def mean_second(self) -> Float[Array, "9"]:
        """Mean of the second order for noise of deviation 1, the trace of its form."""
        unit = np.eye(3 * len(self.d)).reshape(-1, len(self.d), 3)
        return self.second(unit).sum(axis=0)

    def first(self, noise: Float[Array, "t n 3"]) -> Float[Array, "t 9"]:
        """First order of each draw, eq. (K5)."""
        return noise.reshape(len(noise), -1) @ self.slope.T

    def second(self, noise: Float[Array, "t n 3"]) -> Float[Array, "t 9"]:
        """Second order of each draw, eq. (K6)."""
        first = self.first(noise)
        by_pose = np.swapaxes(noise, 0, 1)  # (n, t, 3): a matrix product for each pose
        c1 = (by_pose @ self.along[:, :, None])[..., 0] + self.d @ first.T
        turned = by_pose @ np.swapaxes(self.cross, 1, 2)
        bent = first @ np.swapaxes(self.bend, 1, 2)
        c2 = np.vecdot(by_pose @ self.quadric, by_pose)
        c2 += np.vecdot(turned + 0.5 * bent, first)
        a1 = (by_pose @ self.a_along[:, :, None])[..., 0] + self.a_turn @ first.T
        total = (self.a[:, None] * c2 + a1 * c1).T @ self.d + (c1**2).T @ self.b
        change = (self.a[:, None] * c1)[..., None] * (turned + bent)
        return -(total + change.sum(axis=0)) @ self.inverse


def calibration_expansion(
    model: AccelerometerModel,
    directions: Float[Array, "n 3"],
    g: float,
    residual: str = "squared",
) -> Expansion:
    """Expansion of a calibration's error, triangular form, poses of equal noise."""
    g = positive_number("g", g, "m/s^2")
    u = normalize(one_set("directions", directions))
    x = np.linalg.solve(model.matrix, g * u.T).T
    theta = forms.from_gram("triangular", model.matrix.T @ model.matrix, model.B)
    p = _geometry("triangular", theta, x, g)
    a, slope, a_turn, b = _weights(p, residual, np.ones_like(p.q))
    quadric = model.matrix.T @ model.matrix / g**2
    ax = x @ quadric
    first = forms.matrix_derivatives("triangular", theta)
    half = np.einsum("jrk,rl->jkl", first, forms.matrix("triangular", theta)) / g**2
    slopes = np.einsum("jkl,nl->njk", half + np.swapaxes(half, -1, -2), x)
    fixed = np.broadcast_to(-2.0 * quadric, (len(x), 3, 3))
    return Expansion(
        inverse=np.linalg.inv((p.d * a[:, None]).T @ p.d),
        d=p.d,
        along=2.0 * ax,
        cross=np.concatenate([2.0 * slopes, fixed], axis=1),
        bend=p.bend,
        quadric=quadric,
        a=a,
        a_along=slope[:, None] * (2.0 * ax @ quadric),
        a_turn=a_turn,
        b=b,
    )
