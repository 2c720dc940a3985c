"""Quaternions of the filters' adapters, scalar first, from the body to its world."""

from collections.abc import Sequence
from math import atan2, cos, sin, sqrt

import numpy as np


def turn_rates(q: np.ndarray) -> np.ndarray:
    """Matrix X of dq = X e / 2 for a small turn e of the body; q scalar first."""
    w, x, y, z = q
    return np.array([[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]])


def of_rotation(q: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Covariance of the rotation vector, body side, from that of a quaternion."""
    X = turn_rates(q)
    P = 4.0 * X.T @ covariance @ X
    return (P + P.T) / 2.0


def of_quaternion(q: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Covariance of a quaternion, scalar first, from that of the rotation vector."""
    X = turn_rates(q)
    return X @ covariance @ X.T / 4.0


def body_to_world(q: np.ndarray) -> np.ndarray:
    """Matrix of a quaternion, from the body's axes to the world's."""
    w, x, y, z = q.tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def turned(q: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Quaternion, scalar first, after a turn of the body by a rotation vector, rad."""
    x, y, z = turn.tolist()
    half = 0.5 * sqrt(x * x + y * y + z * z)
    share = 0.5 * sin(half) / half if half > 0.0 else 0.5
    return _unit(_product(q.tolist(), (cos(half), share * x, share * y, share * z)))


def turn_of(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Rotation vector of the body's turn between two quaternions, scalar first, rad."""
    w, x, y, z = before.tolist()
    s, *e = _product((w, -x, -y, -z), after.tolist())
    if s < 0.0:
        s, e = -s, [-each for each in e]
    sine = sqrt(sum(each * each for each in e))
    size = 2.0 * atan2(sine, s) / sine if sine > 0.0 else 2.0
    return np.array([size * each for each in e])


def _product(p: Sequence[float], q: Sequence[float]) -> tuple[float, ...]:
    (a, b, c, d), (w, x, y, z) = p, q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def _unit(q: Sequence[float]) -> np.ndarray:
    length = sqrt(sum(each * each for each in q))
    return np.array([each / length for each in q])
