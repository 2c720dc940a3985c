r"""Probability that the raw quaternion has the opposite sign of the truth.

It is the chance that :math:`Q = q^T\bar q = d_2^T (e \times d_1 + s\,s_1)` is
negative, a product of two Gaussian vectors. In independent standard normals
:math:`Q = |\bar q| + \sum_j (c_j \xi_j + \lambda_j \xi_j^2)`, so

.. math:: M(z) = E[e^{-zQ}] = e^{-z|\bar q|} \prod_j (1 + 2z\lambda_j)^{-1/2}
   \exp\frac{z^2 c_j^2}{2(1 + 2z\lambda_j)}, \quad
   \Pr(Q < 0) = \frac{1}{2\pi i} \int \frac{M(z)}{z}\,dz  \tag{F1}

along a vertical line right of 0, here through the saddle point: there is nothing to
resolve near a singular geometry, and a chance of 1e-300 keeps its digits.
"""

from typing import Final

import numpy as np
import scipy

from simval.arrays import Array
from simval.errors import RefusedError
from simval.geometry import cross_matrix
from simval.shapes import Float
from simval.theory.cubature import covariance_roots
from simval.theory.expansion import half_noise
from simval.theory.two_vector import TwoVectorGeometry

# y = width * sinh(t): M falls as exp(-t^2 / 2) at first and as 1 / y at least
_STEPS: Final = (0.02, 0.01)
# Of 300 random geometries at noise from 0.01 to 3, lines that end at 10 leave out 6e-12
# of a chance, at 15 and later rounding, 7e-16.
_LAST: Final = 25.0
# Half the step squares the trapezoidal rule's error: the finer one is then at rounding.
# Those geometries differ by 1e-14 at most; one that is not resolved, by `_TOLERANCE`,
# is refused.
_TOLERANCE: Final = 1e-9


def flip_probability(
    geometry: TwoVectorGeometry, noise: Float[Array, "4 3 3"] | Float[Array, "12 12"]
) -> float:
    """Probability (F1) of the opposite raw sign, for any covariances.

    Every prediction here keeps the raw sign; one who aligns the sign sample by sample
    sees another error in this share of the samples.

    Raises
    ------
    RefusedError
        If two steps along the line differ by more than 1e-9 of the chance.
    """
    linear, square = _normal_form(geometry, noise)
    size = np.linalg.norm(linear)
    if not size > 0.0 and not square.any():
        return 0.0
    if not -square.min() > 1e-14 * size:  # one of the two vectors has no noise
        return scipy.special.ndtr(-geometry.norm / size)
    values = [_line_integral(float(geometry.norm), linear, square, h) for h in _STEPS]
    if not abs(values[0] - values[1]) <= _TOLERANCE * values[1]:
        msg = (
            "two quadratures for the chance of a flipped sign differ: "
            f"{values[0]:.3e} and {values[1]:.3e}; |qbar| is "
            f"{geometry.norm:.2e}, so use another frame"
        )
        raise RefusedError(msg)
    return values[1]


def _normal_form(geometry: TwoVectorGeometry, noise: Array) -> tuple[Array, Array]:
    # c and lambda of (F1)
    C1, C2, C12 = half_noise(geometry, noise)
    e, s = geometry.q[:3], geometry.q[3]
    turn = np.hstack([cross_matrix(e), s * np.eye(3)])
    v = turn @ np.concatenate([geometry.d1, geometry.s1])
    root = scipy.linalg.block_diag(
        *covariance_roots(np.stack([C2, turn @ C1 @ turn.T]))
    )
    if C12 is not None:
        across = turn @ C12
        joint = np.block([[C2, across.T], [across, turn @ C1 @ turn.T]])
        root = covariance_roots(joint[None])[0]
    product = root[:, :3] @ root[3:] / 2.0
    square, axes = np.linalg.eigh(product + product.T)
    linear = axes.T @ (root @ np.concatenate([v, geometry.d2]))
    return linear, square


def _line_integral(norm: float, linear: Array, square: Array, step: float) -> float:
    def exponent(z: Array) -> Array:
        # logarithm of M(z) / z
        scale = 1.0 + 2.0 * z[:, None] * square
        terms = 0.5 * (z[:, None] * linear) ** 2 / scale - 0.5 * np.log(scale)
        return terms.sum(axis=1) - z * norm - np.log(z)

    edge = -0.5 / square.min()
    share = scipy.optimize.minimize_scalar(
        lambda t: exponent(np.array([edge * scipy.special.expit(t)]))[0],
        bounds=(-80.0, 30.0),
        method="bounded",
    ).x
    z = edge * scipy.special.expit(share)
    scale = 1.0 + 2.0 * z * square
    curvature = np.sum(linear**2 / scale**3 + 2.0 * (square / scale) ** 2) + z**-2
    t = np.arange(0.0, _LAST, step)
    width = curvature**-0.5
    integrand = np.exp(exponent(z + 1j * (width * np.sinh(t)))).real * np.cosh(t)
    integrand[0] *= 0.5
    return integrand.sum() * step * width / np.pi
