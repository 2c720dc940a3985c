"""What the answers of an estimator fit, in words, where its conventions do not."""

from dataclasses import replace
from itertools import product
from typing import Final, Literal

import numpy as np

from simval.arrays import Array
from simval.geometry import attitude_error
from simval.plugins.answers import quaternions_of, raw_attitudes
from simval.plugins.covariance_probe import rotation_error
from simval.plugins.failures import TOLERANCE, allowed, failing, failure_shares
from simval.plugins.noise import VectorNoise
from simval.plugins.precision import NEAR, cause_of, moved
from simval.plugins.protocol import Estimator
from simval.plugins.reference_frames import FRAMES, VERTICALS
from simval.shapes import Float

ORDERS: Final[tuple[Literal["xyzs", "sxyz"], ...]] = ("xyzs", "sxyz")
DIRECTIONS: Final[tuple[Literal["active", "passive"], ...]] = ("active", "passive")

ALIKE = 1e-2
"""Of an angle, by which turns about one axis may differ and be the same."""

CASES = 64
"""Exact cases of each class behind the words."""


def what_fits(
    estimator: Estimator,
    truth: Float[Array, "n 4"],
    vectors: list[Float[Array, "n 3"]],
    noise: VectorNoise | None = None,
    first: Float[Array, "n 4"] | None = None,
) -> str:
    """Say how many rows each convention fits, and which classes of attitudes.

    `first` is what it answered to these vectors before.
    """
    again = quaternions_of(estimator, vectors, noise)
    apart = np.zeros(1) if first is None else attitude_error(again, first)
    if not np.all(apart <= allowed(vectors)):
        return (
            f"asked again it answers otherwise, by {apart.max():.3g} rad: it must "
            "answer the same each time"
        )
    fits = {}
    for other in _conventions(estimator):
        fits[other] = ~failing(other, truth, vectors, noise)
        if fits[other].all():
            return f"declare {_words(other)} instead"
    for other in fits:
        if words := nearly_right(other, truth, vectors, noise):
            return (
                words
                if _same(other, estimator)
                else f"declare {_words(other)} instead; {words}"
            )
    if words := _fitting_frame(estimator, len(vectors) // 2, len(truth), noise):
        return words
    # of equals the declared one, which is told without its words
    best = max(fits, key=lambda other: (fits[other].sum(), _same(other, estimator)))
    count, number = int(fits[best].sum()), len(truth)
    classes = _classes(best if count else estimator, len(vectors) // 2, noise)
    if not count:
        return (
            f"no order or direction of the components fits any of {number} rows "
            f"{classes}: is it b = A r, with body vectors first?{_fixed(estimator)}"
        )
    words = f"with {_words(best)} "
    wrong = int(np.flatnonzero(~fits[best])[0])
    q = quaternions_of(best, vectors, noise)
    off = float(attitude_error(truth[wrong], q[wrong]))
    return (
        f"{'' if _same(best, estimator) else words}{count} of {number} rows fit, "
        f"row {wrong}, {_turn(truth[wrong])}, does not, by {off:.3g} rad {classes}"
    )


def nearly_right(
    estimator: Estimator,
    truth: Float[Array, "n 4"],
    vectors: list[Float[Array, "n 3"]],
    noise: VectorNoise | None = None,
) -> str:
    """Say what is wrong of answers that are all off alike, or by little; else none."""
    q = quaternions_of(estimator, vectors, noise)
    for side in () if estimator.reference else ("body", "reference"):
        error = rotation_error(truth, q, side)
        mean = error.mean(axis=0)
        angle = float(np.linalg.norm(mean))
        if np.all(np.linalg.norm(error - mean, axis=1) <= ALIKE * angle):
            axis = ", ".join(f"{x:.3f}" for x in mean / angle)
            return (
                f"its conventions fit, but all answers are turned by the same "
                f"{angle:.3g} rad about the axis ({axis}) of the {side}"
            )
    off = attitude_error(truth, q) * (TOLERANCE / allowed(vectors))
    if not float(off.max()) <= NEAR:
        return ""
    cause = cause_of(
        raw_attitudes(estimator, vectors, noise),
        raw_attitudes(estimator, [moved(v) for v in vectors], noise),
    )
    return f"its conventions fit, its precision does not: {cause}"


def _conventions(estimator: Estimator) -> list[Estimator]:
    """The estimator in each order and direction that its answers can have."""
    matrix = estimator.components == "matrix"
    orders = (estimator.components,) if matrix else ORDERS
    return [
        replace(estimator, components=components, matrix=direction)
        for components, direction in product(orders, DIRECTIONS)
    ]


def _words(estimator: Estimator) -> str:
    return f'components="{estimator.components}", matrix="{estimator.matrix}"'


def _fitting_frame(
    estimator: Estimator, vectors: int, count: int, noise: VectorNoise | None
) -> str:
    """Say which fixed references an estimator was written for, if it was for any."""
    if vectors != 2:
        return ""
    for frame, vertical in product(FRAMES, VERTICALS):
        for dip in dict.fromkeys((None, estimator.dip)):
            fixed = replace(estimator, reference=frame, vertical=vertical, dip=dip)
            truth, exact = fixed.observed().generic(count, np.random.default_rng(1))
            for other in _conventions(fixed):
                if not failing(other, truth, exact, noise).any():
                    words = f'declare reference="{frame}", vertical="{vertical}"'
                    return f"{words} and {_words(other)} instead"
    return ""


def _fixed(estimator: Estimator) -> str:
    """What else may be wrong of an estimator whose references are fixed."""
    if estimator.reference is None:
        return " Are its references fixed? Then declare `reference`"
    dip = "any `dip`" if estimator.dip is None else f"a `dip` of {estimator.dip:g} rad"
    return f" It was tried with {dip}: declare the dip that it was written for"


def _same(other: Estimator, estimator: Estimator) -> bool:
    return (other.components, other.matrix) == (estimator.components, estimator.matrix)


def _turn(q: Float[Array, "4"]) -> str:
    angle = 2.0 * np.arctan2(np.linalg.norm(q[:3]), abs(q[3]))
    return f"a turn by {np.degrees(angle):.0f} degrees"


def _classes(estimator: Estimator, vectors: int, noise: VectorNoise | None) -> str:
    """Name the classes of which every case fits."""
    shares = failure_shares(estimator, CASES, vectors, noise)
    right = [name for name, share in shares.items() if share == 0.0]
    if not right:
        return "(and no class of attitudes)"
    return f"(all cases fit of: {'; '.join(right)})"
