r"""Residuals of an accelerometer's poses, and the moments they are computed from.

**The residual as a quadric in the reading, and its derivatives.**

With :math:`A = M^T M` the residual of all three derivations is

.. math:: c(y) = |M (y - b)|^2 - 1 = m(y)^T v(\theta)  \tag{Q1}

in units where gravity is 1: :math:`m` are the ten monomials of the reading,
:math:`v` ten coefficients. So every sum over poses of products of :math:`c` and its
derivatives is a form in the moment matrix

.. math:: G = \sum_k w_k\, m_k m_k^T:  \tag{Q2}

one pass over the data, then each iteration costs the same for any number of samples.
The weighted-distance residual also needs :math:`q(y) = |M^T M (y - b)|^2`, the quadric
of :math:`A^2`, without the constant.

**The residuals: what each makes of the quadrics c and q of one pose.**

In units where gravity is 1, with :math:`c = |M(y-b)|^2 - 1` and
:math:`q = |M^T M (y-b)|^2`, half the cost of a pose is

- ``squared``: :math:`c^2/2`;  ``adjusted``: the same with the moments of the noise
  taken out of the moment matrix;
- ``norm``: :math:`(\sqrt{1+c} - 1)^2/2`;
- ``weighted``: :math:`w c^2/2`, :math:`w = 1/4q` held fixed within a step, so that
  the estimate solves :math:`\sum w c\, \partial c = 0`;
- ``sampson``: :math:`c^2/8q`, differentiated in full: the squared first-order
  distance from the reading to the ellipsoid.

Where the noise of each pose is known, weighted and sampson multiply the cost of a pose
by :math:`(\sigma_{\min}/\sigma_k)^2`, so that they stay at the Cramer-Rao bound; the
others are those of their sources, which hold all poses for equally good.

Each is given by its slopes by (c, q) and by the entries of the 2 x 2 curvature:
the product of first derivatives (Gauss-Newton) or the full one (Newton).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from simval import vocabulary
from simval.arrays import Array, outer
from simval.imu.sensor import forms
from simval.shapes import Float

CHUNK = 1 << 15  # samples of one pass; 2.6 MB of monomials
FIRST, SECOND = np.array(
    [[0, 1, 2, 0, 0, 1, 0, 1, 2, 3], [0, 1, 2, 1, 2, 2, 3, 3, 3, 3]]
)
"""Whose product each monomial is: of x, y, z and 1."""
_PLACES = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])
"""The first six in a symmetric matrix."""
READING = slice(6, 9)
"""The reading itself among its monomials."""
_HALVES = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])


def monomials(z: Float[Array, "n 3"]) -> Float[Array, "n 10"]:
    """The ten monomials xx yy zz xy xz yz x y z 1 of each reading."""
    return monomial_rows(z[:, None])[..., 0]


def monomial_slopes() -> Float[Array, "9 3 4"]:
    """Derivatives of the first nine monomials by x, y and z, over x, y, z and 1."""
    factors = np.eye(4)[[FIRST[:9], SECOND[:9]]]
    slopes = factors[0, :, :3, None] * factors[1, :, None]
    return slopes + factors[1, :, :3, None] * factors[0, :, None]


def symmetric(entries: Float[Array, "... 6"]) -> Float[Array, "... 3 3"]:
    """Symmetric matrix from six entries in the order of the monomials."""
    return entries.take(_PLACES, axis=-1)


def quadratic(p: Float[Array, "... m"]) -> Float[Array, "... 3 3"]:
    """Symmetric matrix of the quadratic part, from coefficients of the monomials."""
    return symmetric(p[..., :6] * _HALVES)


def moment_matrix(
    m: Float[Array, "t 10 n"], weights: Float[Array, "t n"] | None = None
) -> Float[Array, "t 10 10"]:
    """Moment matrix G of the monomials, eq. (Q2)."""
    right = m if weights is None else m * weights[:, None]
    return m @ right.mT


def monomial_rows(z: Float[Array, "t n 3"]) -> Float[Array, "t 10 n"]:
    """The `monomials` with one row each, so that poses are contiguous in memory."""
    x = np.ascontiguousarray(z.mT)
    result = np.empty((len(x), 10, x.shape[-1]))
    np.multiply(x, x, out=result[:, :3])
    for place in (3, 4, 5):
        np.multiply(x[:, FIRST[place]], x[:, SECOND[place]], out=result[:, place])
    result[:, 6:9] = x
    result[:, 9] = 1.0
    return result


def unbiased_moment_matrix(
    z: Float[Array, "t n 3"], noise_std: Float[Array, "t n"]
) -> Float[Array, "t 10 10"]:
    """Moment matrix whose mean is that of the noise-free readings.

    A power of a reading with Gaussian noise is replaced by the Hermite polynomial
    whose mean is the power of the true value: x, x^2 - s^2, x^3 - 3 s^2 x,
    x^4 - 6 s^2 x^2 + 3 s^4.
    """
    means = np.zeros((len(z), 5, 5, 5))  # of x^a y^b z^c, summed
    for start in range(0, z.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        r, s2 = np.ascontiguousarray(z[:, part].mT), noise_std[:, None, part] ** 2
        square = r * r
        powers = (
            np.ones_like(r),
            r,
            square - s2,
            r * (square - 3.0 * s2),
            square * (square - 6.0 * s2) + 3.0 * s2 * s2,
        )
        for a, b in np.ndindex(5, 5):
            pair = powers[a][:, 0] * powers[b][:, 1]
            for c in range(5 - a - b):
                means[:, a, b, c] += np.vecdot(pair, powers[c][:, 2])
    exponents = (np.eye(4, dtype=int)[FIRST] + np.eye(4, dtype=int)[SECOND])[:, :3]
    a, b, c = np.moveaxis(exponents[:, None] + exponents, -1, 0)
    return np.ascontiguousarray(means[:, a, b, c])


class Quadric(NamedTuple):
    """Coefficients of a quadric, with their derivatives by the nine parameters."""

    gram: Float[Array, "t 3 3"]  # the quadratic part
    slopes: Float[Array, "t 6 3 3"]  # its derivatives by the first six parameters
    bias: Float[Array, "t 3"]  # the centre
    values: Float[Array, "t 10"]  # the ten coefficients v


def residual_quadric(model: str, theta: Float[Array, "t 9"]) -> Quadric:
    """The quadric c of eq. (Q1)."""
    m = forms.matrix(model, theta)
    gram = m.mT @ m
    half = forms.matrix_derivatives(model, theta).mT @ m[:, None]
    return _quadric(gram, half + half.mT, theta[:, 6:], constant=-1.0)


def distance_quadric(residual: Quadric) -> Quadric:
    """The quadric q = |M'M (y - b)|^2, a quarter of the squared gradient of c."""
    half = residual.slopes @ residual.gram[:, None]
    slopes = half + half.mT
    gram = residual.gram @ residual.gram
    return _quadric(gram, slopes, residual.bias, constant=0.0)


