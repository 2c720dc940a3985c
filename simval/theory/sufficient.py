r"""Which formula is good enough for the geometry and noise at hand.

:math:`|\bar q|/\sigma` alone does not decide it: over random geometries the noise at
which a formula is off by 1 % varies by a factor of two at the same ratio (study
`attitude_map`). Every formula is therefore set beside the exact moments of the very
case, in Frobenius norm relative to them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from simval.arguments import choice
from simval.arrays import positive_number
from simval.theory.attitude import ORDERS, AttitudeMoments, attitude_moments
from simval.theory.noise import noise_covariances
from simval.theory.two_vector import FRAMES, require_one

# Of 60 random geometries at noise from 1e-9 to 1e-7, where the fourth order is exact to
# rounding, the exact mean is off by at most 6e-16: a third of this.
_ROUNDING: Final = 2e-15


@dataclass(frozen=True, slots=True, kw_only=True)
class SufficientOrder:
    """The cheapest formula within a tolerance, and by how much each one is off.

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
    frame: str | None = None,
) -> SufficientOrder:
    """Find which formula of the attitude error may be used, by the exact answer.

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
    frame : {"plain", "x", "y", "z"}, optional
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
    tolerance = positive_number("tolerance", tolerance, "")
    if frame is not None:
        frame = choice("frame", frame, FRAMES)
    require_one(q, r1, r2)
    widest = np.linalg.eigvalsh(noise_covariances(noise_std))[:, -1].max()
    found = {o: attitude_moments(q, r1, r2, noise_std, o, frame) for o in ORDERS}
    sigma = float(np.sqrt(widest))
    bias = {o: _off(found, "bias", o) for o in ORDERS}
    covariance = {o: _off(found, "covariance", o) for o in ORDERS}
    within = (o for o in (2, 4, "exact") if max(bias[o], covariance[o]) <= tolerance)
    return SufficientOrder(
        order=next(within),
        bias_off=MappingProxyType(bias),
        covariance_off=MappingProxyType(covariance),
        norm_over_noise=float(found["exact"].norm) / sigma if sigma > 0.0 else np.inf,
    )


def _off(
    found: Mapping[int | str, AttitudeMoments], part: str, order: int | str
) -> float:
    # less what the exact answer's own rounding makes of it, which is all there is at
    # noise below 1e-7: 1e-16 in each mean, that times a standard deviation in a square
    exact = getattr(found["exact"], part)
    size = float(np.linalg.norm(exact))
    rounding = _ROUNDING * (1.0 if part == "bias" else np.sqrt(size) + _ROUNDING)
    gap = float(np.linalg.norm(getattr(found[order], part) - exact)) - rounding
    return float(gap / size) if gap > 0.0 else 0.0
