"""Where an estimator fails: its share of exact cases of each class of attitudes.

An estimate fails where it is not finite, not of unit length, or farther from the truth
than `TOLERANCE` over the sine of the angle between the vectors. A batch that raises,
or whose answer cannot be read, is tried in halves: what fails alone fails.
"""

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import PluginError
from simval.geometry import attitude_error
from simval.plugins.answers import raw_attitudes
from simval.plugins.attitude_classes import COUNT
from simval.plugins.noise import VectorNoise
from simval.plugins.protocol import Estimator
from simval.plugins.rotations import package_quaternion, sound_rows, tail
from simval.shapes import Bool, Float

TOLERANCE = 1e-6
"""Rad, and relative to the parameters: the root of rounding is 1.5e-8, which is what a
sound but ill-conditioned algorithm may lose, times 64. A rounding of vectors turns
them about their own mean by its size over the sine between them, so it is allowed that
much more."""

Mask = NDArray[np.bool_]


def failure_shares(
    estimator: Estimator,
    count: int = COUNT,
    vectors: int = 2,
    noise: VectorNoise | None = None,
) -> dict[str, float]:
    """Share of the exact cases of each class that an estimator fails, 0 to 1."""
    observed = estimator.observed(vectors)
    return {
        name: float(np.mean(failing(estimator, *observed.cases(name, count), noise)))
        for name in observed.classes
    }


def allowed(vectors: list[Float[Array, "n 3"]]) -> Float[Array, " n"]:
    """How far an exact case may be from the truth, rad."""
    first, *others = vectors[len(vectors) // 2 :]
    sines = [np.linalg.norm(np.cross(first, r), axis=1) for r in others]
    tolerance: Array = TOLERANCE / np.max(sines, axis=0)
    return tolerance


def failing(
    estimator: Estimator,
    truth: Float[Array, "n 4"],
    vectors: list[Float[Array, "n 3"]],
    noise: VectorNoise | None = None,
) -> Bool[Mask, " n"]:
    """Which of some exact cases are no estimate of the truth, (n,)."""
    tolerance = allowed(vectors)

    def halved(start: int, stop: int) -> Mask:
        # arrays that are one to the caller stay one to the estimator
        rows = slice(start, stop)
        own = {id(v): v[rows] for v in vectors}
        try:
            raw = raw_attitudes(estimator, [own[id(v)] for v in vectors], noise)
        except PluginError:
            if stop - start == 1:
                return np.array([True])
            middle = (start + stop) // 2
            return np.concatenate([halved(start, middle), halved(middle, stop)])
        sound = sound_rows(raw, estimator.components)
        some = np.reshape(sound, (-1, *(1 for _ in tail(estimator.components))))
        any_attitude = np.eye(3) if raw.ndim == 3 else np.full(4, 0.5)
        q = package_quaternion(
            np.where(some, raw, any_attitude), estimator.components, estimator.matrix
        )
        wrong: Mask = ~(sound & (attitude_error(truth[rows], q) <= tolerance[rows]))
        return wrong

    return halved(0, len(truth))