def _quadric(
    gram: Float[Array, "t 3 3"],
    slopes: Float[Array, "t 6 3 3"],
    bias: Float[Array, "t 3"],
    *,
    constant: float,
) -> Quadric:
    linear = np.matvec(gram, bias)
    values = np.empty((gram.shape[0], 10))
    values[:, :6] = gram[:, FIRST[:6], SECOND[:6]]
    values[:, 3:6] *= 2.0
    values[:, 6:9] = -2.0 * linear
    values[:, 9] = np.vecdot(bias, linear) + constant
    return Quadric(gram=gram, slopes=slopes, bias=bias, values=values)


def residual_values(
    model: str, theta: Float[Array, "t 9"], m: Float[Array, "t 10 n"]
) -> tuple[Float[Array, "t n"], Float[Array, "t n"]]:
    """The quadrics c and q of each reading, without derivatives."""
    # both vectors, M (y - b) and M'M (y - b), are linear in the last four monomials
    both = np.empty((len(m), 2, 3, 4))
    both[:, 0, :, :3] = forms.matrix(model, theta)
    both[:, 1, :, :3] = both[:, 0, :, :3].mT @ both[:, 0, :, :3]
    both[..., 3] = -np.matvec(both[..., :3], theta[:, None, 6:])
    vectors = (both.reshape(-1, 6, 4) @ m[:, 6:]).reshape(-1, 2, 3, m.shape[2])
    squares = np.einsum("tvin,tvin->tvn", vectors, vectors)
    return squares[:, 0] - 1.0, squares[:, 1]


