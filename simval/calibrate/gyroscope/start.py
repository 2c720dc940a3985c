"""A start for the gyroscope's matrix: scale, then order and signs of the axes.

Moves of a radian or two tell a scale within some ten percent from any other, so scales
a tenth apart are tried. If axes are not those of the accelerometer, all 48 orders and
signs are.
"""

from itertools import permutations, product
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.calibrate.gyroscope.rows import gap_values
from simval.calibrate.gyroscope.statistics import merged
from simval.calibrate.gyroscope.turn import end_of
from simval.shapes import Float

_RATIO: Final = 1.1  # of neighbouring scales
_LEAST, _MOST = 0.05, 12.0  # rad, along the way of a typical move
_CHUNKS: Final = 1 << 16  # worked at once
_ENOUGH: Final = 24  # chunks of a move: a third of a radian each at the most
GOOD: Final = 0.1  # rad, rms of rows at a start that is near; sensors are 1 % off


def first_matrix(
    statistics: Float[Array, "k 10 j"],
    u: Float[Array, "n 3"],
    E: Float[Array, "k 2 3"],
) -> Float[Array, "3 3"]:
    """Best of the matrices that are a scale times an order of axes."""
    way = np.sqrt((statistics[:, :3] ** 2).sum(axis=1)).sum(axis=1)
    typical = float(np.median(way))
    size = max(1, statistics.shape[-1] // _ENOUGH)
    statistics = merged(statistics[None], 2 ** int(np.log2(size)))[0]
    if not typical > 0.0:
        return np.full((3, 3), np.nan)
    count = int(np.ceil(np.log(_MOST / _LEAST) / np.log(_RATIO)))
    scales = _LEAST / typical * _RATIO ** np.arange(count + 1)
    aligned = scales[:, None, None] * np.eye(3)
    cost = _costs(statistics, u, E, aligned)
    best = aligned[np.argmin(cost)]
    if cost.min() < GOOD:
        return best
    orders = np.array(
        [
            np.eye(3)[list(order)] * np.array(signs)[:, None]
            for order, signs in product(
                permutations(range(3)), product((1, -1), repeat=3)
            )
        ]
    )
    every = (scales[:, None, None, None] * orders).reshape(-1, 3, 3)
    costs = _costs(statistics, u, E, every)
    # as it stands, unless another order is far better
    return every[np.argmin(costs)] if costs.min() < 0.5 * cost.min() else best


def _costs(statistics: Array, u: Array, E: Array, guesses: Array) -> Float[Array, " m"]:
    # root mean square of the rows, rad
    size = max(1, _CHUNKS // (statistics.shape[0] * statistics.shape[2]))
    parts = []
    for i in range(0, len(guesses), size):
        some = guesses[i : i + size]
        C = end_of(statistics[None], some, np.zeros((len(some), 3)))
        m = len(some)
        e = gap_values(
            C, np.broadcast_to(u, (m, *u.shape)), np.broadcast_to(E, (m, *E.shape))
        )
        parts.append(np.sqrt((e * e).mean(axis=-1)))
    return np.concatenate(parts)
