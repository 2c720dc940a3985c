"""What the answers of an estimator fit, in words, where its conventions do not."""

from dataclasses import replace
from itertools import product
from typing import Final, Literal

import numpy as np
from jaxtyping import Float

from simval.arrays import Array
from simval.geometry import attitude_error
from simval.plugins.answers import quaternions_of
from simval.plugins.failures import failing, failure_shares
from simval.plugins.protocol import Estimator

ORDERS: Final[tuple[Literal["xyzs", "sxyz"], ...]] = ("xyzs", "sxyz")
DIRECTIONS: Final[tuple[Literal["active", "passive"], ...]] = ("active", "passive")

CASES = 64
"""Exact cases of each class behind the words."""


def what_fits(
    estimator: Estimator, truth: Float[Array, "n 4"], vectors: list[Float[Array, "n 3"]]
) -> str:
    """Say how many rows each convention fits, and which classes of attitudes."""
    fits = {}
    for components, matrix in product(ORDERS, DIRECTIONS):
        other = replace(estimator, components=components, matrix=matrix)
        fits[other] = ~failing(other, truth, vectors)
        if fits[other].all():
            if _same(other, estimator):
                return "asked again it is right: it must answer the same each time"
            return f'declare components="{components}", matrix="{matrix}" instead'
    # of equals the declared one, which is told without its words
    best = max(fits, key=lambda other: (fits[other].sum(), _same(other, estimator)))
    count, number = int(fits[best].sum()), len(truth)
    if not count:
        return (
            f"no order or direction of the components fits any of {number} rows "
            f"{_classes(estimator)}: is it b = A r, with body vectors first?"
        )
    words = f'with components="{best.components}", matrix="{best.matrix}" '
    wrong = int(np.flatnonzero(~fits[best])[0])
    q = quaternions_of(best, *(v.copy() for v in vectors))
    off = float(attitude_error(truth[wrong], q[wrong]))
    return (
        f"{'' if _same(best, estimator) else words}{count} of {number} rows fit, "
        f"row {wrong}, {_turn(truth[wrong])}, does not, by {off:.3g} rad "
        f"{_classes(best)}"
    )


def _same(other: Estimator, estimator: Estimator) -> bool:
    return (other.components, other.matrix) == (estimator.components, estimator.matrix)


def _turn(q: Float[Array, "4"]) -> str:
    angle = 2.0 * np.arctan2(np.linalg.norm(q[:3]), abs(q[3]))
    return f"a turn by {np.degrees(angle):.0f} degrees"


def _classes(estimator: Estimator) -> str:
    """Name the classes of which every case fits."""
    shares = failure_shares(estimator, CASES)
    right = [name for name, share in shares.items() if share == 0.0]
    if not right:
        return "(and no class of attitudes)"
    return f"(all cases fit of: {'; '.join(right)})"