def value_derivatives(quadric: Quadric) -> Float[Array, "t 10 9"]:
    """Derivatives of the ten coefficients by the nine parameters."""
    result = np.zeros((quadric.gram.shape[0], 10, 9))
    slopes, bias = quadric.slopes, quadric.bias
    result[:, :6, :6] = slopes[:, :, FIRST[:6], SECOND[:6]].mT
    result[:, 3:6, :6] *= 2.0
    linear = np.matvec(slopes, bias[:, None])  # (t, 6, 3)
    result[:, 6:9, :6] = -2.0 * linear.mT
    result[:, 9, :6] = np.vecdot(linear, bias[:, None])
    result[:, 6:9, 6:] = -2.0 * quadric.gram
    result[:, 9, 6:] = 2.0 * np.matvec(quadric.gram, bias)
    return result


def curvature(
    quadric: Quadric, seconds: Float[Array, "t 6 6 3 3"], weights: Float[Array, "t 10"]
) -> Float[Array, "t 9 9"]:
    r"""Weighted sum of the second derivatives of the ten coefficients.

    With the weights folded into a symmetric matrix :math:`S` (quadratic part), a
    vector :math:`l` and a constant :math:`s_0`, the sum :math:`s^T v` is

    .. math:: \mathrm{tr}(A W) + \mathrm{const}, \quad
       W = S - b l^T - l b^T + s_0 b b^T  \tag{Q3}

    so the derivatives are tr(d2A W) by two parameters of A, -2 dA (l - s_0 b) by
    one of them and b, and 2 s_0 A by b twice.
    """
    bias, linear, constant = quadric.bias, weights[:, 6:9], weights[:, 9]
    w = symmetric(weights[:, :6])
    crossed = outer(bias, linear)
    w -= crossed + crossed.mT
    w += outer(constant[:, None] * bias, bias)
    rest = linear - constant[:, None] * bias
    result = np.empty((bias.shape[0], 9, 9))
    result[:, :6, :6] = (seconds * w[:, None, None]).sum(axis=(-2, -1))
    mixed = -2.0 * np.matvec(quadric.slopes, rest[:, None])
    result[:, :6, 6:] = mixed
    result[:, 6:, :6] = mixed.mT
    result[:, 6:, 6:] = 2.0 * constant[:, None, None] * quadric.gram
    return result


def residual_seconds(
    model: str, theta: Float[Array, "t 9"]
) -> Float[Array, "t 6 6 3 3"]:
    """Second derivatives of A = M'M by the first six parameters."""
    m = forms.matrix(model, theta)[:, None, None]
    first = forms.matrix_derivatives(model, theta)
    bent = forms.matrix_second_derivatives(model).mT @ m
    crossed = first.mT[:, :, None] @ first[:, None]
    half = bent + crossed
    return half + half.mT


def distance_seconds(
    residual: Quadric, seconds: Float[Array, "t 6 6 3 3"]
) -> Float[Array, "t 6 6 3 3"]:
    """Second derivatives of A^2 by the first six parameters."""
    half = seconds @ residual.gram[:, None, None]
    half += residual.slopes[:, :, None] @ residual.slopes[:, None]
    return half + half.mT


RESIDUALS = vocabulary.RESIDUALS
WEIGHTED = ("weighted", "sampson")  # by the variance of the residual


