r"""What an expansion in the noise leaves out, and which order suffices.

**Remainder of an expansion.** With :math:`F_k` the expansion of a moment to order k,
:math:`F_4` the complete fourth order, t the trace of :math:`C_2` (the mean square of
the error to second order), and entry by entry the greatest difference,

.. math:: |F - F_4| \le 2\,t^3, \tag{R1}
.. math:: |F - F_k| \le |F_4 - F_k| + 2\,t^3. \tag{R2}

An expansion in the noise goes in powers of t, and its sixth order is the first that
:math:`F_4` leaves out: the power is derived. The factor is measured: the exact moments
of 265 random geometries are off by at most 0.7 of (R1) (`test_theory_orders.py`).
(R2) is the triangle inequality. The ratio of the two orders below would not do for
(R1): either may vanish for a geometry, and was found 6 times too small.

Below :math:`|\bar q|/\sigma` = `RANGE` the ratio of two orders is above a quarter and
the estimate too small: there an expansion should not be judged.

**The lowest order that is good enough.** :math:`|\bar q|/\sigma` alone does not decide
it: over random geometries the noise at which a formula is off by 1 % varies by a factor
of two at the same ratio (study `attitude_map`). Every formula is therefore set against
the exact moments of the very case, in Frobenius norm relative to them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from simval.arguments import choice
from simval.arrays import positive_number
from simval.errors import InputError
from simval.moments import Moments
from simval.theory.attitude import ORDERS, AttitudeMoments, attitude_moments
from simval.theory.cubature import REFINED
from simval.theory.estimators import wahba_moments
from simval.theory.two_vector import (
    FRAMES,
    WHOLE,
    Frame,
    noise_of_vectors,
    require_one,
)

RANGE = 5.0  # see above; of sigma
_SIXTH = 2.0  # of eq. (R1), measured


class Remainder(NamedTuple):
    """Largest error of an entry of a predicted bias and of a covariance."""

    bias: float
    covariance: float


def expansion_remainders(
    found: Mapping[Any, AttitudeMoments],
) -> dict[int | str, Remainder]:
    """Remainders of the moments of each order, eqs. (R1), (R2)."""
    fourth = found[4]
    left = _SIXTH * np.trace(found[2].covariance) ** 3
    remainders = {
        order: Remainder(
            np.abs(fourth.bias - moments.bias).max() + left,
            np.abs(fourth.covariance - moments.covariance).max() + left,
        )
        for order, moments in found.items()
    }
    return remainders | {"exact": Remainder(0.0, 0.0)}


# Of 60 random geometries at noise from 1e-9 to 1e-7, where the fourth order is exact to
# rounding, the exact mean is off by at most 6e-16: a third of this.
_ROUNDING: Final = 2e-15


@dataclass(frozen=True, slots=True, kw_only=True)
class SufficientOrder:
    """The simplest formula within a tolerance, and the error of each.

    Attributes
    ----------
    order : {2, 4, "exact"}
        Of `attitude_moments`: the lowest whose bias and covariance both are within the
        tolerance.
    bias_off, covariance_off : mapping
        Relative error of each order, 2, ``"4-paper"``, 4 and ``"exact"``, Frobenius
        norm; a difference that rounding of the exact answer can make counts as none.
    norm_over_noise : float
        |qbar| over the greatest standard deviation of any vector in any direction;
        infinite without noise.
    """

    order: int | str
    bias_off: Mapping[int | str, float]
    covariance_off: Mapping[int | str, float]
    norm_over_noise: float


def sufficient_order(
    q: Any,
    r1: Any,
    r2: Any,
    noise_std: Any,
    tolerance: float = 0.01,
    frame: Frame | None = None,
) -> SufficientOrder:
    """Find which formula of the attitude error suffices, by the exact answer.

    Parameters
    ----------
    q : array_like
        True quaternion, reference to body, vector first, (4,).
    r1, r2 : array_like
        True reference vectors, (3,).
    noise_std : array_like
        Noise of the unit vectors, as `attitude_moments` takes it.
    tolerance : float, default 0.01
        Relative error allowed of the bias and of the covariance, above 0.
    frame : {"plain", "x", "y", "z", "combined", "optimal"}, optional
        The estimator's fixed frame; default, the greatest column of the truth.

    Returns
    -------
    SufficientOrder
        The lowest order within the tolerance. The source's fourth order is measured
        and never chosen: it costs what the second does, and is of its order.

    Raises
    ------
    InputError
        If an argument has a wrong shape or value.
    GeometryError
        If the vectors are parallel, or the frame is singular at this attitude.
    RefusedError
        If the exact answer is not resolved; then no expansion holds to a few percent.
    """
    if frame is not None:
        frame = choice("frame", frame, (*WHOLE, *FRAMES))
    require_one(q, r1, r2)
    widest = np.linalg.eigvalsh(noise_of_vectors(noise_std))[..., -1].max()
    orders = (2, 4, "exact") if frame in WHOLE else ORDERS
    found = {o: attitude_moments(q, r1, r2, noise_std, o, frame) for o in orders}
    sigma = float(np.sqrt(widest))
    ratio = float(found["exact"].norm) / sigma if sigma > 0.0 else np.inf
    return _lowest_order(found, tolerance, ratio)


def wahba_order(
    q: Any,
    references: Any,
    noise_std: Any,
    weights: Any = None,
    tolerance: float = 0.01,
) -> SufficientOrder:
    """Find which order of `wahba_moments` suffices, by the exact answer.

    Parameters
    ----------
    q : array_like
        True quaternion, (4,).
    references : array_like
        True reference vectors, (n, 3), n >= 2.
    noise_std : array_like
        As in `wahba_moments`.
    weights : array_like, optional
        As in `wahba_moments`.
    tolerance : float, default 0.01
        Relative error allowed of the bias and of the covariance, 0.004 or more.

    Returns
    -------
    SufficientOrder
        The lowest order within the tolerance; `norm_over_noise` is one over twice the
        greatest standard deviation of the estimate.

    Raises
    ------
    InputError, GeometryError, RefusedError
        As `wahba_moments`.
    """
    orders: tuple[Literal[2, 4, "exact"], ...] = (2, 4, "exact")
    found = {o: wahba_moments(q, references, noise_std, weights, o) for o in orders}
    widest = float(np.linalg.eigvalsh(found[2].covariance)[-1])
    ratio = 0.5 / np.sqrt(widest) if widest > 0.0 else np.inf
    return _lowest_order(found, tolerance, float(ratio))


def _lowest_order(
    found: Mapping[Any, Moments], tolerance: float, ratio: float
) -> SufficientOrder:
    # of some orders, that within a tolerance of the exact moments
    tolerance = positive_number("tolerance", tolerance, "")
    if "4-paper" not in found and not tolerance >= 2.0 * REFINED:
        msg = (
            f"`tolerance` is {tolerance:g}; moments of this estimator are known to "
            f"{REFINED:g} where the noise is large, so give {2.0 * REFINED:g} or more"
        )
        raise InputError(msg)
    bias = {order: _off(found, "bias", order) for order in found}
    covariance = {order: _off(found, "covariance", order) for order in found}
    within = (o for o in (2, 4, "exact") if max(bias[o], covariance[o]) <= tolerance)
    return SufficientOrder(
        order=next(within),
        bias_off=MappingProxyType(bias),
        covariance_off=MappingProxyType(covariance),
        norm_over_noise=ratio,
    )


def _off(found: Mapping[int | str, Moments], part: str, order: int | str) -> float:
    # less what the exact answer's own rounding makes of it, which is all there is at
    # noise below 1e-7: 1e-16 in each mean, that times a standard deviation in a square
    exact = getattr(found["exact"], part)
    size = float(np.linalg.norm(exact))
    rounding = _ROUNDING * (1.0 if part == "bias" else np.sqrt(size) + _ROUNDING)
    gap = float(np.linalg.norm(getattr(found[order], part) - exact)) - rounding
    return float(gap / size) if gap > 0.0 else 0.0
