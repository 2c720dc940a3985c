r"""The residuals: what each makes of the quadrics c and q of one pose.

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
from dataclasses import dataclass

import numpy as np

from simval import vocabulary
from simval.arrays import Array
from simval.shapes import Float

RESIDUALS = vocabulary.RESIDUALS
WEIGHTED = ("weighted", "sampson")  # by the variance of the residual


def noise_shares(
    residual: str, sigma: Float[Array, " n"] | None
) -> Float[Array, " n"] | None:
    """Weight of each pose by its noise, over that of the best one."""
    if sigma is None or residual not in WEIGHTED or np.all(sigma == sigma[0]):
        return None
    return (sigma.min() / sigma) ** 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Slopes:
    """Value, slopes and curvature of half the cost of each pose by (c, q)."""

    cost: Float[Array, "t n"]  # half the cost of each pose
    # c, q: slopes
    c: Float[Array, "t n"]
    q: Float[Array, "t n"]
    # cc, cq, qq: curvature used in the step
    cc: Float[Array, "t n"]
    cq: Float[Array, "t n"]
    qq: Float[Array, "t n"]

    def weighted(self, shares: Float[Array, " n"] | None) -> "Slopes":
        """Multiply the cost of each pose by a weight."""
        if shares is None:
            return self
        return Slopes(**{k: getattr(self, k) * shares for k in self.__slots__})


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


SLOPES: dict[str, Callable[..., Slopes]] = {
    "norm": norm_slopes,
    "sampson": sampson_slopes,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Loss:
    """A robust loss, by its influence function psi(r) = r w(r)."""

    weight: Callable[[Array], Array]  # w(r) of the absolute residual over its scale
    slope: Callable[[Array], Array]  # d psi/dr
    # scale over the standard deviation of Gaussian residuals, for an efficiency of 95 %
    # on them
    tuning: float


# huber: quadratic, then linear. soft_l1: 2 (sqrt(1 + r^2) - 1), its smooth relative.
# cauchy: log(1 + r^2), which lets go of far outliers.
# Efficiencies on Gaussian residuals, by quadrature: 95.0 %, 95.4 %, 95.0 %.
LOSSES: dict[str, Loss] = {
    "huber": Loss(
        weight=lambda r: 1.0 / np.maximum(1.0, r),
        slope=lambda r: np.where(r < 1.0, 1.0, 0.0),
        tuning=1.345,
    ),
    "soft_l1": Loss(
        weight=lambda r: 1.0 / np.sqrt(1.0 + r * r),
        slope=lambda r: (1.0 + r * r) ** -1.5,
        tuning=1.345,
    ),
    "cauchy": Loss(
        weight=lambda r: 1.0 / (1.0 + r * r),
        slope=lambda r: (1.0 - r * r) / (1.0 + r * r) ** 2,
        tuning=2.385,
    ),
}