def noise_shares(
    residual: str, sigma: Float[Array, "... n"] | None
) -> Float[Array, "... n"] | None:
    """Weight of each pose by its noise, relative to the quietest pose of its set."""
    if sigma is None or residual not in WEIGHTED or np.all(sigma == sigma[..., :1]):
        return None
    return (sigma.min(axis=-1, keepdims=True) / sigma) ** 2


class Slopes(NamedTuple):
    """Value, slopes and curvature by (c, q) of half the cost of each pose."""

    cost: Float[Array, "t n"]  # half the cost of each pose
    # c, q: slopes
    c: Float[Array, "t n"]
    q: Float[Array, "t n"]
    # cc, cq, qq: curvature used in the step
    cc: Float[Array, "t n"]
    cq: Float[Array, "t n"]
    qq: Float[Array, "t n"]

    def weighted(self, shares: Float[Array, "t n"] | None) -> "Slopes":
        """The same with each pose's cost multiplied by a weight."""
        if shares is None:
            return self
        return Slopes(*(part * shares for part in self))


def norm_slopes(
    c: Float[Array, "t n"], q: Float[Array, "t n"], *, newton: bool
) -> Slopes:
    """Slopes of the norm residual |M(y - b)| - 1."""
    r = np.sqrt(np.maximum(1.0 + c, np.finfo(float).tiny))
    e = r - 1.0
    zero = np.zeros_like(c)
    curve = 0.25 / (r * r * r) if newton else 0.25 / (r * r)
    return Slopes(cost=e * e / 2, c=e / (2 * r), q=zero, cc=curve, cq=zero, qq=zero)


def sampson_slopes(
    c: Float[Array, "t n"], q: Float[Array, "t n"], *, newton: bool
) -> Slopes:
    """Slopes of the Sampson residual c / 2 sqrt(q)."""
    ratio = c / q
    cc = 0.25 / q
    cross, square = (2.0, 4.0) if newton else (1.0, 1.0)
    return Slopes(
        cost=c * ratio / 8,
        c=ratio / 4,
        q=-ratio * ratio / 8,
        cc=cc,
        cq=-cross * ratio * cc / 2,
        qq=square * ratio * ratio * cc / 4,
    )


def squared_slopes(
    c: Float[Array, "t n"], q: Float[Array, "t n"], *, newton: bool
) -> Slopes:
    """Slopes of the squared residual c, which is linear in c."""
    zero = np.zeros_like(c)
    return Slopes(cost=c * c / 2, c=c, q=zero, cc=np.ones_like(c), cq=zero, qq=zero)


SLOPES: dict[str, Callable[..., Slopes]] = {
    "squared": squared_slopes,
    "norm": norm_slopes,
    "sampson": sampson_slopes,
}


class RobustLoss(NamedTuple):
    """A robust loss, by its influence function psi(r) = r w(r)."""

    weight: Callable[[Array], Array]  # w(r) of the absolute residual over its scale
    slope: Callable[[Array], Array]  # d psi/dr
    # scale over the standard deviation of Gaussian residuals, for an efficiency of 95 %
    # on them
    tuning: float


# huber: quadratic, then linear. soft_l1: 2 (sqrt(1 + r^2) - 1), its smooth relative.
# cauchy: log(1 + r^2), which lets go of far outliers.
# Efficiencies on Gaussian residuals, by quadrature: 95.0 %, 95.4 %, 95.0 %.
LOSSES: dict[str, RobustLoss] = {
    "huber": RobustLoss(
        weight=lambda r: 1.0 / np.maximum(1.0, r),
        slope=lambda r: np.where(r < 1.0, 1.0, 0.0),
        tuning=1.345,
    ),
    "soft_l1": RobustLoss(
        weight=lambda r: 1.0 / np.sqrt(1.0 + r * r),
        slope=lambda r: (1.0 + r * r) ** -1.5,
        tuning=1.345,
    ),
    "cauchy": RobustLoss(
        weight=lambda r: 1.0 / (1.0 + r * r),
        slope=lambda r: (1.0 - r * r) / (1.0 + r * r) ** 2,
        tuning=2.385,
    ),
}
