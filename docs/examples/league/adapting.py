"""What the league's adapters share."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from simval.plugins import PluginError


@contextmanager
def needed() -> Iterator[None]:
    """Say what installs a package whose import fails for want of it."""
    try:
        yield
    except ModuleNotFoundError as error:
        msg = (
            f"the module {error.name} is not installed; install the packages of the "
            "league in a checkout: pip install -e '.[league]', or make league"
        )
        raise PluginError(msg) from None


def mirrored(vectors: np.ndarray) -> np.ndarray:
    """Vectors and their opposites: points whose centroid is the origin.

    For packages that superimpose points, and so subtract their centroid first. Their
    correlation matrix is twice that of the vectors, and the best rotation is the same.
    """
    return np.concatenate([vectors, -vectors])


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
    """Matrix of a quaternion, scalar first, that takes the body's axes to the world's."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def turned(q: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Quaternion, scalar first, after a turn of the body by a rotation vector, rad."""
    half = np.linalg.norm(turn) / 2.0
    s, e = np.cos(half), np.sinc(half / np.pi) / 2.0 * turn
    w, v = q[0], q[1:]
    found = np.append(w * s - v @ e, w * e + s * v + np.cross(v, e))
    return found / np.linalg.norm(found)


def heading_of(q: np.ndarray, field: np.ndarray) -> float:
    """Heading in NED that a field in body axes gives, levelled by an attitude, rad."""
    north, east, _ = body_to_world(q) @ field
    x, y = body_to_world(q)[:2, 0]
    return float(np.arctan2(y, x) - np.arctan2(east, north))


def turn_of(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Rotation vector of the body's turn between two quaternions, scalar first, rad."""
    w, e = before[0], -before[1:]
    s, v = after[0], after[1:]
    scalar, vector = w * s - e @ v, w * v + s * e + np.cross(e, v)
    sine = np.linalg.norm(vector)
    if sine < 1e-12:
        return 2.0 * np.copysign(1.0, scalar) * vector
    angle = 2.0 * np.arctan2(sine, abs(scalar)) * np.copysign(1.0, scalar)
    return angle / sine * vector
