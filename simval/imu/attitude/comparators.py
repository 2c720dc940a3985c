"""Established two-vector estimators behind the signature of `two_vector_quaternion`.

Each takes b1, b2, r1, r2 of shape (..., 3) and returns unit quaternions (..., 4) with
a scalar that is not negative, and refuses what `two_vector_quaternion` refuses. Vectors
are normalised first, so that pairs in different units weigh the same.
"""

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import scipy

from simval.arrays import Array
from simval.errors import InputError
from simval.geometry import cross, normalize
from simval.imu.attitude.estimator import two_vector_quaternion, valid_batch
from simval.imu.attitude.wahba import profile_matrix
from simval.shapes import Float


def davenport(
    b1: Any, b2: Any, r1: Any, r2: Any, weights: tuple[float, float] = (1.0, 1.0)
) -> Float[Array, "... 4"]:
    r"""Davenport's q-method: the optimum of Wahba's problem, batched.

    The gain :math:`\sum_i w_i b_i^T A(q) r_i = q^T K q` is greatest for the
    eigenvector of the largest eigenvalue of K. With weights :math:`1/(\sigma_{bi}^2 +
    \sigma_{ri}^2)` it is the maximum-likelihood estimate for isotropic noise.

    Raises
    ------
    InputError, GeometryError
        As `two_vector_quaternion`.
    """
    if not all(np.isfinite(w) and w > 0.0 for w in weights):
        msg = f"`weights` is {weights}; both must be finite and above 0"
        raise InputError(msg)
    (v1, v2, u1, u2), shape = _unit_batch(b1, b2, r1, r2)
    body, reference = np.stack([v1, v2], axis=1), np.stack([u1, u2], axis=1)
    K = profile_matrix(body, reference, np.broadcast_to(weights, body.shape[:2]))
    return _finish(np.linalg.eigh(K)[1][..., 3], shape)


def triad(b1: Any, b2: Any, r1: Any, r2: Any) -> Float[Array, "... 4"]:
    """TRIAD: the first pair exactly, the second only for the turn about it.

    Raises
    ------
    InputError, GeometryError
        As `two_vector_quaternion`.
    """
    (v1, v2, u1, u2), shape = _unit_batch(b1, b2, r1, r2)
    body_to_reference = _triad_axes(u1, u2) @ _triad_axes(v1, v2).swapaxes(1, 2)
    rotation = scipy.spatial.transform.Rotation.from_matrix(body_to_reference)
    return _finish(rotation.as_quat(), shape)


def align_vectors(b1: Any, b2: Any, r1: Any, r2: Any) -> Float[Array, "... 4"]:
    """SciPy's `Rotation.align_vectors` sample by sample: Kabsch's SVD.

    Raises
    ------
    InputError, GeometryError
        As `two_vector_quaternion`.
    """
    (v1, v2, u1, u2), shape = _unit_batch(b1, b2, r1, r2)
    body, reference = np.stack([v1, v2], axis=1), np.stack([u1, u2], axis=1)
    q = [
        scipy.spatial.transform.Rotation.align_vectors(r, b)[0].as_quat()
        for b, r in zip(body, reference, strict=True)
    ]
    return _finish(np.reshape(q, (-1, 4)), shape)


ESTIMATORS: Final[Mapping[str, Callable[..., Array]]] = MappingProxyType(
    {
        "best": two_vector_quaternion,
        "combined": partial(two_vector_quaternion, frame="combined"),
        "davenport": davenport,
        "triad": triad,
        "align_vectors": align_vectors,
    }
)


def _unit_batch(*vectors: Any) -> tuple[list[Float[Array, "n 3"]], tuple[int, ...]]:
    arrays, shape = valid_batch(*vectors)
    return [normalize(array) for array in arrays], shape


def _triad_axes(
    first: Float[Array, "n 3"], second: Float[Array, "n 3"]
) -> Float[Array, "n 3 3"]:
    normal = cross(first, second)
    axes = np.stack([first, normal, cross(first, normal)], axis=-1)
    unit: Array = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    return unit


def _finish(q: Float[Array, "n 4"], shape: tuple[int, ...]) -> Float[Array, "... 4"]:
    signed: Array = np.where(q[:, 3:] < 0.0, -q, q)
    return signed.reshape(*shape, 4)
