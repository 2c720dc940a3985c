"""Where an estimator fails: its share of exact cases of each class of attitudes.

An estimate fails where it is not finite, not of unit length, or farther from the truth
than `TOLERANCE` over the sine of the angle between the vectors. A batch that raises,
or whose answer cannot be read, is tried in halves: what fails alone fails.
"""

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import PluginError
from simval.geometry import attitude_error
from simval.plugins.answers import UNIT, package_quaternion, raw_quaternions
from simval.plugins.attitude_classes import CLASSES, COUNT, exact_cases
from simval.plugins.protocol import Estimator

TOLERANCE = 1e-6
"""Rad, and relative to the parameters: the root of rounding is 1.5e-8, which is what a
sound but ill-conditioned algorithm may lose, times 64. A rounding of vectors turns
them about their own mean by its size over the sine between them, so it is allowed that
much more."""

Mask = NDArray[np.bool_]


def failure_shares(estimator: Estimator, count: int = COUNT) -> dict[str, float]:
    """Share of the exact cases of each class that an estimator fails, 0 to 1."""
    return {
        name: float(np.mean(failing(estimator, *exact_cases(name, count))))
        for name in CLASSES
    }


def failing(
    estimator: Estimator,
    truth: Float[Array, "n 4"],
    vectors: list[Float[Array, "n 3"]],
) -> Bool[Mask, " n"]:
    """Which of some exact cases are no estimate of the truth, (n,)."""
    sine = np.linalg.norm(np.cross(vectors[2], vectors[3]), axis=1)
    tolerance = TOLERANCE / sine

    def halved(start: int, stop: int) -> Mask:
        # arrays that are one to the caller stay one to the estimator
        rows = slice(start, stop)
        own = {id(v): v[rows].copy() for v in vectors}
        try:
            raw = raw_quaternions(estimator, *(own[id(v)] for v in vectors))
        except PluginError:
            if stop - start == 1:
                return np.array([True])
            middle = (start + stop) // 2
            return np.concatenate([halved(start, middle), halved(middle, stop)])
        with np.errstate(invalid="ignore", over="ignore"):  # rows that are not finite
            unit = np.abs(np.linalg.norm(raw, axis=1) - 1.0) <= UNIT
        q = package_quaternion(
            np.where(unit[:, None], raw, 0.5), estimator.components, estimator.matrix
        )
        wrong: Mask = ~(unit & (attitude_error(truth[rows], q) <= tolerance[rows]))
        return wrong

    return halved(0, len(truth))
