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

Each is given by its slopes by (c, q) and by the entries of the 2 x 2 curvature:
the product of first derivatives (Gauss-Newton) or the full one (Newton).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simval.arrays import Array

RESIDUALS = ("squared", "norm", "weighted", "sampson", "adjusted")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Slopes:
    """Value, slopes and curvature of half the cost of each pose by (c, q).

    Attributes
    ----------
    cost : Array
        Half the cost of each pose, (t, n).
    c, q : Array
        Slopes, (t, n).
    cc, cq, qq : Array
        Curvature used in the step, (t, n).
    """

    cost: Array
    c: Array
    q: Array
    cc: Array
    cq: Array
    qq: Array


def norm_slopes(c: Array, q: Array, *, newton: bool) -> Slopes:
    """Slopes of the norm residual |M(y - b)| - 1.

    Parameters
    ----------
    c, q : Array
        Quadrics of each pose, (t, n).
    newton : bool
        Full curvature instead of the product of first derivatives.

    Returns
    -------
    Slopes
        Slopes by (c, q).
    """
    r = np.sqrt(np.maximum(1.0 + c, np.finfo(float).tiny))
    e = r - 1.0
    zero = np.zeros_like(c)
    curve = 0.25 / (r * r * r) if newton else 0.25 / (r * r)
    return Slopes(cost=e * e / 2, c=e / (2 * r), q=zero, cc=curve, cq=zero, qq=zero)


def sampson_slopes(c: Array, q: Array, *, newton: bool) -> Slopes:
    """Slopes of the Sampson residual c / 2 sqrt(q).

    Parameters
    ----------
    c, q : Array
        Quadrics of each pose, (t, n).
    newton : bool
        Full curvature instead of the product of first derivatives.

    Returns
    -------
    Slopes
        Slopes by (c, q).
    """
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


def huber_weight(ratio: Array) -> Array:
    """Weight of Huber's loss: 1 up to a standardised residual of 1, then 1/ratio.

    Parameters
    ----------
    ratio : Array
        Absolute residual over its scale, (t, n).

    Returns
    -------
    Array
        Weight, (t, n).
    """
    return 1.0 / np.maximum(1.0, ratio)


def soft_weight(ratio: Array) -> Array:
    """Weight of the smooth L1 loss 2 (sqrt(1 + r^2) - 1).

    Parameters
    ----------
    ratio : Array
        Absolute residual over its scale, (t, n).

    Returns
    -------
    Array
        Weight, (t, n).
    """
    return 1.0 / np.sqrt(1.0 + ratio * ratio)


def cauchy_weight(ratio: Array) -> Array:
    """Weight of Cauchy's loss log(1 + r^2), which lets go of far outliers.

    Parameters
    ----------
    ratio : Array
        Absolute residual over its scale, (t, n).

    Returns
    -------
    Array
        Weight, (t, n).
    """
    return 1.0 / (1.0 + ratio * ratio)


LOSSES: dict[str, Callable[[Array], Array]] = {
    "huber": huber_weight,
    "soft_l1": soft_weight,
    "cauchy": cauchy_weight,
}
